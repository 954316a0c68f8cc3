//! How much better a sticking stem predicts PV than OP does.
//!
//! Direct identification in closed loop (Ljung 1999, ch. 13.4): one-step prediction errors compare two inputs of the process
//! fairly although OP reacts to PV, whatever the disturbance, if the disturbance model is rich enough. Here it is PV's own
//! past (an autoregressive part) plus a line with its harmonics for an external periodic load. OP and the stems of He's and
//! the tracking model compete to explain the rest.

use super::inputs::{Boxes, Grain, Input, StemInput};
use super::known::{Known, Sums, Work, log_ratio};
use super::lines;
use super::{Detector, View};
use crate::core::ident::sign;
use crate::core::signal::{detrend, stats};
use crate::core::sim::slips::Law;

/// How much better the best stem predicts PV than OP, with OP limited at its ends if that helps: the logarithm of the ratio of
/// squared prediction errors times the number of bins (twice the log likelihood ratio), minus the chance gain of the best of
/// many stems, as `sign(x) ln(1 + |x| / 10)`: 0 for a tie, above 2.5 for clear friction. The mean of a fine view with lines
/// and a coarse one without, of those with at least 40 bins.
pub(super) struct OneStep;

/// Chance gain of the best stem, and the unit of the score.
const CHANCE: f64 = 15.0;
const UNIT: f64 = 10.0;

impl Detector for OneStep {
    fn name(&self) -> &'static str {
        "one_step_gain"
    }

    fn score(&self, view: &View) -> Option<f64> {
        let scores: Vec<f64> = view.predictions().map(|(inputs, p)| p.score(inputs, view.near)).collect();
        (!scores.is_empty()).then(|| stats::mean(&scores))
    }
}

/// How much of the part of PV that its past does not predict is periodic with a constant phase: log ratio of the squared
/// prediction errors without and with a line and its harmonics, minus the chance gain of lines, 0..3. Large for a load from a
/// machine or a cycle elsewhere; a limit cycle of the loop itself drifts with noise and load.
pub(super) struct Periodicity;

/// Largest score.
const CERTAIN: f64 = 3.0;

impl Detector for Periodicity {
    fn name(&self) -> &'static str {
        "periodicity"
    }

    fn score(&self, view: &View) -> Option<f64> {
        view.predictions().find_map(|(_, prediction)| prediction.periodicity).map(|c| c.clamp(0.0, CERTAIN))
    }
}

/// Inputs from OP for one bin size, shared by every PV.
#[derive(Debug, Clone)]
pub(super) struct Inputs {
    boxes: Boxes,
    periodic: bool,
    /// Frequency of OP's strongest line, cycles per bin, if lines are used.
    line: f64,
    cut: Vec<Input>,
    stems: Vec<StemInput>,
}

impl Inputs {
    /// See [`Boxes::of`].
    pub(crate) fn of(op_path: &[f64], per_point: usize, points: usize, period: f64, grain: Grain) -> Option<Self> {
        let boxes = Boxes::of(op_path, per_point, points, period, grain)?;
        let line = if grain.periodic { lines::around(&boxes.op) } else { 0.0 };
        Some(Self { periodic: grain.periodic, line, cut: boxes.cut(), stems: boxes.stems(), boxes })
    }
}

/// PV in bins of one size, with the prior model without OP.
#[derive(Debug, Clone)]
pub(super) struct Prediction {
    sums: Sums,
    sign: Option<f64>,
    /// Gain of the lines, if used.
    periodicity: Option<f64>,
}

impl Prediction {
    /// `None` if PV is constant; `sp` is the set point at PV's points, if known.
    pub(crate) fn of(inputs: &Inputs, pv: &[f64], sp: Option<&[f64]>) -> Option<Self> {
        let boxes = &inputs.boxes;
        let boxed = |x: &[f64]| detrend::box_means(&x[..boxes.op.len() * boxes.points], boxes.points);
        let pv = boxed(pv);
        let (level, spread) = (stats::mean(&pv), stats::std_dev(&pv));
        if !spread.is_normal() {
            return None;
        }
        let pv: Vec<f64> = pv.iter().map(|y| (y - level) / spread).collect();
        let sp: Option<Vec<f64>> = sp.map(|sp| boxed(sp).iter().map(|v| (v - level) / spread).collect());
        let sign = sign::of_gain_with_sp(&boxes.op, &pv, sp.as_deref());
        let near = if inputs.periodic { [lines::around(&pv), inputs.line] } else { [0.0; 2] };
        let mut known = Known::past(pv, boxes.from, boxes.order);
        let mut periodicity = None;
        if inputs.periodic {
            let before = [known.error(), known.count() as f64];
            known = lines::with_best(known, near);
            periodicity = Some(lines::gain(&before, &known));
        }
        Some(Self { sums: Sums::new(known, &boxes.follow, boxes.lags), sign, periodicity })
    }

