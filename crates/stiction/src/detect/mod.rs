//! Detection: does the loop oscillate, and which signs in the record speak for the valve.

pub mod calm;
mod cross_correlation;
mod inputs;
mod jumps;
mod known;
mod lines;
mod one_step;
pub mod oscillation;
pub mod ringing;
mod sine;
mod travel;

use std::sync::Arc;

use serde::Serialize;

use crate::record::Record;
use crate::signal::{detrend, stats};

/// One indicator's say.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Indicator {
    /// Its name in the catalogue.
    pub name: &'static str,
    /// Its figure, defined where the indicator is.
    pub score: Option<f64>,
    /// For stiction, against, or silent.
    pub vote: Option<bool>,
    /// Its part of the verdict, logits; 0 where it says nothing.
    pub contribution: f64,
}

/// A sign of sticking that is read from a record without a valve model.
pub trait Detector: Sync {
    /// Its name in documents.
    fn name(&self) -> &'static str;
    /// Its figure; `None` where the record does not show it either way.
    fn score(&self, view: &View) -> Option<f64>;
}

/// Every detector.
pub const ALL: [&dyn Detector; 6] = [
    &cross_correlation::CrossCorrelation,
    &jumps::Jumps,
    &sine::Sine,
    &travel::Travel,
    &one_step::OneStep,
    &one_step::Periodicity,
];

/// OP (and the set point) as the detectors look at it, and all that follows from it alone: made once for every PV that is looked at beside it.
#[derive(Debug)]
pub struct OpSide {
    /// OP, boxed and smoothed over a sixteenth of a period.
    pub op: Vec<f64>,
    /// OP less its moving average over a period.
    pub op_fast: Vec<f64>,
    /// Its typical period, points of the view.
    pub period: f64,
    /// Record points a point of the view.
    box_points: usize,
    /// The set point at the record's points.
    sp: Option<Vec<f64>>,
    /// What OP offers to predict PV by, in fine and in coarse boxes; `None` where the record is too short or OP does not
    /// move.
    inputs: [Option<one_step::Inputs>; 2],
}

/// A record as the detectors look at it: at most about 80 points a period.
#[derive(Debug, Clone)]
pub struct View {
    /// OP.
    pub output: Arc<OpSide>,
    /// PV, boxed and smoothed over a sixteenth of OP's typical period.
    pub pv: Vec<f64>,
    /// PV less its moving average over a period.
    pub pv_fast: Vec<f64>,
    /// Deviation of PV's white noise before smoothing.
    pub pv_noise: f64,
    /// PV as it is predicted from its past, beside the inputs; `None` also where PV does not move.
    predictions: [Option<one_step::Prediction>; 2],
    /// Band, spans of OP, next to which stems are asked whether they predict PV; `None` for all.
    near: Option<f64>,
}

/// Points a period that a view keeps, and points that it looks at.
const POINTS_PER_PERIOD: f64 = 80.0;
const MAX_POINTS: usize = 2048;

impl OpSide {
    /// Prepares a record's OP, whose typical period is `period` points where it has one.
    #[must_use]
    pub fn new(record: &Record, period: Option<f64>) -> Self {
        let op = record.op();
        let period = usable(period, record.len());
        let box_points = ((period / POINTS_PER_PERIOD) as usize).max(1);
        let of = |grain| one_step::Inputs::of(&record.op_path, record.path_per_point(), record.len(), period, grain);
        let inputs = inputs::GRAINS.map(of);
        let period = period / box_points as f64;
        let op = detrend::hann_smooth(&boxed(&op, box_points), smoothing(period));
        let op_fast = detrend::high_pass(&op, slow(period));
        let sp = record.sp.clone().filter(|sp| sp.len() == record.len());
        Self { op, op_fast, period, box_points, sp, inputs }
    }
}

impl View {
    /// Prepares a record.
    #[must_use]
    pub fn new(record: &Record) -> Self {
        Self::with_period(record, oscillation::typical_period(&record.op()))
    }

