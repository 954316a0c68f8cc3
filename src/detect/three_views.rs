//! How much better PV follows a sticking stem than OP, averaged over three ways of looking at the same fit.
//!
//! A ramp of PV, a slow load or a free level each spoil one way of comparing a model with a record, seldom all three. So
//! the index (1 - error with friction / error without, in free run) is taken with mean and ramp removed, with the mean
//! removed only, and for both sides less 0.9 of their value a box before, and averaged. It is the older of the two fits,
//! coarse and without any search, and it errs on other records than [`crate::ident::quantify`] does.

use super::inputs::Input;
use super::one_step::{Inputs, Prediction};
use super::{Detector, View};
use crate::signal::detrend;
use crate::signal::stats::{self, dot};

/// The mean of the three indices, 0..1, less in proportion where the best stems' band is under a fifth of OP's span.
pub(super) struct ThreeViews;

/// Poles of the process, boxes: a direct answer, lags, an integrator.
const POLES: [f64; 8] = [0.0, 0.5, 0.75, 0.88, 0.95, 0.98, 0.995, 1.0];
/// Poles that are tried where a ramp stays in: slower ones would follow it.
const FAST_POLES: usize = 6;
/// Pole of the filter on both sides.
const WHITENER: f64 = 0.9;
/// Band, spans of OP, from which the index counts in full.
const FULL_BAND: f64 = 0.2;

impl Detector for ThreeViews {
    fn name(&self) -> &'static str {
        "three_views"
    }

    fn score(&self, view: &View) -> Option<f64> {
        let (inputs, prediction) = view.predictions().next()?;
        let signs = prediction.sign().map_or(vec![1.0, -1.0], |s| vec![s]);
        let scores = signs.into_iter().filter_map(|sign| score(inputs, prediction, sign, view.near));
        // Of two possible signs the one with which the linear process fits better is the process'.
        scores.max_by(|a, b| a.without.total_cmp(&b.without)).map(|s| s.score)
    }
}

/// The score of one sign of the gain.
struct Told {
    score: f64,
    /// Share of PV's variance that the process without friction explains.
    without: f64,
}

/// Largest share of variance explained, in the three views, and the band it takes, spans of OP.
#[derive(Debug, Clone, Copy, Default)]
struct Best {
    share: [f64; 3],
    band: [f64; 3],
}

impl Best {
    fn take(&mut self, share: [f64; 3], band: f64) {
        for (view, new) in share.into_iter().enumerate() {
            if new > self.share[view] {
                (self.share[view], self.band[view]) = (new, band);
            }
        }
    }
}

fn score(inputs: &Inputs, prediction: &Prediction, sign: f64, near: Option<f64>) -> Option<Told> {
    let boxes = inputs.boxes();
    let target = Target::new(prediction.values(), boxes.lags)?;
    let mut work = Work::default();
    let mut of = |input: &Input| {
        boxes.expand(input, &mut work.valve);
        target.shares(sign, &mut work)
    };
    let without = of(inputs.free());
    let mut best = Best::default();
    for stem in inputs.middle_stems().filter(|s| near.is_none_or(|share| s.is_near(share))) {
        best.take(of(&stem.input), stem.share);
    }
    let index = |view: usize| {
        let left = 1.0 - without[view];
        if left > 1e-9 { (1.0 - (1.0 - best.share[view]) / left).clamp(0.0, 1.0) } else { 0.0 }
    };
    let band = best.band[0].max(best.band[1]);
    let mean = (0..3).map(index).sum::<f64>() / 3.0;
    Some(Told { score: mean * (band / FULL_BAND).min(1.0), without: without[0] })
}

/// PV in the three views, each with mean 0 and power 1.
struct Target {
    lags: usize,
    /// Less line, less mean, whitened.
    pv: [Vec<f64>; 3],
}

#[derive(Debug, Default)]
struct Work {
    valve: Vec<f64>,
    answer: Column,
    whitened: Column,
}

impl Target {
    fn new(pv: &[f64], lags: usize) -> Option<Self> {
        let kept = pv.get(lags..).filter(|kept| kept.len() > 2 * lags + 20)?;
        let white: Vec<f64> = (lags..pv.len()).map(|k| pv[k] - WHITENER * pv[k - 1]).collect();
        let mut views = [detrend::remove_line(kept), detrend::remove_mean(kept), detrend::remove_mean(&white)];
        let powers = views.each_ref().map(|v| dot(v, v).sqrt());
        if powers.iter().any(|p| !p.is_normal()) {
            return None;
        }
        for (view, power) in views.iter_mut().zip(powers) {
            view.iter_mut().for_each(|v| *v /= power);
        }
        Some(Self { lags, pv: views })
    }

