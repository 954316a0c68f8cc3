//! A session on the bus for commands that publish or listen.

use std::time::Duration;

use crate::runtime::faults::without_places;
use crate::runtime::tls;
use anyhow::anyhow;

/// Time limit for connecting.
const CONNECT_WITHIN: Duration = Duration::from_secs(10);
/// Time for declarations to propagate after connecting.
const SETTLE: Duration = Duration::from_millis(500);
/// How long a put waits for a receiver that is busy, µs.
const PATIENCE_US: &str = "60000000";

/// A key prefix, parsed from an option.
///
/// # Errors
/// The text is not a valid prefix.
pub fn prefix(text: &str) -> Result<String, String> {
    if stiction::core::units::is_loop_name(text) {
        Ok(text.to_owned())
    } else {
        Err("write a key prefix such as plant1/area1".into())
    }
}

/// A Zenoh endpoint, parsed from an option.
///
/// # Errors
/// The text is not an endpoint.
pub fn endpoint(text: &str) -> Result<String, String> {
    match text.split_once('/') {
        Some((protocol, address)) if !protocol.is_empty() && !address.is_empty() => Ok(text.to_owned()),
        _ => Err("write an endpoint such as tcp/127.0.0.1:7447".to_owned()),
    }
}

/// Opens a session connected to an endpoint.
///
/// # Errors
/// Nothing answers there in time.
pub async fn connect(endpoint: &str) -> anyhow::Result<zenoh::Session> {
    if endpoint.starts_with("tls/") {
        tls::required(endpoint)?;
    }
    let mut config = zenoh::Config::default();
    let endpoints = serde_json::to_string(&[endpoint])?;
    let timeout = CONNECT_WITHIN.as_millis().to_string();
    let settings = [
        ("mode", "\"client\""),
        ("scouting/multicast/enabled", "false"),
        ("connect/endpoints", endpoints.as_str()),
        ("connect/timeout_ms", timeout.as_str()),
        ("connect/exit_on_failure", "true"),
        ("transport/link/tx/queue/congestion_control/block/wait_before_close", PATIENCE_US),
    ];
    for (key, value) in settings {
        config.insert_json5(key, value).map_err(|e| anyhow!("Zenoh rejects the setting {key} = {value}: {e}"))?;
    }
    let session = zenoh::open(config).await.map_err(|e| {
        anyhow!(
            "no answer from {endpoint} within {} s; check the endpoint and that a daemon or router is running there ({})",
            CONNECT_WITHIN.as_secs(),
            without_places(&e.to_string())
        )
    })?;
    tokio::time::sleep(SETTLE).await;
    Ok(session)
}
