//! Closed loops whose truth is known, by the thousand: what estimates are calibrated on and reported against.
//!
//! [`accuracy`] makes sticking, well-posed loops of one [`Regime`]; `s` and `j` are known, and the valve is seen to
//! move. `verdict_case` makes healthy and sticking loops of every kind, hard ones too, as plants would store them.
//! Both are functions of (half, what, seed) alone, to the last bit.
//!
//! Two [`Half`]s draw from streams of their own, so nothing that was calibrated on one is met in the other, whatever
//! the seeds. Loops are drawn until one fits its regime; the attempt's number is part of the stream.
//!
//! Bands are OP units (0..100 %), times scans unless they say seconds; `ts_s` is a label only.

mod accuracy;
#[allow(dead_code)]
mod draw;
#[allow(dead_code)]
mod rig;

pub use accuracy::Regime;

use super::controller::PidSettings;
use super::process::ProcessModel;
use crate::record::Record;

/// Which half of all loops: nothing fitted on one may be reported on the same.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Half {
    /// For fitting weights, margins and thresholds.
    Calibration,
    /// For the figures that are printed.
    Report,
}

impl Half {
    /// Its name in streams and tables.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Calibration => "calibration",
            Self::Report => "report",
        }
    }
}

/// One simulated loop as it was recorded, and what is true of it.
#[derive(Debug, Clone, PartialEq)]
pub struct TruthLoop {
    /// Controller output as recorded, OP units.
    pub op: Vec<f64>,
    /// Process variable as recorded, PV units.
    pub pv: Vec<f64>,
    /// Set point, PV units.
    pub sp: Vec<f64>,
    /// Valve position, OP units, exact.
    pub mv: Vec<f64>,
    /// Time between recorded samples, s.
    pub ts_s: f64,
    /// Standard deviation of the white measurement noise, PV units.
    pub noise_sd: f64,
    /// What a fit with the true model would leave of PV (standard deviation), where that is known: OP recorded as it
    /// was, a valve that follows one of the laws, and nothing but white noise on PV.
    pub floor_sd: Option<f64>,
    /// Whether the valve sticks.
    pub sticks: bool,
    /// Valve: `none`, `he`, `tracking` or `physical`.
    pub law: &'static str,
    /// Stick band, OP units; none for a healthy valve. Measured on a slow ramp for the physical one.
    pub s: Option<f64>,
    /// Slip jump, OP units.
    pub j: Option<f64>,
    /// Process, in recorded samples.
    pub process: ProcessModel,
    /// Controller.
    pub controller: PidSettings,
    /// Seed of the draws.
    pub seed: u64,
    /// What moves the loop: `limit cycle`, or the name of the excitation.
    pub kind: &'static str,
    /// `fast flow`, `first order`, `second order` or `integrating`.
    pub process_kind: &'static str,
    /// How it was recorded: `raw`, or what the recording did to it.
    pub record_kind: &'static str,
    /// What makes it oscillate: `valve`, `tuning`, `disturbance` or `none`.
    pub cause: &'static str,
    /// Regime of [`accuracy`] loops, else `verdict`.
    pub regime: &'static str,
    /// Noise over PV's spread without noise.
    pub noise_share: f64,
    /// Period aimed at, recorded samples.
    pub period: f64,
    /// Size of what disturbs: over half the swing of the stick-slip PV in [`accuracy`], in OP units over fs in
    /// sticking and OP units in healthy `verdict_case` loops.
    pub disturbance: f64,
}

impl TruthLoop {
    /// The record an estimate gets: set point with it, valve position not.
    #[must_use]
    pub fn record(&self) -> Record {
        let mut record = Record::uniform(self.ts_s, self.op.clone(), self.pv.clone());
        record.sp = Some(self.sp.clone());
        record
    }

    /// Periods in the record, by the period aimed at.
    #[must_use]
    pub fn cycles(&self) -> f64 {
        self.pv.len() as f64 / self.period
    }
}

/// Draws until `attempt` gives a loop; the seeds' neighbours step in where none of one seed's attempts does.
fn first_that_fits(
    half: Half,
    what: &str,
    seed: u64,
    attempt: impl Fn(&mut draw::Draw) -> Option<TruthLoop>,
) -> TruthLoop {
    let mut number = 0_u32;
    loop {
        // The rounds only end by success: every draw is independent, and no regime rejects more than most.
        let mut draw = draw::Draw::new(seed, &format!("truth/{}/{what}/{number}", half.name()));
        if let Some(mut found) = attempt(&mut draw) {
            found.seed = seed;
            return found;
        }
        number += 1;
    }
}

/// A sticking, well-posed loop of `regime`.
#[must_use]
pub fn accuracy(half: Half, regime: Regime, seed: u64) -> TruthLoop {
    first_that_fits(half, regime.name(), seed, |draw| accuracy::attempt(draw, regime))
}
