//! Detection: whether the loop oscillates, and indicators of a sticking valve.

pub(crate) mod calm;
mod cross_correlation;
pub(crate) mod following;
mod inputs;
mod jumps;
mod known;
mod lines;
mod one_step;
pub mod oscillation;
pub(crate) mod ringing;
mod sine;
mod travel;

pub use sine::curve_fit;

use std::sync::Arc;

use serde::Serialize;

use crate::core::record::Record;
use crate::core::signal::{detrend, stats};

/// Result of one indicator.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Indicator {
    /// Its name in the catalogue.
    pub name: &'static str,
    /// Its value, defined at the indicator.
    pub score: Option<f64>,
    /// For stiction, against, or neutral.
    pub vote: Option<bool>,
    /// Its contribution to the verdict, logits; 0 if it is not used.
    pub contribution: f64,
}

/// An indicator of sticking that needs no valve model.
pub trait Detector: Sync {
    /// The detector's name in documents.
    fn name(&self) -> &'static str;
    /// The detector's value; `None` if the record does not show it.
    fn score(&self, view: &View) -> Option<f64>;
}

/// All detectors.
pub const ALL: [&dyn Detector; 6] = [
    &cross_correlation::CrossCorrelation,
    &jumps::Jumps,
    &sine::Sine,
    &travel::Travel,
    &one_step::OneStep,
    &one_step::Periodicity,
];

/// OP (and the set point) prepared for the detectors, with everything that depends on OP only; shared by every PV.
#[derive(Debug)]
pub struct OpSide {
    /// OP, averaged in bins and smoothed over a sixteenth of a period.
    pub op: Vec<f64>,
    /// OP minus its moving average over a period.
    pub op_fast: Vec<f64>,
    /// Its typical period, points of the view.
    pub period: f64,
    /// Record points per point of the view.
    box_points: usize,
    /// The set point at the record's points.
    sp: Option<Vec<f64>>,
    /// Inputs from OP for predicting PV, in fine and coarse bins; `None` if the record is too short or OP is constant.
    inputs: [Option<one_step::Inputs>; 2],
}

/// A record prepared for the detectors: at most about 80 points per period.
#[derive(Debug, Clone)]
pub struct View {
    /// OP.
    pub output: Arc<OpSide>,
    /// PV, averaged in bins and smoothed over a sixteenth of OP's typical period.
    pub pv: Vec<f64>,
    /// PV minus its moving average over a period.
    pub pv_fast: Vec<f64>,
    /// Standard deviation of PV's white noise before smoothing.
    pub pv_noise: f64,
    /// Prediction of PV from its past, to compare with inputs; `None` also if PV is constant.
    predictions: [Option<one_step::Prediction>; 2],
    /// Band, spans of OP, near which stems are tested; `None` for all.
    near: Option<f64>,
}

/// Points per period, and total points, of a view.
const POINTS_PER_PERIOD: f64 = 80.0;
const MAX_POINTS: usize = 2048;

impl OpSide {
    /// Prepares a record's OP with a typical period of `period` points, if any.
    #[must_use]
    pub(crate) fn new(record: &Record, period: Option<f64>) -> Self {
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

    /// As [`View::of`], with OP's typical period in points.
    #[must_use]
    pub(crate) fn with_period(record: &Record, period: Option<f64>) -> Self {
        Self::beside(&Arc::new(OpSide::new(record, period)), &record.pv, None)
    }

    /// Prepares a PV with one value for each point of the record of `output`. `near` is a band, spans of OP, near which stems
    /// are tested.
    #[must_use]
    pub(crate) fn beside(output: &Arc<OpSide>, pv: &[f64], near: Option<f64>) -> Self {
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

/// The period for views: a quarter of the record if there is none.
fn usable(period: Option<f64>, points: usize) -> f64 {
    period.unwrap_or(0.25 * points as f64).max(2.0)
}

fn boxed(x: &[f64], points: usize) -> Vec<f64> {
    let mut boxed = detrend::box_means(x, points);
    boxed.truncate(MAX_POINTS);
    boxed
}

/// Width of the smoothing, and of the moving average that is subtracted, points of the view.
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
