//! The bus side that all bridges share: where to, whether anybody listens there, and figures of what was done.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Context, anyhow};
use serde_json::json;
use zenoh::qos::CongestionControl;

use crate::cli::play::{connect, prefix};

/// How often it is looked whether somebody listens, while nobody does.
const LISTENED_EVERY: Duration = Duration::from_millis(200);
/// How often figures are told.
pub(super) const TOLD_EVERY: Duration = Duration::from_secs(60);
/// How long the bus may take to say goodbye.
const GOODBYE: Duration = Duration::from_secs(2);
/// Pause between attempts to reach the other side.
pub(super) const PAUSE: Duration = Duration::from_secs(1);

/// Flags of every bridge.
#[derive(Debug, clap::Args)]
pub struct BusArgs {
    /// Endpoint of the daemon or router on the bus.
    #[arg(long)]
    pub connect: String,
    /// First chunks of the keys.
    #[arg(long, value_parser = prefix)]
    pub prefix: String,
    /// Do not hold back what comes while nobody listens on the bus.
    #[arg(long)]
    pub no_hold: bool,
    /// Write the figures into a file as well, once a minute and at the end.
    #[arg(long, value_name = "FILE")]
    pub figures: Option<PathBuf>,
}

/// Whether a text may be published under: a key without wildcards, outside of what daemons say.
pub(super) fn is_key(key: &str) -> bool {
    let sound = |chunk: &str| !chunk.is_empty() && !chunk.starts_with('@');
    key.split('/').all(sound) && !key.contains(['*', '$', '?', '#']) && !key.chars().any(char::is_control)
}

/// A session on the bus that knows whether anybody listens to what the bridge would publish.
pub(super) struct Bus {
    session: zenoh::Session,
    listened: Arc<AtomicBool>,
}

impl Bus {
    /// Opens it.
    ///
    /// # Errors
    /// Nobody answers there.
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

    /// Ready when somebody listens.
    pub async fn until_listened(&self) {
        while !self.listened.load(Ordering::Relaxed) {
            tokio::time::sleep(LISTENED_EVERY).await;
        }
    }

    /// Publishes a payload.
    ///
    /// # Errors
    /// The session has ended, or the key is none.
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

    /// Says goodbye.
    pub async fn close(&self) {
        let _ = tokio::time::timeout(GOODBYE, self.session.close()).await;
    }
}

/// Tells figures into the log and a file.
pub(super) struct Teller {
    bridge: &'static str,
    file: Option<PathBuf>,
    told: Instant,
}

impl Teller {
    pub fn new(bridge: &'static str, args: &BusArgs) -> Self {
        Self { bridge, file: args.figures.clone(), told: Instant::now() }
    }

    /// Whether it is time to tell again.
    pub fn is_due(&self) -> bool {
        self.told.elapsed() >= TOLD_EVERY
    }

    /// Tells them now.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn tell(&mut self, line: &str, figures: &impl serde::Serialize) -> anyhow::Result<()> {
        self.told = Instant::now();
        tracing::info!("{line}");
        self.write(figures)
    }

    /// Writes the file alone.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn write(&self, figures: &impl serde::Serialize) -> anyhow::Result<()> {
        let Some(path) = &self.file else { return Ok(()) };
        let text = document(self.bridge, figures).to_string();
        std::fs::write(path, text).with_context(|| path.display().to_string())
    }
}

/// Figures as programs read them.
pub(super) fn document(bridge: &str, figures: &impl serde::Serialize) -> serde_json::Value {
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
