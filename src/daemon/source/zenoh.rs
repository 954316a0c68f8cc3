//! The Zenoh session: its settings, and one wildcard subscription per prefix.
//!
//! The subscriber's callback runs on the bus's own threads, so it only puts the message into the engine's queue; a full
//! queue drops the message and counts it.

use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, PoisonError, RwLock};
use std::time::Duration;

use anyhow::{Context, anyhow};
use serde_json::Value;
use zenoh::Wait;
use zenoh::bytes::Encoding;
use zenoh::pubsub::Subscriber;
use zenoh::sample::{Sample as BusSample, SampleKind};

use super::keys::{ShardFilter, subscriptions};
use super::{Envelope, Intake};
use crate::runtime::tls;
use stiction_engine::codec::topic;
use stiction_engine::config::Config;

/// Largest message that Zenoh puts together from its pieces, bytes: what is larger never takes memory. Well above what a
/// payload may have, so that payloads a little too large are still seen and counted.
const MAX_MESSAGE: usize = 4 << 20;

/// How long a connection may take to say who it is, and how many may be at it. Those that say nothing keep others out, a
/// place for the time: so it is short, and the places are many, within the descriptors of the unit.
const ACCEPT_WITHIN: Duration = Duration::from_secs(1);
const ACCEPTED: usize = 2000;

/// The prefix of a schema's encoding.
const SCHEMA: &str = "https://json-schema.org/draft/2020-12/schema";

/// How long Zenoh waits for a reader that has no room before it drops a document for it: what took less met none.
pub const NOT_TAKEN: Duration = Duration::from_millis(10);
/// The setting's name; microseconds.
const WAIT_BEFORE_DROP: &str = "transport/link/tx/queue/congestion_control/drop/wait_before_drop";
/// What Zenoh is told to do with messages of others. Answers have the priority of their query, and no document has this one:
/// a publisher would wait behind an answer that waits for its reader. What the session passes on for others is dropped for
/// a reader that does not keep up.
const OVERWRITES: [&str; 2] = [
    r#"{"id": "stictiond answers", "messages": ["query"], "flows": ["ingress"],
        "overwrite": {"priority": "data_low"}}"#,
    r#"{"id": "stictiond passes on", "messages": ["put", "delete"], "flows": ["egress"],
        "qos": {"congestion_control": "block"}, "overwrite": {"congestion_control": "drop"}}"#,
];

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
    let overwrites =
        session.get_json("qos/network").ok().and_then(|text| serde_json::from_str::<Vec<Value>>(&text).ok());
    let overwrites = overwrites.unwrap_or_default();
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
        ("transport/unicast/accept_timeout", ACCEPT_WITHIN.as_millis().to_string()),
        ("transport/unicast/accept_pending", ACCEPTED.to_string()),
        // Batches of 64 KiB for documents that come at once: a reader that is a little behind misses none.
        ("transport/link/tx/queue/size/data", "8".to_owned()),
        ("transport/link/tx/queue/size/interactive_high", "8".to_owned()),
    ];
    wanted.extend(unsaid.into_iter().filter(|(key, _)| !said(key)));
    let mut set = |key: &str, value: String| {
        session.insert_json5(key, &value).map_err(|e| anyhow!("Zenoh refuses {key} = {value}: {e}"))
    };
    for (key, value) in wanted {
        set(key, value)?;
    }
    set(WAIT_BEFORE_DROP, NOT_TAKEN.as_micros().to_string())?;
    let stated = overwrites.iter().map(ToString::to_string).chain(OVERWRITES.map(str::to_owned));
    set("qos/network", format!("[{}]", stated.collect::<Vec<_>>().join(",")))?;
    if !z.connect.is_empty() {
        set("connect/endpoints", serde_json::to_string(&z.connect)?)?;
    }
    if ["listen/endpoints", "connect/endpoints"]
        .iter()
        .any(|key| session.get_json(key).is_ok_and(|e| e.contains("\"tls/")))
    {
        tls::required("an endpoint tls/...")?;
    }
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
    // Opening blocks until a client's router is there; on a separate thread it can be abandoned.
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

