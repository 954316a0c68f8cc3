//! Benefit of a valve repair: simulates the closed loop as it is, without stiction, and with half the controller gain.
//!
//! The loop comes from the record and its assessment: valve and process as fitted, the identified controller, and as
//! disturbance the residuals of PV, resampled in blocks. Without stiction the disturbance is between the measurement noise
//! and all of the residuals, because the part due to model error, which would vanish with the cycle, is unknown. Valve,
//! process and controller are drawn from those compatible with the record; a draw is kept only if its loop moves PV as
//! recorded. The spread of the draws gives the intervals. `docs/plant.md` has the figures.

mod draws;
mod plant;
mod run;
mod words;

use serde::Serialize;
use thiserror::Error;

use crate::core::record::Record;
use crate::core::verdict::Assessment;

/// Options of the simulation. The defaults are the daemon's.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RepairParams {
    /// OP's range if known; otherwise OP may leave the recorded range by ten spans.
    pub op_range: Option<[f64; 2]>,
    /// Seed of all draws.
    pub seed: u64,
}

impl Default for RepairParams {
    fn default() -> Self {
        Self { op_range: None, seed: 1 }
    }
}

/// A number with a 90 % interval for a stretch as long as the record.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Figure {
    /// Median.
    pub value: f64,
    /// Interval.
    pub interval: [f64; 2],
}

/// Behaviour of a loop.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Case {
    /// Standard deviation of PV, PV units.
    pub pv_sd: Figure,
    /// `pv_sd` relative to the loop as it is, with the same disturbance.
    pub pv_sd_ratio: Figure,
    /// Mean of |SP - PV|, PV units.
    pub pv_mean_abs_error: Figure,
    /// Travel of the stem, OP units per day.
    pub travel_per_day: Figure,
    /// Travel of OP, OP units per day.
    pub op_travel_per_day: Figure,
    /// Reversals of the stem by more than [`Repair::turn_op`], per day.
    pub reversals_per_day: Figure,
    /// Whether it oscillates regularly; `None` if the draws disagree.
    pub oscillates: Option<bool>,
}

/// Benefit of a repair.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Repair {
    /// As it is now.
    pub now: Case,
    /// Without stiction.
    pub repaired: Case,
    /// With stiction and half the controller gain.
    pub half_gain: Case,
    /// Standard deviation of PV in the record itself, PV units.
    pub recorded_pv_sd: f64,
    /// Smallest movement of the stem that counts as a reversal, OP units.
    pub turn_op: f64,
    /// The same in words.
    pub sentences: Vec<String>,
    /// Assumptions of the simulation.
    pub assumptions: Vec<String>,
}

/// Why there is no result.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum NoRepair {
    /// The window is inconclusive about stiction.
    #[error("the window is inconclusive about stiction ({0}), so there is nothing to compare; choose another window")]
    Inconclusive(String),
    /// No model of valve and process.
    #[error(
        "no model of valve and process fits this record, so the loop cannot be simulated; choose a window in which OP moves more"
    )]
    NoModel,
    /// The record does not test the process model.
    #[error(
        "the record does not test the process model: nothing but the controller moves OP, or the model does not hold in the rest of the record; choose a window with moves of the set point"
    )]
    Untested,
    /// No controller model.
    #[error(
        "the controller cannot be identified from this record: no PID controller explains OP from PV; choose a window in automatic, with uncompressed OP and PV"
    )]
    NoController,
    /// A controller model that explains only part of OP.
    #[error(
        "the controller cannot be identified from this record: the model explains OP in only {0:.0} % of it; choose a window without changes of mode or settings"
    )]
    PartController(f64),
    /// Process and controller have signs that make the loop unstable.
    #[error(
        "the identified process gain and controller action contradict each other, so one of them is wrong; choose another window"
    )]
    Signs,
    /// The simulated loop differs from the recorded one.
    #[error(
        "the simulated PV varies {0:.2} times as much as the recorded one: the model is not good enough to estimate the benefit of a repair"
    )]
    OtherSpread(f64),
    /// The simulated loop oscillates at another rate.
    #[error(
        "the simulated OP reverses {0:.2} times as often as the recorded one: the model is not good enough to estimate the benefit of a repair"
    )]
    OtherPace(f64),
}

/// Simulates the effect of a repair. `assessment` is the result of [`crate::core::verdict::assess`] for `record`; if it found
/// no stiction, the valve follows OP in all cases.
///
/// Pure and seeded: the same arguments give the same result. The work is bounded.
///
/// # Errors
/// [`NoRepair`] with the reason why the loop cannot be simulated or the result is not reliable.
pub fn repair(record: &Record, assessment: &Assessment, params: &RepairParams) -> Result<Repair, NoRepair> {
    let known = plant::Known::of(record, assessment)?;
    let told = run::compare(&known, params)?;
    let sentences = words::sentences(&told, assessment);
    let assumptions = words::assumptions(&told, &known, params);
    Ok(Repair { sentences, assumptions, ..told })
}

#[cfg(test)]
mod tests;
