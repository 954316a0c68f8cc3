//! Whether the daemon is on the bus at all, alone under its id, and the only one that publishes under its keys.

use std::sync::Arc;
use std::time::Duration;

use anyhow::anyhow;
use zenoh::Wait;
use zenoh::sample::Locality;

use super::own::Own;
use crate::daemon::clock::now_ns;
use crate::daemon::faults::Faults;
use crate::daemon::metrics::Metrics;
use stiction_monitor::codec::topic::{self, Kind, Leaf, Topic};

/// Name of the fault while the session cannot listen.
pub const LISTENING: &str = "listening";
/// How often it is looked.
const EVERY: Duration = Duration::from_secs(5);
/// How long a second session may look for the id.
const PROBE_WITHIN: Duration = Duration::from_secs(3);
/// How long foreign documents stay a fault after the last one.
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
            faults.raise("bus", "not connected to the bus: no router or peer answers; it is tried for ever");
        }
    }
}

/// Watches a session that could not listen until it can. The ports are tried by the session itself.
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

/// What the endpoints in a text end with: `:PORT`, or the path of a socket.
fn ports_of(text: &str) -> Vec<String> {
    let endpoints = text.split('"').filter(|part| part.contains('/'));
    endpoints.map(|e| e.rfind(':').map_or_else(|| e.to_owned(), |at| e[at..].to_owned())).collect()
}

/// Whether somebody else on the bus lives under this id: asked by a session with another one.
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

/// Counts and names documents that others put under our keys: another daemon with this prefix, or forged ones.
///
/// # Errors
/// A key that Zenoh refuses.
pub async fn watch_own_keys(
    session: &zenoh::Session,
    prefix: &str,
    own: Own,
    faults: Arc<Faults>,
    metrics: Arc<Metrics>,
) -> anyhow::Result<zenoh::pubsub::Subscriber<()>> {
    let key = topic::plane(prefix, "**");
    let of = prefix.to_owned();
    let note = move |sample: zenoh::sample::Sample| {
        // Others that share the loops speak of theirs, and of all while they hand them over.
        if !own.is_all()
            && Topic::parse(Some(&of), sample.key_expr().as_str())
                .is_some_and(|t| t.leaf == Leaf::Document(Kind::State) || !own.has(t.loop_name))
        {
            return;
        }
        metrics.foreign_documents.inc();
        let (count, key) = (metrics.foreign_documents.get(), sample.key_expr().as_str().escape_debug().to_string());
        let key: String = key.chars().take(120).collect();
        let what = "another daemon with this prefix, or forged";
        let text = format!("{count} documents under our keys are not ours, the last on {key}: {what}");
        faults.raise_for("foreign documents", text, FOREIGN_SHOWN);
    };
    let declared = session.declare_subscriber(key.clone()).allowed_origin(Locality::Remote).callback(note).await;
    declared.map_err(|e| anyhow!("cannot subscribe to {key:?}: {e}"))
}
