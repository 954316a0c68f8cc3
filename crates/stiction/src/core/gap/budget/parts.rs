//! PV's variance as a sum: what valve and process make of OP, each effect, a disturbance that wanders, noise, and what
//! nothing predicts.
//!
//! A part's share is its covariance with PV over PV's variance, so that shares sum to 1 whatever the parts have in common. A
//! part that works against the others takes less than its size, down to below 0.

use core::f64::consts::PI;

use super::search::{Driver, Model, Searched};
use super::series::Series;
use crate::core::gap::noise::arx::{Fit, START};
use crate::core::signal::stats;

/// Correlation of two parts from which their split is arbitrary.
const TOGETHER: f64 = 0.5;
/// Frequencies of the spectrum.
const GRID: usize = 400;

/// Why valve and process are not told from the disturbance: the fitted process runs away by itself, or its part and the
/// disturbance correlate.
const UNSTABLE: &str = "process_unstable";
const CORRELATE: &str = "parts_correlate";

/// A part.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Part {
    /// Share of PV's variance; all sum to 1.
    pub share: f64,
    /// Its standard deviation over PV's.
    pub size: f64,
}

/// How the disturbance moves.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Course {
    /// Period at which it is strongest, points; `None` where that is the record's length or more.
    pub period: Option<f64>,
    /// Frequencies between which its power is at least half of that at its period, cycles a point.
    pub band: [f64; 2],
}

/// All parts.
#[derive(Debug, Clone, PartialEq)]
pub struct Split {
    /// Valve and process; `None` where they are not told from the disturbance.
    pub valve_and_process: Option<Part>,
    /// Why not.
    pub no_split: Option<&'static str>,
    /// What the driving model's effect explains beyond the base, each fitted for itself.
    pub cause: Option<Part>,
    /// Each part of [`Searched::parts`].
    pub effects: Vec<Part>,
    /// What wanders, as far as its own past predicts it; with valve and process where these are not told from it.
    pub disturbance: Part,
    /// How it moves.
    pub course: Course,
    /// What no model predicts and PV's noise accounts for.
    pub noise: Part,
    /// What else was not predicted.
    pub unexplained: Part,
    /// What valve and process gain at rest, standard deviations of PV over those of OP.
    pub gain: Option<f64>,
}

/// Splits a searched series; `noise` is PV's noise over its standard deviation, where it could be read.
#[must_use]
pub(crate) fn split(series: &Series, model: &Model, searched: &Searched, noise: Option<f64>) -> Split {
    let pv = model.design.pv(&model.design.y);
    let y = &pv[START..];
    let fit = &searched.fit;
    let part =
        |x: &[f64]| Part { share: covariance(x, y) / stats::variance(y), size: stats::std_dev(x) / stats::std_dev(y) };
    // Free runs may be wrong before the first innovation.
    let late = |x: Vec<f64>| x[START..].to_vec();
    let effects: Vec<Vec<f64>> = searched.parts().iter().map(|effects| late(searched.sum(effects))).collect();
    let (process, cause) = match model.cause(series) {
        Some((run, base)) => (Some(base.pv.clone()), Some(late(difference(&run.pv, &base.pv)))),
        None => (model.design.simulated(fit), None),
    };
    let process = process.map(late);
    let mut rest = effects.iter().chain(&cause).fold(y.to_vec(), |rest, x| difference(&rest, x));
    let mut no_split = process.is_none().then_some(UNSTABLE);
    let mut valve_and_process = None;
    if let Some(x) = &process {
        let left = difference(&rest, x);
        let norm = stats::std_dev(x) * stats::std_dev(&left);
        if covariance(x, &left).abs() > TOGETHER * norm {
            no_split = Some(CORRELATE);
        } else {
            valve_and_process = Some(part(x));
            rest = left;
        }
    }
    let e = &fit.e;
    let [all, new] = [part(&rest), part(e)];
    let disturbance = Part { share: all.share - new.share, size: part(&difference(&rest, e)).size };
    let (least, course) = spectrum(fit, y.len());
    let power = (stats::variance(&fit.e) / stats::variance(y)).max(f64::MIN_POSITIVE);
    let white = noise.map_or(1.0, |noise| noise * noise / power).min(least).min(1.0);
    let of = |share: f64| Part { share: share * new.share, size: share.sqrt() * new.size };
    let gain = match model.driver {
        Driver::Run(place) => series.runs[place].gain,
        Driver::Op | Driver::Stem(_) => Some(fit.b.iter().sum::<f64>() / fit.a.iter().sum::<f64>()),
    };
    Split {
        effects: effects.iter().map(|x| part(x)).collect(),
        gain: process.and(gain).filter(|gain| gain.is_finite()),
        valve_and_process,
        no_split,
        cause: cause.as_deref().map(part),
        disturbance,
        course,
        noise: of(white),
        unexplained: of(1.0 - white),
    }
}

