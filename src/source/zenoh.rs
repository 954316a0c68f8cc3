//! The Zenoh session: one wildcard subscription per prefix, one queryable for everything that is published.
//!
//! The subscriber's callback runs on the bus's own threads, so it only puts the message into the engine's queue; a full
//! queue drops the message and counts it.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::sync::{Arc, PoisonError, RwLock};

use anyhow::{Context, anyhow};
use crossbeam_channel::Sender;
use zenoh::Wait;
use zenoh::bytes::Encoding;
use zenoh::key_expr::KeyExpr;
use zenoh::query::Query;
use zenoh::sample::{Sample as BusSample, SampleKind};

use super::keys::{ShardFilter, subscriptions};
use super::{Answer, Envelope, Incoming, Intake, principals};
use crate::daemon::documents;
use crate::daemon::metrics::Metrics;
use stiction_monitor::alarm::Command;
use stiction_monitor::codec::topic::{self, Kind, Leaf, Topic};
use stiction_monitor::config::Config;

/// Largest message that Zenoh puts together from its pieces, bytes: what is larger never takes memory. Well above what a
/// payload may have, so that payloads a little too large are still seen and counted.
const MAX_MESSAGE: usize = 4 << 20;

/// What the encoding of a schema names as its own.
const SCHEMA: &str = "https://json-schema.org/draft/2020-12/schema";

/// Last document by key. Written by the publisher alone; never touched by the engine.
pub type LastValues = Arc<RwLock<BTreeMap<String, LastValue>>>;

/// A document and its signature, if documents are signed.
#[derive(Debug, Clone)]
pub struct LastValue {
    /// Its JSON.
    pub document: Arc<[u8]>,
    /// What goes along with it.
    pub attachment: Option<Arc<[u8]>>,
}

/// What attaches a signature to a document under a key.
pub type Sign = Arc<dyn Fn(&str, &[u8]) -> Vec<u8> + Send + Sync>;

/// Makes the session's configuration from ours.
///
/// # Errors
/// A configuration file that cannot be read, or settings that Zenoh refuses.
pub fn session_config(config: &Config) -> anyhow::Result<zenoh::Config> {
    let z = &config.zenoh;
    let mut session = if z.config_file.is_empty() {
        zenoh::Config::default()
    } else {
        zenoh::Config::from_file(&z.config_file)
            .map_err(|e| anyhow!("[zenoh] config_file {:?} cannot be used: {e}", z.config_file))?
    };
    let plain = zenoh::Config::default();
    // What the file states differs from what Zenoh takes where nothing is said; a limit that is Zenoh's own is none.
    let said = |key: &str| session.get_json(key).ok() != plain.get_json(key).ok();
    let own = z.config_file.is_empty();
    let mut wanted = Vec::new();
    if own {
        wanted.push(("mode", format!("{:?}", z.mode)));
    }
    if own || !z.listen.is_empty() {
        wanted.push(("listen/endpoints", serde_json::to_string(&z.listen)?));
    }
    // Zenoh's own defaults scout and give up. Keep trying for ever: the router may come up after us, and go and come again.
    let unsaid = [
        ("scouting/multicast/enabled", z.multicast.to_string()),
        ("connect/timeout_ms", "-1".to_owned()),
        ("connect/exit_on_failure", "false".to_owned()),
        ("transport/link/rx/max_message_size", MAX_MESSAGE.to_string()),
    ];
    wanted.extend(unsaid.into_iter().filter(|(key, _)| !said(key)));
    let mut set = |key: &str, value: String| {
        session.insert_json5(key, &value).map_err(|e| anyhow!("Zenoh refuses {key} = {value}: {e}"))
    };
    for (key, value) in wanted {
        set(key, value)?;
    }
    if !z.connect.is_empty() {
        set("connect/endpoints", serde_json::to_string(&z.connect)?)?;
    }
    principals::limit(&mut session, &config.site.prefix, &config.commands.principals)
        .context("[commands] principals")?;
    Ok(session)
}

/// Opens the session, and says why not where it could not listen: it then goes on without, and tries for ever. A router
/// that is not there yet is waited for.
///
/// # Errors
/// With the endpoints in the message.
pub async fn open(config: &Config) -> anyhow::Result<(zenoh::Session, Option<String>)> {
    let strict = session_config(config)?;
    let mut patient = strict.clone();
    // Opening blocks until a client's router is there: on a thread of its own it can be given up.
    let why = match tokio::task::spawn_blocking(|| zenoh::open(strict).wait()).await? {
        Ok(session) => return Ok((session, None)),
        Err(error) => error.to_string(),
    };
    let endpoints =
        || format!("Zenoh cannot start (listen {:?}, connect {:?})", config.zenoh.listen, config.zenoh.connect);
    for (key, value) in [("listen/timeout_ms", "-1"), ("listen/exit_on_failure", "false")] {
        patient.insert_json5(key, value).map_err(|e| anyhow!("Zenoh refuses {key} = {value}: {e}"))?;
    }
    let opened = tokio::task::spawn_blocking(|| zenoh::open(patient).wait()).await?;
    let session = opened.map_err(|_| anyhow!("{why}")).with_context(endpoints)?;
    Ok((session, Some(why)))
}

