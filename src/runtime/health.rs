//! Health documents of the daemon and of each loop.

use std::collections::BTreeMap;
use std::sync::{Arc, RwLock};
use std::time::Instant;

use serde::Serialize;

use stiction::core::units::s_from_ns;
use stiction_engine::codec::topic::{DAEMON_HEALTH_SCHEMA, LOOP_HEALTH_SCHEMA};
use stiction_engine::engine::LoopFigures;

/// The health that the web server reads, and when it was made. It is replaced as a whole, and locked no longer than it takes to
/// copy the pointer.
pub type HealthSnapshot = Arc<RwLock<(Instant, Arc<DaemonHealth>)>>;

/// One queue's state.
#[derive(Debug, Clone, Serialize, schemars::JsonSchema)]
pub struct QueueHealth {
    /// Its name.
    pub name: &'static str,
    /// Items that wait.
    pub length: usize,
    /// Most items that may wait.
    pub limit: usize,
    /// Bytes that wait.
    pub bytes: usize,
    /// Bytes that may wait; 0 where messages are small and of one size.
    pub limit_bytes: usize,
    /// Items dropped because the queue was full.
    pub dropped: u64,
}

/// `stictiond.daemon_health.v1`.
#[derive(Debug, Clone, Serialize, schemars::JsonSchema)]
pub struct DaemonHealth {
    /// Schema name.
    pub schema: &'static str,
    /// The daemon's id.
    pub daemon: String,
    /// Version of the program.
    pub version: &'static str,
    /// Hash of its configuration.
    pub config_hash: String,
    /// Seconds since it started.
    pub uptime_s: f64,
    /// Loops that have appeared.
    pub loops: usize,
    /// Counters by name.
    pub counters: BTreeMap<&'static str, u64>,
    /// Queues.
    pub queues: Vec<QueueHealth>,
    /// What has stopped: `recording`, while a file cannot be written or the disk does not keep up.
    pub stopped: Vec<&'static str>,
    /// Faults that need attention.
    pub faults: Vec<String>,
}

impl DaemonHealth {
    /// The health before anything was counted.
    #[must_use]
    pub fn starting(daemon: &str, config_hash: &str) -> Self {
        Self {
            schema: DAEMON_HEALTH_SCHEMA,
            daemon: daemon.to_owned(),
            version: stiction::core::VERSION,
            config_hash: config_hash.to_owned(),
            uptime_s: 0.0,
            loops: 0,
            counters: BTreeMap::new(),
            queues: Vec::new(),
            stopped: Vec::new(),
            faults: Vec::new(),
        }
    }
}

/// `stictiond.loop_health.v1`.
#[derive(Debug, Clone, Serialize, schemars::JsonSchema)]
pub struct LoopHealth {
    /// Schema name.
    pub schema: &'static str,
    /// The loop's name.
    #[serde(rename = "loop")]
    pub loop_name: String,
    /// The daemon that watches it.
    pub daemon: String,
    /// Seconds between the newest source time and now; negative where the plant's clock is ahead.
    pub data_age_s: Option<f64>,
    /// Holes that ended a stretch.
    pub data_gaps: u64,
    /// Samples that were dropped: duplicate, late or stamped far off.
    pub dropped: u64,
    /// Samples that were put in for lost ones.
    pub filled: u64,
    /// Values that were missing or bad.
    pub bad: u64,
    /// Times the plant's clock was set back.
    pub clock_resets: u64,
    /// Windows that came due.
    pub windows: u64,
}

impl LoopHealth {
    /// From a loop's figures, at a given time.
    #[must_use]
    pub fn new(loop_name: &str, daemon: &str, figures: &LoopFigures, now_ns: i64) -> Self {
        let c = &figures.counts;
        Self {
            schema: LOOP_HEALTH_SCHEMA,
            loop_name: loop_name.to_owned(),
            daemon: daemon.to_owned(),
            data_age_s: figures.greatest_ns.map(|t| s_from_ns(now_ns.saturating_sub(t))),
            data_gaps: c.gaps,
            dropped: c.duplicates + c.late + c.stamp_outliers,
            filled: c.filled,
            bad: c.bad,
            clock_resets: c.clock_resets,
            windows: figures.windows,
        }
    }
}