fn difference(x: &[f64], y: &[f64]) -> Vec<f64> {
    x.iter().zip(y).map(|(x, y)| x - y).collect()
}

fn covariance(x: &[f64], y: &[f64]) -> f64 {
    let [mx, my] = [stats::mean(x), stats::mean(y)];
    x.iter().zip(y).map(|(x, y)| (x - mx) * (y - my)).sum::<f64>() / x.len().max(1) as f64
}

/// Least power of the noise model over its innovations', which bounds the white part; and where it is strongest, power taken
/// per octave.
fn spectrum(fit: &Fit, n: usize) -> (f64, Course) {
    let slowest = libm::log(1.0 / n as f64);
    let frequency = |i: usize| libm::exp(slowest + (libm::log(0.5) - slowest) * i as f64 / (GRID - 1) as f64);
    let power = |f: f64| {
        let (sin, cos) = (libm::sin(2.0 * PI * f), libm::cos(2.0 * PI * f));
        let (mut s, mut c) = (0.0, 1.0);
        let (mut re, mut im) = (0.0, 0.0);
        for a in &fit.a {
            re += a * c;
            im -= a * s;
            (s, c) = (s * cos + c * sin, c * cos - s * sin);
        }
        1.0 / (re * re + im * im).max(1e-300)
    };
    let all: Vec<[f64; 2]> = (0..GRID).map(|i| [frequency(i), power(frequency(i))]).collect();
    let least = all.iter().map(|[_, p]| *p).fold(f64::INFINITY, f64::min);
    let octave: Vec<f64> = all.iter().map(|[f, p]| f * p).collect();
    let top = (0..GRID).max_by(|i, j| octave[*i].total_cmp(&octave[*j])).unwrap_or(0);
    let half = |i: &usize| octave[*i] >= 0.5 * octave[top];
    let low = (0..=top).rev().take_while(half).last().unwrap_or(top);
    let high = (top..GRID).take_while(half).last().unwrap_or(top);
    (least, Course { period: (top > 0).then(|| 1.0 / all[top][0]), band: [all[low][0], all[high][0]] })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::gap::budget::search::search;
    use crate::core::gap::budget::tests::Loop;

    #[test]
    fn shares_are_the_true_ones_and_sum_to_one() {
        let of = Loop { step: 1.5, ..Loop::default() };
        for seed in 1..5 {
            let (record, truth) = of.run(seed);
            let series = of.series_of(record);
            let model = Model::of(&series).unwrap();
            let searched = search(&series, &model);
            let split = split(&series, &model, &searched, None);
            let share = |x: &[f64]| covariance(x, &truth.pv) / stats::variance(&truth.pv);
            let process = split.valve_and_process.unwrap_or_else(|| panic!("{seed}: {split:?}"));
            let effects: f64 = split.effects.iter().map(|e| e.share).sum();
            let rest = split.disturbance.share + split.noise.share + split.unexplained.share;
            assert!((process.share + effects + rest - 1.0).abs() < 1e-9);
            for (found, x) in [(process.share, &truth.process), (effects, &truth.effect), (rest, &truth.rest)] {
                assert!((found - share(x)).abs() < 0.1, "seed {seed}: {found} of {}, {split:?}", share(x));
            }
        }
    }

    #[test]
    fn a_cycle_in_the_noise_model_has_its_period_and_a_slow_one_none() {
        let series = Loop::default().series(1);
        let fit = Model::of(&series).unwrap().base;
        let poles = |radius: f64, turn: f64| vec![1.0, -2.0 * radius * libm::cos(turn), radius * radius];
        let (_, course) = spectrum(&Fit { a: poles(0.98, 2.0 * PI / 25.0), ..fit.clone() }, 900);
        assert!((course.period.unwrap() - 25.0).abs() < 0.5 && course.band[0] < 0.04 && course.band[1] > 0.04);
        let (least, course) = spectrum(&Fit { a: vec![1.0, -1.0], ..fit }, 900);
        assert!(course.period.is_none() && (least - 0.25).abs() < 0.01);
    }
}
