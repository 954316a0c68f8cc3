//! The bus side shared by all bridges: destination, presence of subscribers, and counters.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Context, anyhow};
use serde_json::json;
use zenoh::qos::CongestionControl;

use stictiond::cli::bus::{connect, prefix};

/// How often to check for subscribers while there is none.
const LISTENED_EVERY: Duration = Duration::from_millis(200);
/// How often counters are logged.
pub const TOLD_EVERY: Duration = Duration::from_secs(60);
/// Time limit for closing the session.
const GOODBYE: Duration = Duration::from_secs(2);
/// Pause between connection attempts.
pub const PAUSE: Duration = Duration::from_secs(1);

/// Options of every bridge.
#[derive(Debug, clap::Args)]
pub struct BusArgs {
    /// Zenoh endpoint of the daemon or router, such as tcp/127.0.0.1:7447.
    #[arg(long)]
    pub connect: String,
    /// Key prefix of the published values, such as plant1/area1.
    #[arg(long, value_parser = prefix)]
    pub prefix: String,
    /// Publish even while nobody subscribes, instead of holding values back.
    #[arg(long)]
    pub no_hold: bool,
    /// Also write the counters to this file (JSON), once a minute and at exit.
    #[arg(long, value_name = "FILE")]
    pub figures: Option<PathBuf>,
}

/// Whether this is a key without wildcards, outside the daemons' result keys.
pub fn is_key(key: &str) -> bool {
    let sound = |chunk: &str| !chunk.is_empty() && !chunk.starts_with('@');
    key.split('/').all(sound) && !key.contains(['*', '$', '?', '#']) && !key.chars().any(char::is_control)
}

/// A bus session that knows whether anybody subscribes to the bridge's keys.
pub struct Bus {
    session: zenoh::Session,
    listened: Arc<AtomicBool>,
}

impl Bus {
    /// Opens the session.
    ///
    /// # Errors
    /// Nothing answers at the endpoint.
    pub async fn open(args: &BusArgs) -> anyhow::Result<Self> {
        let session = connect(&args.connect).await?;
        let listened = Arc::new(AtomicBool::new(args.no_hold));
        if !args.no_hold {
            let key = format!("{}/**", args.prefix);
            let publisher = session.declare_publisher(key.clone()).await.map_err(|e| anyhow!("{key}: {e}"))?;
            let told = listened.clone();
            tokio::spawn(async move {
                loop {
                    let matching = publisher.matching_status().await.is_ok_and(|status| status.matching());
                    told.store(matching, Ordering::Relaxed);
                    tokio::time::sleep(LISTENED_EVERY).await;
                }
            });
        }
        Ok(Self { session, listened })
    }

    /// Completes when somebody subscribes.
    pub async fn until_listened(&self) {
        while !self.listened.load(Ordering::Relaxed) {
            tokio::time::sleep(LISTENED_EVERY).await;
        }
    }

    /// Publishes a payload.
    ///
    /// # Errors
    /// The session has ended, or the key is invalid.
    pub async fn put(&self, key: &str, payload: Vec<u8>, encoding: Option<String>) -> anyhow::Result<()> {
        let mut put = self
            .session
            .put(key, payload)
            .congestion_control(CongestionControl::Block)
            .timestamp(self.session.new_timestamp());
        if let Some(encoding) = encoding {
            put = put.encoding(encoding);
        }
        put.await.map_err(|e| anyhow!("{key}: {e}"))
    }

    /// Closes the session.
    pub async fn close(&self) {
        let _ = tokio::time::timeout(GOODBYE, self.session.close()).await;
    }
}

/// Writes counters to the log and a file.
pub struct Teller {
    bridge: &'static str,
    file: Option<PathBuf>,
    told: Instant,
}

impl Teller {
    pub fn new(bridge: &'static str, args: &BusArgs) -> Self {
        Self { bridge, file: args.figures.clone(), told: Instant::now() }
    }

    /// Whether the next report is due.
    pub fn is_due(&self) -> bool {
        self.told.elapsed() >= TOLD_EVERY
    }

    /// Reports the counters.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn tell(&mut self, line: &str, figures: &impl serde::Serialize) -> anyhow::Result<()> {
        self.told = Instant::now();
        tracing::info!("{line}");
        self.write(figures)
    }

    /// Writes the file only.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn write(&self, figures: &impl serde::Serialize) -> anyhow::Result<()> {
        let Some(path) = &self.file else { return Ok(()) };
        let text = document(self.bridge, figures).to_string();
        std::fs::write(path, text).with_context(|| path.display().to_string())
    }
}

/// The counters as JSON.
pub fn document(bridge: &str, figures: &impl serde::Serialize) -> serde_json::Value {
    json!({"schema": "stictiond.bridge.v1", "bridge": bridge, "figures": figures})
}

#[cfg(test)]
mod tests {
    use super::is_key;

    #[test]
    fn keys_are_outside_of_what_daemons_say() {
        assert!(is_key("p/spBv1.0/g/DDATA/n/d") && is_key("gw/FIC101.OP"));
        for bad in ["p//x", "p/@stiction/v1/A/alarm", "p/a*", "p/x#y", "p/\u{7}", ""] {
            assert!(!is_key(bad), "{bad}");
        }
    }
}