    /// The same where OP's typical period is known, points.
    #[must_use]
    pub fn with_period(record: &Record, period: Option<f64>) -> Self {
        Self::beside(&Arc::new(OpSide::new(record, period)), &record.pv, None)
    }

    /// Prepares a PV, a value for each point of the record that `output` was made of. `near` is a band, spans of OP, next
    /// to which stems are asked whether they predict PV.
    #[must_use]
    pub fn beside(output: &Arc<OpSide>, pv: &[f64], near: Option<f64>) -> Self {
        let predictions =
            [0, 1].map(|grain| one_step::Prediction::of(output.inputs[grain].as_ref()?, pv, output.sp.as_deref()));
        let pv = boxed(pv, output.box_points);
        let pv_noise = stats::noise_sd(&pv);
        let pv = detrend::hann_smooth(&pv, smoothing(output.period));
        let pv_fast = detrend::high_pass(&pv, slow(output.period));
        Self { output: Arc::clone(output), pv, pv_fast, pv_noise, predictions, near }
    }

    fn predictions(&self) -> impl Iterator<Item = (&one_step::Inputs, &one_step::Prediction)> {
        self.output.inputs.iter().zip(&self.predictions).filter_map(|(i, p)| Some((i.as_ref()?, p.as_ref()?)))
    }
}

/// The period that views are cut by: a quarter of the record where none shows.
fn usable(period: Option<f64>, points: usize) -> f64 {
    period.unwrap_or(0.25 * points as f64).max(2.0)
}

fn boxed(x: &[f64], points: usize) -> Vec<f64> {
    let mut boxed = detrend::box_means(x, points);
    boxed.truncate(MAX_POINTS);
    boxed
}

/// Width of the smoothing, and of the moving average that is taken off, points of the view.
fn smoothing(period: f64) -> usize {
    (period / 16.0) as usize
}

fn slow(period: f64) -> usize {
    (period as usize).max(2)
}

/// White noise between -0.5 and 0.5 for the detectors' tests.
#[cfg(test)]
fn noise(n: usize, seed: u64) -> Vec<f64> {
    let mut state = seed;
    (0..n)
        .map(|_| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scores(op: Vec<f64>, pv: Vec<f64>) -> Vec<Option<f64>> {
        let view = View::new(&Record::uniform(1.0, op, pv));
        ALL.iter().map(|d| d.score(&view)).collect()
    }

    fn of(n: usize, shape: impl Fn(f64) -> f64) -> Vec<f64> {
        (0..n).map(|k| shape((k as f64 / 60.0).fract())).collect()
    }

    #[test]
    fn a_triangle_against_a_square_speaks_for_the_valve() {
        let triangle = of(900, |t| if t < 0.5 { 4.0 * t - 1.0 } else { 3.0 - 4.0 * t });
        let square = of(900, |t| if (0.25..0.75).contains(&t) { -1.0 } else { 1.0 });
        // The square leads or lags by a quarter: shift it so that it changes where the triangle turns.
        let square: Vec<f64> = square.iter().cycle().skip(45).take(900).copied().collect();
        let found = scores(triangle, square);
        assert!(found[0].is_some_and(|s| s > 0.9), "horch {found:?}");
        assert!(found[1].is_some_and(|s| s > 0.2), "jumps {found:?}");
        assert!(found[3].is_some_and(|s| s > 0.5), "travel {found:?}");
    }

    #[test]
    fn clean_sinusoids_in_phase_speak_against_it() {
        let wave = of(900, |t| libm::sin(2.0 * core::f64::consts::PI * t));
        let found = scores(wave.clone(), wave);
        assert!(found[0].is_some_and(|s| s < 0.05), "horch {found:?}");
        assert!(found[1].is_some_and(|s| s.abs() < 1e-9), "jumps {found:?}");
        assert!(found[2].is_some_and(|s| s < 0.35), "curve fit {found:?}");
    }

    #[test]
    fn nothing_is_said_of_nothing() {
        assert!(scores(vec![1.0; 100], vec![1.0; 100])[..2].iter().all(Option::is_none));
        assert_eq!(scores(vec![], vec![]).len(), ALL.len());
    }
}
