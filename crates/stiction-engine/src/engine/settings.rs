//! Settings of an engine and its loops.

use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use crate::alarm::{AlarmParams, LoopContext};
use stiction::core::record::Signal;
use stiction::core::units::LoopKind;
use stiction::core::verdict::AssessParams;
use stiction::samples::align::AlignParams;
use stiction::samples::history::{History, fitting};

/// When windows come due and how long they are; times in seconds.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct WindowParams {
    /// Fewest periods for a fit.
    pub min_periods: f64,
    /// Most periods in a window.
    pub max_periods: f64,
    /// Raw samples per period below which an estimate is called coarse.
    pub min_samples_per_period: f64,
    /// Reversals of the stem above which a window counts, whatever its number of periods.
    pub min_reversals: usize,
    /// Windows end at whole multiples of this.
    pub hop_s: f64,
    /// Longest window.
    pub max_window_s: f64,
    /// Longest data gap that is filled; 0 means five sampling times.
    pub max_gap_s: f64,
    /// How late a sample may come.
    pub lateness_s: f64,
    /// Stored points per loop above which samples are averaged in boxes.
    pub max_points: usize,
    /// Stored bytes per loop; 0: as required by `max_points` and `max_window_s`.
    #[serde(skip_serializing_if = "is_zero")]
    pub max_bytes: usize,
}

#[allow(clippy::trivially_copy_pass_by_ref)] // as serde calls it
const fn is_zero(bytes: &usize) -> bool {
    *bytes == 0
}

impl WindowParams {
    /// The history of a loop that continues after this many points.
    #[must_use]
    pub fn history(&self, total: u64) -> History {
        let history = History::resumed(self.max_points, total);
        if self.max_bytes == 0 { history } else { history.with_sizes(fitting(self.max_points, self.max_bytes)[1]) }
    }
}

impl Default for WindowParams {
    fn default() -> Self {
        let AssessParams { min_periods, min_samples_per_period, min_reversals, .. } = AssessParams::default();
        Self {
            min_periods,
            max_periods: 20.0,
            min_samples_per_period,
            min_reversals,
            hop_s: 600.0,
            max_window_s: 604_800.0,
            max_gap_s: 0.0,
            lateness_s: 5.0,
            max_points: 2000,
            max_bytes: 0,
        }
    }
}

/// When gaps are diagnosed, and how long the search may take.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct GapParams {
    /// Whether a loop that departs from its model is diagnosed automatically.
    pub enabled: bool,
    /// Most model responses in one search; a diagnosis with a recorded valve position makes two searches.
    pub budget_evaluations: u64,
}

impl Default for GapParams {
    fn default() -> Self {
        Self { enabled: true, budget_evaluations: 400_000 }
    }
}

/// Settings of a loop, shared by all loops without a `[[loop]]` entry.
#[derive(Debug, Clone, PartialEq)]
pub struct LoopSettings {
    /// Foreign keys of its signals.
    pub keys: Vec<(Signal, String)>,
    /// How its signals are aligned.
    pub align: AlignParams,
    /// Its windows.
    pub window: WindowParams,
    /// Its alarm.
    pub alarm: AlarmParams,
    /// Its estimates.
    pub assess: AssessParams,
    /// Its gap diagnoses.
    pub gap: GapParams,
    /// Its configured context.
    pub place: LoopContext,
}

impl LoopSettings {
    /// Whether a window continues under other settings: its samples come from the same keys and are aligned in the same way,
    /// and its length, memory and end are the same. Settings of the fit and of the alarm may differ.
    #[must_use]
    pub fn window_continues_under(&self, other: &Self) -> bool {
        let sizes = |w: &WindowParams| (w.hop_s, w.max_window_s, w.max_points, w.max_bytes);
        (&self.keys, &self.align, sizes(&self.window)) == (&other.keys, &other.align, sizes(&other.window))
    }
}

/// The configurations that the loops' settings come from, by hash. So an edit that leaves a loop alone leaves its documents
/// identical.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Origins {
    /// Hash for all loops that are not listed.
    pub others: String,
    /// Hash for each of the other loops.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub loops: BTreeMap<String, String>,
}

impl Origins {
    /// All settings from one configuration.
    #[must_use]
    pub fn new(config_hash: &str) -> Self {
        Self { others: config_hash.to_owned(), loops: BTreeMap::new() }
    }

    fn of(&self, name: &str) -> &str {
        self.loops.get(name).unwrap_or(&self.others)
    }
}

/// Settings of an engine.
#[derive(Debug, Clone)]
pub struct EngineSettings {
    /// Hash of the configuration in force.
    pub config_hash: Arc<str>,
    /// Where each loop's settings come from.
    pub origins: Origins,
    /// Id of the daemon, which its documents carry; `None` outside a daemon.
    pub daemon: Option<Arc<str>>,
    /// Most loops.
    pub max_loops: usize,
    /// Settings of loops without a `[[loop]]` entry, by the quantity that their tags indicate.
    pub common: [Arc<LoopSettings>; LoopKind::ALL.len()],
    /// Settings of loops with an entry, by name; places are reserved for them.
    pub own: Arc<HashMap<String, Arc<LoopSettings>>>,
}

impl EngineSettings {
    /// A loop's settings: its own, or those for its kind.
    #[must_use]
    pub fn of(&self, name: &str) -> &Arc<LoopSettings> {
        self.own.get(name).unwrap_or_else(|| &self.common[LoopKind::of_tag(name) as usize])
    }

    /// Hash of the configuration that a loop's settings come from, as in its documents.
    #[must_use]
    pub fn origin_of(&self, name: &str) -> Arc<str> {
        self.origins.of(name).into()
    }

    /// These settings after previous ones: loops with unchanged settings keep their origin.
    #[must_use]
    pub fn in_place_of(self, before: &Self) -> Self {
        let own_hash = &*self.config_hash;
        let others = if before.common == self.common { &before.origins.others } else { own_hash };
        let mut origins = Origins::new(others);
        for (name, settings) in self.own.iter() {
            let is_same = before.own.get(name) == Some(settings);
            let origin = if is_same { before.origins.of(name) } else { own_hash };
            if origin != origins.others {
                origins.loops.insert(name.clone(), origin.to_owned());
            }
        }
        Self { origins, daemon: before.daemon.clone(), ..self }
    }
}