    /// Largest share of PV's variance that a process behind the valve signal explains, in each view.
    fn shares(&self, sign: f64, work: &mut Work) -> [f64; 3] {
        let mut best = [0.0_f64; 3];
        for (place, pole) in POLES.into_iter().enumerate() {
            answer(&work.valve, pole, &mut work.answer);
            whiten(&work.answer, &mut work.whitened);
            for lag in 0..self.lags {
                let mut take = |view: usize, x: &Column| {
                    best[view] = best[view].max(self.share(view, x, lag, sign));
                };
                take(0, &work.answer);
                if place < FAST_POLES {
                    take(1, &work.answer);
                }
                take(2, &work.whitened);
            }
        }
        best
    }

    /// Share of a view's power along a column that is delayed by `lag` boxes, less its mean (in the first view its line);
    /// 0 for the wrong sign.
    fn share(&self, view: usize, column: &Column, lag: usize, sign: f64) -> f64 {
        let (from, end) = (self.lags - lag, column.values.len() - lag);
        let along = dot(&column.values[from..end], &self.pv[view]);
        if along * sign <= 0.0 {
            return 0.0;
        }
        let n = (end - from) as f64;
        let [sum, power, moment] = [0, 1, 2].map(|k| column.sums[end][k] - column.sums[from][k]);
        let mut own = power - sum * sum / n;
        if view == 0 {
            let moment = moment - 0.5 * (from + end - 1) as f64 * sum;
            own -= moment * moment * 12.0 / (n * (n * n - 1.0));
        }
        if own > 1e-9 * power { (along * along / own).min(1.0) } else { 0.0 }
    }
}

/// A column with the sums of its values, their squares, and their products with their places, up to each place.
#[derive(Debug, Default)]
struct Column {
    values: Vec<f64>,
    sums: Vec<[f64; 3]>,
}

impl Column {
    fn fill(&mut self, values: impl Iterator<Item = f64>) {
        self.values.clear();
        self.sums.clear();
        let mut sum = [0.0; 3];
        self.sums.push(sum);
        for (place, v) in values.enumerate() {
            sum = [sum[0] + v, sum[1] + v * v, sum[2] + v * place as f64];
            self.values.push(v);
            self.sums.push(sum);
        }
    }
}

/// A process of one pole behind a valve signal that stood at its first value before; an integrator of what departs from
/// its mean where the pole is 1.
fn answer(valve: &[f64], pole: f64, out: &mut Column) {
    let integrates = pole >= 1.0;
    let (level, gain) = if integrates { (stats::mean(valve), 1.0) } else { (0.0, 1.0 - pole) };
    let mut state = if integrates { 0.0 } else { valve.first().copied().unwrap_or(0.0) };
    out.fill(valve.iter().map(|v| {
        state = pole * state + gain * (v - level);
        state
    }));
}

fn whiten(x: &Column, out: &mut Column) {
    let mut last = x.values.first().copied().unwrap_or(0.0);
    out.fill(x.values.iter().map(|v| {
        let white = v - WHITENER * last;
        last = *v;
        white
    }));
}

#[cfg(test)]
mod tests {
    use super::super::noise;
    use super::*;
    use crate::record::Record;
    use crate::sim::valve::he_step;

    /// OP swings, a valve follows it, a first-order process answers: the index with a ramp on PV and without.
    fn index(fs: f64, fd: f64, ramp: f64) -> f64 {
        let op: Vec<f64> =
            (0..900).map(|k| 5.0 * libm::sin(f64::from(k) * 0.08) + libm::sin(f64::from(k) * 0.03)).collect();
        let (mut stem, mut state) = (0.0, 0.0);
        let pv: Vec<f64> = op
            .iter()
            .zip(noise(900, 5))
            .enumerate()
            .map(|(k, (u, e))| {
                stem = he_step(stem, *u, fs, fd);
                state += 0.2 * (stem - state);
                state + 0.5 * e + ramp * k as f64
            })
            .collect();
        ThreeViews.score(&View::new(&Record::uniform(1.0, op, pv))).unwrap()
    }

    #[test]
    fn a_sticking_stem_is_seen_through_a_ramp_and_a_sound_one_is_not_accused() {
        let (plain, ramped, sound) = (index(2.5, 1.0, 0.0), index(2.5, 1.0, 0.01), index(0.0, 0.0, 0.0));
        assert!(plain > 0.6 && ramped > 0.25 && sound < 0.1, "{plain} {ramped} {sound}");
    }
}