/// Subscribes. The subscriptions live as long as the session.
///
/// # Errors
/// A key that Zenoh refuses.
pub async fn subscribe(
    session: &zenoh::Session,
    config: &Config,
    intake: &Intake,
) -> anyhow::Result<Vec<zenoh::pubsub::Subscriber<()>>> {
    let mut subscribers = Vec::new();
    let filter = ShardFilter::new(config).map(Arc::new);
    for key in subscriptions(config) {
        let (intake, filter) = (intake.clone(), filter.clone());
        let take = move |sample: BusSample| {
            if filter.as_ref().is_none_or(|filter| filter.admits(sample.key_expr().as_str())) {
                enqueue(&sample, &intake);
            }
        };
        let subscriber = session
            .declare_subscriber(key.clone())
            .callback(take)
            .await
            .map_err(|e| anyhow!("cannot subscribe to {key:?}: {e}"))?;
        subscribers.push(subscriber);
    }
    Ok(subscribers)
}

fn enqueue(sample: &BusSample, intake: &Intake) {
    if sample.kind() == SampleKind::Delete {
        return intake.delete();
    }
    // Borrowed wherever the encoding is one of Zenoh's own without a schema.
    let encoding = (*sample.encoding() != Encoding::default()).then(|| Cow::from(sample.encoding()));
    let envelope = Envelope {
        key: sample.key_expr().as_str(),
        encoding: encoding.as_deref(),
        bus_ns: sample.timestamp().map(|t| t.get_time().to_duration().as_nanos() as i64),
    };
    let payload = sample.payload();
    intake.take(&envelope, payload.len(), |bytes| payload.slices().for_each(|part| bytes.extend_from_slice(part)));
}

/// Answers queries: last documents from memory, commands by way of the engine.
///
/// # Errors
/// A key that Zenoh refuses.
pub async fn answer_queries(
    session: &zenoh::Session,
    (prefix, daemon_id): (&str, &str),
    queue: Sender<Incoming>,
    last: LastValues,
    sign: Option<Sign>,
    metrics: Arc<Metrics>,
) -> anyhow::Result<Vec<zenoh::query::Queryable<()>>> {
    let mut queryables = Vec::new();
    // No wildcard matches the verbatim chunk of the daemon's own health; another daemon's is not ours to answer.
    let own = format!("@daemon/{daemon_id}/**");
    for key in [topic::plane(prefix, "**"), topic::plane(prefix, &own)] {
        let (prefix, queue) = (prefix.to_owned(), queue.clone());
        let (last, sign, metrics) = (last.clone(), sign.clone(), metrics.clone());
        let answer = move |query: Query| {
            metrics.queries.inc();
            let parameters = query.parameters();
            match (parameters.get("cmd").map(str::to_owned), parameters.contains_key("run")) {
                (Some(cmd), _) => forward_command(&prefix, cmd, query, &queue, sign.clone()),
                (None, true) => forward_run(&prefix, query, &queue, sign.clone()),
                (None, false) => answer_last(&query, &last),
            }
        };
        let queryable = session.declare_queryable(key.clone()).callback(answer).await;
        queryables.push(queryable.map_err(|e| anyhow!("cannot answer queries on {key:?}: {e}"))?);
    }
    queryables.push(answer_schemas(session, prefix, metrics).await?);
    Ok(queryables)
}

/// Answers `@schema/NAME`, and `@schema/*` with all of them: the schemas of what this daemon publishes, whatever its version.
async fn answer_schemas(
    session: &zenoh::Session,
    prefix: &str,
    metrics: Arc<Metrics>,
) -> anyhow::Result<zenoh::query::Queryable<()>> {
    let keyed =
        |(name, schema): (&str, _)| (topic::plane(prefix, &format!("@schema/{name}")), documents::text(&schema));
    let all: Vec<(String, String)> = documents::schemas().into_iter().map(keyed).collect();
    let answer = move |query: Query| {
        metrics.queries.inc();
        let asked = query.key_expr();
        for (key, text) in all.iter().filter(|(key, _)| KeyExpr::new(key.as_str()).is_ok_and(|k| asked.intersects(&k)))
        {
            let reply =
                query.reply(key.as_str(), text.as_str()).encoding(Encoding::APPLICATION_JSON.with_schema(SCHEMA));
            if let Err(error) = reply.wait() {
                tracing::debug!(%key, %error, "a schema could not be sent");
            }
        }
    };
    let key = topic::plane(prefix, "@schema/*");
    let queryable = session.declare_queryable(key.clone()).callback(answer).await;
    queryable.map_err(|e| anyhow!("cannot answer queries on {key:?}: {e}"))
}

