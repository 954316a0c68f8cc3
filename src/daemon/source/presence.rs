//! Checks that the daemon is on the bus, alone under its id, and the only publisher under its keys.

use std::sync::Arc;
use std::time::Duration;

use anyhow::anyhow;
use zenoh::Wait;
use zenoh::sample::{Locality, Sample as BusSample};

use crate::runtime::clock::now_ns;
use crate::runtime::faults::{Faults, without_places};
use crate::runtime::metrics::Metrics;
use stiction_engine::codec::topic::{self, Topic};
use stiction_engine::shard::Shard;

/// Name of the fault while the session cannot listen.
pub const LISTENING: &str = "listening";
/// Interval between checks.
const EVERY: Duration = Duration::from_secs(5);
/// How long a second session may look for the id.
const PROBE_WITHIN: Duration = Duration::from_secs(3);
/// How long foreign documents remain a fault after the last one.
const FOREIGN_SHOWN: Duration = Duration::from_secs(60);

/// Watches the session for ever.
pub async fn watch(
    session: zenoh::Session,
    config: zenoh::Config,
    (prefix, daemon_id): (String, String),
    faults: Arc<Faults>,
) {
    let expected = config.get_json("connect/endpoints").is_ok_and(|text| text.contains('/'));
    let own_id = config.get_json("id").is_ok_and(|text| text != "null");
    let mut alone = 0;
    loop {
        tokio::time::sleep(EVERY).await;
        let info = session.info();
        let links = info.routers_zid().await.count() + info.peers_zid().await.count();
        if links > 0 || !expected {
            alone = 0;
            faults.clear("bus");
            continue;
        }
        alone += 1;
        if alone < 2 {
            continue;
        }
        let id = session.zid().to_string();
        if own_id && taken(&config, &prefix, &daemon_id).await {
            let remedy = "it hears nothing until that one ends; give each an id of its own, or leave id out";
            faults.raise("bus", format!("another daemon uses the Zenoh id {id} of this one: {remedy}"));
        } else {
            faults.raise("bus", "not connected to the bus: no router or peer answers; retrying");
        }
    }
}

/// Why Zenoh could not listen, without the places in Zenoh's source that its errors name.
#[must_use]
pub fn listener_problem(listen: &[String], error: &str) -> String {
    match error.contains("in use") {
        true => format!("{} is taken (is another stictiond running?)", listen.join(", ")),
        false => without_places(error),
    }
}

/// Watches a session that could not listen until it can. The session itself keeps trying the ports.
pub async fn watch_listening(session: zenoh::Session, config: zenoh::Config, faults: Arc<Faults>) {
    let wanted: Vec<String> = config.get_json("listen/endpoints").map(|text| ports_of(&text)).unwrap_or_default();
    loop {
        tokio::time::sleep(EVERY).await;
        let there: Vec<String> = session.info().locators().await.iter().map(ToString::to_string).collect();
        if wanted.iter().all(|port| there.iter().any(|locator| locator.contains(port.as_str()))) {
            return faults.clear(LISTENING);
        }
    }
}

/// The endings of the endpoints in a text: `:PORT`, or the path of a socket.
fn ports_of(text: &str) -> Vec<String> {
    let endpoints = text.split('"').filter(|part| part.contains('/'));
    endpoints.map(|e| e.rfind(':').map_or_else(|| e.to_owned(), |at| e[at..].to_owned())).collect()
}

/// Whether another daemon on the bus uses this id, checked by a session with a different id.
async fn taken(config: &zenoh::Config, prefix: &str, id: &str) -> bool {
    let mut config = config.clone();
    let other = format!("{:?}", format!("{:x}", now_ns().max(1)));
    let set = [
        ("id", other.as_str()),
        ("listen/endpoints", "[]"),
        ("connect/timeout_ms", "2000"),
        ("connect/exit_on_failure", "true"),
    ];
    if set.into_iter().any(|(key, value)| config.insert_json5(key, value).is_err()) {
        return false;
    }
    let key = topic::plane(prefix, &format!("@daemon/{id}"));
    let asked = tokio::task::spawn_blocking(move || {
        let session = zenoh::open(config).wait().ok()?;
        let replies = session.liveliness().get(key).timeout(PROBE_WITHIN).wait().ok()?;
        let found = replies.recv().is_ok();
        let _ = session.close().wait();
        Some(found)
    });
    matches!(tokio::time::timeout(4 * PROBE_WITHIN, asked).await, Ok(Ok(Some(true))))
}

/// Watches for other daemons that do the same work: documents of its loops under its keys, and health under its id.
///
/// # Errors
/// Zenoh refuses a key.
pub async fn watch_own_keys(
    session: &zenoh::Session,
    (prefix, daemon_id, shard): (&str, &str, Shard),
    faults: &Arc<Faults>,
    metrics: &Arc<Metrics>,
) -> anyhow::Result<[zenoh::pubsub::Subscriber<()>; 2]> {
    let (of, (raised, counted)) = (prefix.to_owned(), (faults.clone(), metrics.clone()));
    let note_document = move |sample: BusSample| {
        // Other shards publish their own loops.
        if Topic::parse(Some(&of), sample.key_expr().as_str()).is_some_and(|t| !shard.owns(t.loop_name)) {
            return;
        }
        counted.foreign_documents.inc();
        let (count, key) = (counted.foreign_documents.get(), sample.key_expr().as_str().escape_debug().to_string());
        let key: String = key.chars().take(120).collect();
        let what = "another daemon has the same prefix and shard, or somebody forges them";
        let text = format!("{count} documents under this daemon's keys come from elsewhere, the last on {key}: {what}");
        raised.raise_for("foreign documents", text, FOREIGN_SHOWN);
    };
    let (id, raised) = (daemon_id.to_owned(), faults.clone());
    let note_health = move |_: BusSample| {
        let text = format!("another daemon on the bus has the id {id}: give each its own [daemon] id or --id");
        raised.raise_for("duplicate id", text, FOREIGN_SHOWN);
    };
    let health = format!("@daemon/{daemon_id}/health");
    let documents = listen(session, topic::plane(prefix, "**"), note_document).await?;
    Ok([documents, listen(session, topic::plane(prefix, &health), note_health).await?])
}

/// Subscribes to what others publish under a key.
async fn listen(
    session: &zenoh::Session,
    key: String,
    note: impl Fn(BusSample) + Send + Sync + 'static,
) -> anyhow::Result<zenoh::pubsub::Subscriber<()>> {
    let declared = session.declare_subscriber(key.clone()).allowed_origin(Locality::Remote).callback(note).await;
    declared.map_err(|e| anyhow!("cannot subscribe to {key:?}: {e}"))
}