    /// The score of [`OneStep`] for this view; with `near`, only stems with a band near `near` spans of OP are used.
    fn score(&self, inputs: &Inputs, near: Option<f64>) -> f64 {
        let mut work = Work::default();
        let mut least = |least: f64, input: &Input| least.min(self.sums.error(input, self.sign, &mut work));
        let without = inputs.cut.iter().fold(f64::INFINITY, &mut least);
        let asked = inputs.stems.iter().filter(|stem| near.is_none_or(|share| is_near(stem, share)));
        let with = asked.fold(f64::INFINITY, |error, stem| least(error, &stem.input));
        let with = if with.is_finite() { with } else { self.sums.without() };
        let gained = self.sums.count() as f64 * log_ratio(without, with) - CHANCE;
        gained.signum() * libm::log(1.0 + gained.abs() / UNIT)
    }
}

/// Whether a stem is of He's model with a band next to one of `share` spans.
fn is_near(stem: &StemInput, share: f64) -> bool {
    const NEXT: f64 = 1.45;
    stem.law == Law::He && stem.share < NEXT * share && share < NEXT * stem.share
}

#[cfg(test)]
mod tests {
    use super::super::noise;
    use super::*;
    use crate::core::record::Record;
    use crate::core::sim::process::Pole;
    use crate::core::sim::valve::he_step;

    const N: usize = 1200;

    /// Scores of a PI loop on a first-order process whose valve has the bands `fs`, `fd`, under white noise and a load.
    fn scores(fs: f64, fd: f64, seed: u64, load: impl Fn(usize) -> f64) -> [f64; 2] {
        let (mut op, mut pv, mut stem) = (Vec::new(), Vec::new(), vec![0.0; 3]);
        let (mut position, mut integral, mut state) = (0.0, 0.0, 0.0);
        let pole = Pole::lag(10.0, 0.0);
        for (k, e) in noise(N, seed).iter().enumerate() {
            state = pole.a * state + (pole.b0 + pole.b1) * (stem[k] + load(k));
            let y = state + 0.2 * e;
            integral -= 0.06 * y;
            op.push(integral - 0.6 * y);
            pv.push(y);
            position = he_step(position, op[k], fs, fd);
            stem.push(position);
        }
        let view = View::new(&Record::uniform(1.0, op, pv));
        [OneStep.score(&view).unwrap(), Periodicity.score(&view).unwrap()]
    }

    fn triangle(k: usize) -> f64 {
        (8.0 * (k as f64 / 83.0).fract() - 4.0).abs() - 2.0
    }

    #[test]
    fn a_stem_predicts_what_op_does_not_only_where_the_valve_sticks() {
        for seed in 1..6 {
            let [sticking, healthy] = [scores(2.0, 1.0, seed, |_| 0.5), scores(0.0, 0.0, seed, |_| 0.5)];
            assert!(sticking[0] > 1.2 && healthy[0] < 0.8, "{sticking:?} {healthy:?}");
        }
    }

    #[test]
    fn a_load_that_keeps_its_phase_is_seen() {
        for seed in 1..6 {
            let [score, clock] = scores(0.0, 0.0, seed, triangle);
            assert!(score < 1.5 && clock > 0.05, "{score} {clock}");
            let [_, idle] = scores(0.0, 0.0, seed, |_| 0.5);
            assert!(idle < clock, "{idle} {clock}");
        }
    }

    #[test]
    fn offsets_scales_and_signs_do_not_matter() {
        let op: Vec<f64> = (0..600).map(|k| libm::sin(f64::from(k) * 0.1)).collect();
        let pv: Vec<f64> = op.iter().zip(noise(600, 3)).map(|(u, e)| (4.0 * u).round() + e).collect();
        let of = |a: f64, b: f64| {
            let scaled = |x: &[f64], c: f64| x.iter().map(|v| c * v + b).collect::<Vec<_>>();
            let view = View::new(&Record::uniform(1.0, scaled(&op, a), scaled(&pv, a)));
            [OneStep.score(&view).unwrap(), Periodicity.score(&view).unwrap()]
        };
        let plain = of(1.0, 0.0);
        for other in [of(8.0, 0.0), of(-3.0, 70.0), of(0.25, -5.0)] {
            assert!((0..2).all(|i| (plain[i] - other[i]).abs() < 1e-6), "{plain:?} {other:?}");
        }
    }
}