fn answer_last(query: &Query, last: &LastValues) {
    let asked = query.key_expr();
    let found: Vec<(String, LastValue)> = {
        let map = last.read().unwrap_or_else(PoisonError::into_inner);
        match map.get(asked.as_str()) {
            Some(value) => vec![(asked.as_str().to_owned(), value.clone())],
            None => map
                .iter()
                .filter(|(key, _)| KeyExpr::new(key.as_str()).is_ok_and(|k| asked.intersects(&k)))
                .map(|(k, v)| (k.clone(), v.clone()))
                .collect(),
        }
    };
    for (key, value) in found {
        let encoding = encoding_of(&key);
        let attachment = value.attachment.map(|bytes| bytes.to_vec());
        let reply = query.reply(key.as_str(), value.document.to_vec()).encoding(encoding).attachment(attachment);
        if let Err(error) = reply.wait() {
            tracing::debug!(%key, %error, "a reply could not be sent");
        }
    }
}

/// The encoding of a document under a key of the daemon, with its schema's name.
#[must_use]
pub fn encoding_of(key: &str) -> Encoding {
    match topic::schema_of(key) {
        Some(schema) => Encoding::APPLICATION_JSON.with_schema(schema),
        None => Encoding::APPLICATION_JSON,
    }
}

fn refuse(query: &Query, why: &str) {
    let _ = query.reply_err(why).encoding(Encoding::TEXT_PLAIN).wait();
}

/// The one loop whose document of this kind a query names.
fn loop_asked(prefix: &str, query: &Query, kind: Kind) -> Option<String> {
    let parsed = Topic::parse(Some(prefix), query.key_expr().as_str()).filter(|t| t.leaf == Leaf::Document(kind))?;
    Some(parsed.loop_name.to_owned()).filter(|name| !name.contains('*'))
}

/// Sends a document, or why there is none, in answer to a query.
fn answer_with(query: Query, sign: Option<Sign>) -> Answer {
    Box::new(move |result: Result<Vec<u8>, String>| {
        let key = query.key_expr();
        let sent = match result {
            Ok(document) => {
                let attachment = sign.map(|sign| sign(key.as_str(), &document));
                let encoding = encoding_of(key.as_str());
                query.reply(key, document).encoding(encoding).attachment(attachment).wait()
            }
            Err(why) => query.reply_err(why).encoding(Encoding::TEXT_PLAIN).wait(),
        };
        if let Err(error) = sent {
            tracing::debug!(%key, %error, "an answer could not be sent");
        }
    })
}

fn forward_command(prefix: &str, cmd: String, query: Query, queue: &Sender<Incoming>, sign: Option<Sign>) {
    let Some(loop_name) = loop_asked(prefix, &query, Kind::Alarm) else {
        let example = topic::plane(prefix, "LOOP/alarm");
        return refuse(&query, &format!("commands go to one loop's alarm key, such as {example}"));
    };
    let parameter = |name: &str| query.parameters().get(name).map(str::to_owned);
    let for_s = match parameter("for_s").map(|text| text.parse::<u64>()) {
        None => None,
        Some(Ok(for_s)) => Some(for_s),
        Some(Err(_)) => return refuse(&query, "for_s is a whole number of seconds, such as for_s=3600"),
    };
    let command = Command { cmd, by: parameter("by"), why: parameter("why"), for_s };
    let answer = answer_with(query.clone(), sign);
    if queue.try_send(Incoming::Command { loop_name, command, answer }).is_err() {
        refuse(&query, "the daemon is too busy for commands: try again");
    }
}

fn forward_run(prefix: &str, query: Query, queue: &Sender<Incoming>, sign: Option<Sign>) {
    let Some(loop_name) = loop_asked(prefix, &query, Kind::Gap) else {
        let example = topic::plane(prefix, "LOOP/gap");
        return refuse(&query, &format!("run goes to one loop's gap key, such as {example}?run"));
    };
    let by = query.parameters().get("by").filter(|by| !by.is_empty()).map(str::to_owned);
    let answer = answer_with(query.clone(), sign);
    if queue.try_send(Incoming::GapRun { loop_name, by, answer }).is_err() {
        refuse(&query, "the daemon is too busy for a diagnosis: try again");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_zenoh_file_states_is_kept_and_the_rest_is_set() {
        let folder = tempfile::tempdir().unwrap();
        let of = |text: &str| {
            let path = folder.path().join("zenoh.json5");
            std::fs::write(&path, text).unwrap();
            let config = Config::parse(&format!("[site]\nprefix = \"p\"\n[zenoh]\nconfig_file = {path:?}\n")).unwrap();
            let session = session_config(&config).unwrap();
            let keys = ["scouting/multicast/enabled", "connect/timeout_ms", "transport/link/rx/max_message_size"];
            keys.map(|key| session.get_json(key).unwrap())
        };
        // A word in a remark or under another key states nothing.
        let elsewhere = "{ mode: 'peer', /* scouting */ listen: { timeout_ms: 5 } } // max_message_size";
        assert_eq!(of(elsewhere), ["false", "-1", "4194304"]);
        let stated = "{ scouting: { multicast: { enabled: true } }, connect: { timeout_ms: 7 }, \
                      transport: { link: { rx: { max_message_size: 1000000 } } } }";
        assert_eq!(of(stated), ["true", "7", "1000000"]);
    }
}
