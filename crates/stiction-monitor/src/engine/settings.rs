//! What an engine and its loops are told.

use std::collections::HashMap;
use std::sync::Arc;

use serde::Serialize;

use crate::alarm::{AlarmParams, LoopContext};
use stiction::signal::align::AlignParams;
use stiction::signal::history::{History, fitting};
use stiction::units::LoopKind;
use stiction::verdict::AssessParams;

/// When windows come due and how long they are; times in seconds.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct WindowParams {
    /// Least periods for a fit.
    pub min_periods: f64,
    /// Most periods in a window.
    pub max_periods: f64,
    /// Raw samples a period below which an estimate is called coarse.
    pub min_samples_per_period: f64,
    /// Windows end at whole multiples of this.
    pub hop_s: f64,
    /// Longest window.
    pub max_window_s: f64,
    /// Longest hole that is filled; 0 means five sampling times.
    pub max_gap_s: f64,
    /// How late a sample may come.
    pub lateness_s: f64,
    /// Points of storage per loop before samples are boxed.
    pub max_points: usize,
    /// Bytes of storage per loop; 0: as `max_points` and `max_window_s` need.
    #[serde(skip_serializing_if = "is_zero")]
    pub max_bytes: usize,
}

#[allow(clippy::trivially_copy_pass_by_ref)] // as serde calls it
const fn is_zero(bytes: &usize) -> bool {
    *bytes == 0
}

impl WindowParams {
    /// The memory of a loop that goes on after so many points.
    #[must_use]
    pub fn history(&self, total: u64) -> History {
        let history = History::resumed(self.max_points, total);
        if self.max_bytes == 0 { history } else { history.with_sizes(fitting(self.max_points, self.max_bytes)[1]) }
    }
}

impl Default for WindowParams {
    fn default() -> Self {
        let AssessParams { min_periods, min_samples_per_period, .. } = AssessParams::default();
        Self {
            min_periods,
            max_periods: 20.0,
            min_samples_per_period,
            hop_s: 600.0,
            max_window_s: 604_800.0,
            max_gap_s: 0.0,
            lateness_s: 5.0,
            max_points: 2000,
            max_bytes: 0,
        }
    }
}

/// When gaps are diagnosed, and how long is searched.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct GapParams {
    /// Whether a loop that departs from its model is diagnosed without being asked.
    pub enabled: bool,
    /// Model responses that one search may compute; a diagnosis with a recorded valve position makes two.
    pub budget_evaluations: u64,
}

impl Default for GapParams {
    fn default() -> Self {
        Self { enabled: true, budget_evaluations: 400_000 }
    }
}

/// Settings of a loop, shared by all loops that say nothing of their own.
#[derive(Debug, Clone, PartialEq)]
pub struct LoopSettings {
    /// How its signals are joined.
    pub align: AlignParams,
    /// Its windows.
    pub window: WindowParams,
    /// Its alarm.
    pub alarm: AlarmParams,
    /// Its estimates.
    pub assess: AssessParams,
    /// Its gap diagnoses.
    pub gap: GapParams,
    /// Where it belongs and what it is worth.
    pub place: LoopContext,
}

/// Settings of an engine.
#[derive(Debug, Clone)]
pub struct EngineSettings {
    /// Hash of what all this was read from, as documents carry it.
    pub config_hash: Arc<str>,
    /// Id of the daemon, as its documents carry it; none outside one.
    pub daemon: Option<Arc<str>>,
    /// Loops beyond this many do not appear.
    pub max_loops: usize,
    /// Settings of loops that have none of their own, by what their tags say they control.
    pub common: [Arc<LoopSettings>; LoopKind::ALL.len()],
    /// Settings of loops that have their own, by name: their places are kept.
    pub own: Arc<HashMap<String, Arc<LoopSettings>>>,
}

impl EngineSettings {
    /// A loop's settings: its own, or those of its kind.
    #[must_use]
    pub fn of(&self, name: &str) -> &Arc<LoopSettings> {
        self.own.get(name).unwrap_or_else(|| &self.common[LoopKind::of_tag(name) as usize])
    }
}
