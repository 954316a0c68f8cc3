//! What a repair of the valve buys: the closed loop simulated as it is, without stiction, and with half the controller gain.
//!
//! The loop is what the record and its assessment tell: valve and process as fitted, the controller as read, and as
//! disturbance what the model leaves of PV, put together anew from stretches of the record. Without stiction the
//! disturbance lies between the measurement's noise and all of that: how much of it is the model's own error, which goes
//! with the cycle, cannot be told. Valve, process and controller are drawn from what explains the record, and a draw stays
//! only where its loop moves PV as the record does; what they disagree in are the intervals. `docs/over-time.md` has the
//! figures.

mod draws;
mod plant;
mod run;
mod words;

use serde::Serialize;
use thiserror::Error;

use crate::record::Record;
use crate::verdict::Assessment;

/// What a simulation is told beside the record. The defaults are the daemon's.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RepairParams {
    /// OP's range, where it is known; else OP may go ten spans beyond what was recorded.
    pub op_range: Option<[f64; 2]>,
    /// Seed of all draws.
    pub seed: u64,
}

impl Default for RepairParams {
    fn default() -> Self {
        Self { op_range: None, seed: 1 }
    }
}

/// A number with its interval of 90 %, in which a stretch as long as the record would lie.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Figure {
    /// Median.
    pub value: f64,
    /// Interval.
    pub interval: [f64; 2],
}

/// How a loop would behave.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Case {
    /// Standard deviation of PV, PV units.
    pub pv_sd: Figure,
    /// `pv_sd` over that of the loop as it is now, under the same disturbance.
    pub pv_sd_ratio: Figure,
    /// Mean of |SP - PV|, PV units.
    pub pv_mean_abs_error: Figure,
    /// Way of the stem, OP units a day.
    pub travel_per_day: Figure,
    /// Way of OP, OP units a day.
    pub op_travel_per_day: Figure,
    /// Turns of the stem by more than [`Repair::turn_op`], a day.
    pub reversals_per_day: Figure,
    /// Whether it oscillates regularly; `None` where the draws disagree.
    pub oscillates: Option<bool>,
}

/// What a repair buys.
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
    /// A turn of the stem counts from here on, OP units.
    pub turn_op: f64,
    /// The same in words.
    pub sentences: Vec<String>,
    /// What was taken for granted.
    pub assumptions: Vec<String>,
}

/// Why there is no answer.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum NoRepair {
    /// The window does not say whether the valve sticks.
    #[error(
        "the window does not say whether the valve sticks ({0}), so there is nothing to compare: take another window"
    )]
    Inconclusive(String),
    /// No model of valve and process.
    #[error(
        "no model of valve and process could be fitted to this record, so the loop cannot be simulated: take a window in which OP moves more"
    )]
    NoModel,
    /// No controller.
    #[error(
        "the controller cannot be told from this record: no PID controller explains how OP follows PV; it needs a stretch in automatic with OP and PV as the controller had them"
    )]
    NoController,
    /// A controller that explains only a part of OP.
    #[error(
        "the controller cannot be told from this record: it explains OP in {0:.0} % of it only; take a window without changes of mode or settings"
    )]
    PartController(f64),
    /// The signs of process and controller make the loop run away.
    #[error(
        "the process gain and the controller's action as read from this record do not go together: one of the two is wrong"
    )]
    Signs,
    /// Simulated, the loop is not what was recorded.
    #[error(
        "simulated with what the record tells, PV varies {0:.2} times as much as recorded: the model is not good enough to say what a repair buys"
    )]
    OtherSpread(f64),
    /// Simulated, the loop turns at another pace.
    #[error(
        "simulated with what the record tells, OP turns {0:.2} times as often as recorded: the model is not good enough to say what a repair buys"
    )]
    OtherPace(f64),
}

/// Simulates what a repair buys. `assessment` is what [`crate::verdict::assess`] made of `record`; where it found no
/// stiction, the valve follows OP in all cases.
///
/// Pure and seeded: the same arguments give the same answer. Work is bounded.
///
/// # Errors
/// [`NoRepair`] says in words why the loop cannot be simulated, or not be trusted.
pub fn repair(record: &Record, assessment: &Assessment, params: &RepairParams) -> Result<Repair, NoRepair> {
    let known = plant::Known::of(record, assessment)?;
    let told = run::compare(&known, params)?;
    let sentences = words::sentences(&told, assessment);
    let assumptions = words::assumptions(&told, &known, params);
    Ok(Repair { sentences, assumptions, ..told })
}
