//! Curves over time, and the recorded samples behind them.

use std::collections::BTreeSet;
use std::time::{Duration, Instant};

use serde::Serialize;

use stiction::core::record::Signal;
use stiction_engine::codec;
use stiction_engine::codec::topic;
use stiction_files::LoadedLoop;
use stiction_files::archive::{Archive, Reach, Wanted};

/// How long a search in the recordings may take before it returns what it has.
pub(super) const PATIENCE: Duration = Duration::from_secs(4);

/// Curves over a common time axis; null where a value is missing.
#[derive(Debug, Clone, PartialEq, Serialize, schemars::JsonSchema)]
pub struct Curves {
    /// Stamps, ms since 1970.
    pub t_ms: Vec<f64>,
    /// Controller output.
    pub op: Vec<Option<f64>>,
    /// Process variable.
    pub pv: Vec<Option<f64>>,
    /// Set point, if one is known.
    pub sp: Option<Vec<Option<f64>>>,
}

/// Values, with `None` for those that are not finite.
pub(super) fn known(values: &[f64]) -> Vec<Option<f64>> {
    values.iter().map(|v| Some(*v).filter(|v| v.is_finite())).collect()
}

/// A loop's samples in the recordings, oldest file first.
pub(super) fn recorded(archive: &Archive, name: &str, signals: &[Signal], range_ns: [i64; 2]) -> LoadedLoop {
    recorded_within(archive, name, signals, range_ns).0
}

/// The same, and how far back the search came.
pub(super) fn recorded_within(
    archive: &Archive,
    name: &str,
    signals: &[Signal],
    range_ns: [i64; 2],
) -> (LoadedLoop, Reach) {
    let topics: Vec<(String, Signal)> = signals.iter().map(|s| (topic::raw(archive.prefix(), name, *s), *s)).collect();
    let names: BTreeSet<String> = topics.iter().map(|(topic, _)| topic.clone()).collect();
    let wanted = Wanted { topics: names, range_ns, until: Instant::now() + PATIENCE };
    let mut one = LoadedLoop::new(name, Vec::new());
    let reach = archive.read(&wanted, &mut |found| {
        let Some((_, signal)) = topics.iter().find(|(topic, _)| topic == found.topic) else { return };
        // Unreadable samples were counted when they arrived.
        let _ = codec::decode(*signal, found.data, Some(found.encoding), None, found.t_ns, &mut one.samples);
    });
    // Files come newest first; a stable sort keeps the order of equal stamps.
    one.samples.sort_by_key(|sample| sample.t_ns);
    (one, reach)
}