/// The subscriptions of a configuration, which follow it when it is edited.
pub struct Subscriptions {
    session: zenoh::Session,
    intake: Intake,
    /// None where all loops are this daemon's, which no edit changes.
    filter: Option<Arc<RwLock<ShardFilter>>>,
    open: BTreeMap<String, Subscriber<()>>,
}

impl Subscriptions {
    /// Subscribes.
    ///
    /// # Errors
    /// A key that Zenoh refuses.
    pub async fn open(session: &zenoh::Session, config: &Config, intake: Intake) -> anyhow::Result<Self> {
        let filter = ShardFilter::new(config).map(|filter| Arc::new(RwLock::new(filter)));
        let mut subscriptions = Self { session: session.clone(), intake, filter, open: BTreeMap::new() };
        subscriptions.follow(config).await?;
        Ok(subscriptions)
    }

    /// Subscribes to keys that are new in an edited configuration and gives up those that are gone. All others stay as they
    /// are: nothing of them is lost or comes twice.
    ///
    /// # Errors
    /// A key that Zenoh refuses.
    pub async fn follow(&mut self, config: &Config) -> anyhow::Result<()> {
        if let (Some(filter), Some(fresh)) = (&self.filter, ShardFilter::new(config)) {
            *filter.write().unwrap_or_else(PoisonError::into_inner) = fresh;
        }
        let wanted: BTreeSet<String> = subscriptions(config).into_iter().collect();
        for key in &wanted {
            if !self.open.contains_key(key) {
                let subscriber = self.subscribe(key).await?;
                self.open.insert(key.clone(), subscriber);
            }
        }
        let gone: Vec<String> = self.open.keys().filter(|key| !wanted.contains(*key)).cloned().collect();
        for subscriber in gone.iter().filter_map(|key| self.open.remove(key)).collect::<Vec<_>>() {
            let _ = subscriber.undeclare().await;
        }
        Ok(())
    }

    async fn subscribe(&self, key: &str) -> anyhow::Result<Subscriber<()>> {
        let (intake, filter) = (self.intake.clone(), self.filter.clone());
        let take = move |sample: BusSample| {
            let admits = |filter: &Arc<RwLock<ShardFilter>>| {
                filter.read().unwrap_or_else(PoisonError::into_inner).admits(sample.key_expr().as_str())
            };
            if filter.as_ref().is_none_or(admits) {
                enqueue(&sample, &intake);
            }
        };
        let declared = self.session.declare_subscriber(key.to_owned()).callback(take).await;
        declared.map_err(|e| anyhow!("cannot subscribe to {key:?}: {e}"))
    }

    /// Gives all subscriptions up.
    pub async fn close(self) {
        for subscriber in self.open.into_values() {
            let _ = subscriber.undeclare().await;
        }
    }
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
        sender: sender_of(sample),
    };
    let payload = sample.payload();
    intake.take(&envelope, payload.len(), |bytes| payload.slices().for_each(|part| bytes.extend_from_slice(part)));
}

/// Who published a message: the session of its source information, else the one that stamped it.
fn sender_of(sample: &BusSample) -> Option<u64> {
    let session = sample.source_info().map(|info| u128::from_le_bytes(info.source_id().zid().to_le_bytes()));
    let id = session.or_else(|| sample.timestamp().map(|t| u128::from_le_bytes(t.get_id().to_le_bytes())))?;
    Some((id ^ id >> 64) as u64)
}

/// The encoding of a document under a key of the daemon, with its schema's name.
#[must_use]
pub fn encoding_of(key: &str) -> Encoding {
    match topic::schema_of(key) {
        Some(schema) => Encoding::APPLICATION_JSON.with_schema(schema),
        None if key.contains("/@schema/") => Encoding::APPLICATION_JSON.with_schema(SCHEMA),
        None => Encoding::APPLICATION_JSON,
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
