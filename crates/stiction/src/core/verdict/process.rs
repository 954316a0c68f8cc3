//! The process model of an estimate, as in documents.

use serde::{Deserialize, Serialize};

/// The process model fitted with the stiction.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Process {
    /// 1 or 2.
    pub order: u8,
    /// PV units per OP unit; also per second if integrating.
    pub gain: f64,
    /// Time constants, s, largest first; empty for a pure integrator.
    pub time_constants_s: Vec<f64>,
    /// Dead time, s.
    pub dead_time_s: f64,
    /// Integrating instead of self-regulating.
    pub integrating: bool,
    /// Mean squared free-run error, PV units squared.
    pub mse: f64,
    /// 100 (1 - rms error / std PV): 100 is perfect, 0 no better than the mean.
    pub fit_pct: f64,
    /// Whether the record tests the model: a sticking valve or a moving set point moves PV apart from the controller, and the
    /// model, fitted to the first part of the record, holds in the rest. The numbers of one that is not tested are not used.
    #[serde(default = "was_not_asked")]
    pub tested: bool,
    /// Interval of the gain, from the thirds of the record; `None` where they do not tell it.
    #[serde(default)]
    pub gain_interval: Option<[f64; 2]>,
    /// Interval of the dead time, s, likewise.
    #[serde(default)]
    pub dead_time_interval_s: Option<[f64; 2]>,
}

/// Documents from before the test count as tested.
const fn was_not_asked() -> bool {
    true
}
