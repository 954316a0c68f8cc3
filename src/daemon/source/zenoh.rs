//! The Zenoh session: its settings, and one wildcard subscription per prefix.
//!
//! The subscriber's callback runs on Zenoh's threads, so it only puts the message into the engine's queue; if the queue is full
//! it drops the message and counts it.

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

/// Largest message that Zenoh assembles from fragments, bytes; larger ones never use memory. Well above the limit for payloads,
/// so that slightly oversized payloads are still seen and counted.
const MAX_MESSAGE: usize = 4 << 20;

/// How long a connection may take to identify itself, and how many may be doing so. A connection that never does blocks a place
/// for that time, so the time is short and the places are many, within the descriptor limit of the unit.
const ACCEPT_WITHIN: Duration = Duration::from_secs(1);
const ACCEPTED: usize = 2000;

/// The prefix of a schema's encoding.
const SCHEMA: &str = "https://json-schema.org/draft/2020-12/schema";

/// How long Zenoh waits for a reader without room before it drops a document for it. A faster return means that no reader was
/// full.
pub const NOT_TAKEN: Duration = Duration::from_millis(10);
/// Zenoh's setting for it, in microseconds.
const WAIT_BEFORE_DROP: &str = "transport/link/tx/queue/congestion_control/drop/wait_before_drop";
/// Settings for the priority of messages. Replies have the priority of their query, and no document has that one: otherwise a
/// document would wait behind a reply that waits for its reader. Messages that the session routes for others are dropped for a
/// reader that does not keep up.
const OVERWRITES: [&str; 2] = [
    r#"{"id": "stictiond answers", "messages": ["query"], "flows": ["ingress"],
        "overwrite": {"priority": "data_low"}}"#,
    r#"{"id": "stictiond passes on", "messages": ["put", "delete"], "flows": ["egress"],
        "qos": {"congestion_control": "block"}, "overwrite": {"congestion_control": "drop"}}"#,
];

/// Makes the Zenoh configuration from ours.
///
/// # Errors
/// The configuration file cannot be read, or Zenoh refuses a setting.
pub fn session_config(config: &Config) -> anyhow::Result<zenoh::Config> {
    let z = &config.zenoh;
    let mut session = if z.config_file.is_empty() {
        zenoh::Config::default()
    } else {
        zenoh::Config::from_file(&z.config_file)
            .map_err(|e| anyhow!("[zenoh] config_file {:?} cannot be used: {e}", z.config_file))?
    };
    let plain = zenoh::Config::default();
    // A setting counts as stated in the file if it differs from Zenoh's default; so a limit equal to Zenoh's counts as not
    // stated.
    let said = |key: &str| session.get_json(key).ok() != plain.get_json(key).ok();
    let overwrites =
        session.get_json("qos/network").ok().and_then(|text| serde_json::from_str::<Vec<Value>>(&text).ok());
    let overwrites = overwrites.unwrap_or_default();
    let own = z.config_file.is_empty();
    let mut wanted = Vec::new();
    if own {
        wanted.push(("mode", format!("{:?}", z.mode.name())));
    }
    if own || !z.listen.is_empty() {
        wanted.push(("listen/endpoints", serde_json::to_string(&z.listen)?));
    }
    // By default Zenoh scouts and gives up. Keep trying for ever instead: the router may start after us, stop and come back.
    let unsaid = [
        ("scouting/multicast/enabled", z.multicast.to_string()),
        ("connect/timeout_ms", "-1".to_owned()),
        ("connect/exit_on_failure", "false".to_owned()),
        ("transport/link/rx/max_message_size", MAX_MESSAGE.to_string()),
        ("transport/unicast/accept_timeout", ACCEPT_WITHIN.as_millis().to_string()),
        ("transport/unicast/accept_pending", ACCEPTED.to_string()),
        // Batches of 64 KiB for documents that come at once, so that a reader slightly behind misses none.
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

/// Opens the session; returns the reason if it could not listen. It then continues without listening, and keeps trying. Waits
/// for a router that is not there yet.
///
/// # Errors
/// The session cannot be opened; names the endpoints.
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

/// The subscriptions of a configuration, kept up to date when it is edited.
pub struct Subscriptions {
    session: zenoh::Session,
    intake: Intake,
    /// `None` if this daemon serves all loops, which no edit changes.
    filter: Option<Arc<RwLock<ShardFilter>>>,
    open: BTreeMap<String, Subscriber<()>>,
}

impl Subscriptions {
    /// Subscribes.
    ///
    /// # Errors
    /// Zenoh refuses a key.
    pub async fn open(session: &zenoh::Session, config: &Config, intake: Intake) -> anyhow::Result<Self> {
        let filter = ShardFilter::new(config).map(|filter| Arc::new(RwLock::new(filter)));
        let mut subscriptions = Self { session: session.clone(), intake, filter, open: BTreeMap::new() };
        subscriptions.follow(config).await?;
        Ok(subscriptions)
    }

    /// Subscribes to the new keys of an edited configuration and ends the subscriptions to removed ones. All others are left
    /// alone, so that they lose nothing and receive nothing twice.
    ///
    /// # Errors
    /// Zenoh refuses a key.
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

    /// Ends all subscriptions.
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
    // Borrowed if the encoding is one of Zenoh's predefined ones without a schema.
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

/// The publisher of a message: the session in its source information, else the one that stamped it.
fn sender_of(sample: &BusSample) -> Option<u64> {
    let session = sample.source_info().map(|info| u128::from_le_bytes(info.source_id().zid().to_le_bytes()));
    let id = session.or_else(|| sample.timestamp().map(|t| u128::from_le_bytes(t.get_id().to_le_bytes())))?;
    Some((id ^ id >> 64) as u64)
}

/// The encoding of a document under one of the daemon's keys, with the name of its schema.
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
        // A word in a comment or under another key is not a setting.
        let elsewhere = "{ mode: 'peer', /* scouting */ listen: { timeout_ms: 5 } } // max_message_size";
        assert_eq!(of(elsewhere), ["false", "-1", "4194304"]);
        let stated = "{ scouting: { multicast: { enabled: true } }, connect: { timeout_ms: 7 }, \
                      transport: { link: { rx: { max_message_size: 1000000 } } } }";
        assert_eq!(of(stated), ["true", "7", "1000000"]);
    }
}
