//! Whether two loops share one oscillation: their phases stay locked over the window and wander together.
//!
//! Both loops are demodulated at their common frequency on absolute time, in Hann frames of a few periods. Independent cycles
//! of nearly the same frequency drift apart or wander independently; loops driven by one source do not.

use nalgebra::Complex;

use super::cycle::{Cycle, angle, length};
use super::logit::Logit;
use crate::core::signal::{lag, stats};

/// Largest difference of a pair's frequencies, as the logarithm of their ratio.
pub(super) const NEAR: f64 = 0.12;
/// Time between frames, periods.
const HOP: f64 = 0.5;
/// Fewest periods of frame centres.
const LEAST_PERIODS: f64 = 2.5;
/// Largest weight of a frame, in medians of the weights.
const LARGEST_WEIGHT: f64 = 4.0;

/// Features for the link of a pair. Logarithms are natural, phases in rad, times in periods.
pub(super) const FEATURES: [&str; 11] = [
    "ln of the spread of the phase difference",
    "ln rms of its detrended wander",
    "ln rms of the wander of both",
    "ln rms of the wander of the calmer one",
    "ln of the drift of the phase difference over the record",
    "ln of the periods compared",
    "correlation of the envelopes",
    "ln rank of the detrended wander among shifted pairs",
    "correlation of the wander",
    "ln of the cycles by which the frequencies part over the record",
    "least share",
];

/// Figures of a pair, in the order of [`FEATURES`].
pub(super) type Pair = [f64; FEATURES.len()];

/// Length of a frame in a window of `span_s`, periods.
pub(super) fn frame_periods(span_s: f64, period_s: f64) -> f64 {
    if span_s > 10.0 * period_s { 3.0 } else { 2.0 }
}

/// Common frequency and time of two cycles.
pub(super) struct Common {
    frequency: f64,
    /// Length of a frame, periods.
    frame: f64,
    /// Centres of the first frame and after the last one, s.
    from: f64,
    to: f64,
}

/// The common frequency and time of two cycles; `None` if their frequencies differ too much or they overlap too little.
pub(super) fn common(a: &Cycle, b: &Cycle) -> Option<Common> {
    if libm::log(a.frequency_hz / b.frequency_hz).abs() >= NEAR {
        return None;
    }
    let frequency = (a.frequency_hz * a.share + b.frequency_hz * b.share) / (a.share + b.share);
    let period = 1.0 / frequency;
    let (from, to) = (a.start_s.max(b.start_s), a.end_s().min(b.end_s()));
    let frame = frame_periods(to - from, period);
    let (from, to) = (from + frame * period / 2.0, to - frame * period / 2.0);
    (to - from >= LEAST_PERIODS * period).then_some(Common { frequency, frame, from, to })
}

/// Compares two cycles; `None` if they have too little in common.
pub(super) fn compare(a: &Cycle, b: &Cycle) -> Option<Pair> {
    let Common { frequency, frame, from, to } = common(a, b)?;
    let period = 1.0 / frequency;
    let frames = ((to - from) / (HOP * period)).ceil() as usize;
    let centres: Vec<f64> = (0..frames).map(|k| from + HOP * period * k as f64).collect();
    let amplitudes = [a, b].map(|cycle| cycle.demodulated(frequency, &centres, frame * period));
    let weights = weights(&amplitudes);
    let [alone_a, alone_b] = amplitudes.each_ref().map(|z| PhaseNoise::of(&unwrapped(z.iter().copied()), &weights));
    let difference = |(a, b): (&Complex<f64>, &Complex<f64>)| {
        let product = a * b.conj();
        product / length(product).max(f64::MIN_POSITIVE)
    };
    let differences: Vec<Complex<f64>> = amplitudes[0].iter().zip(&amplitudes[1]).map(difference).collect();
    let resultant = length(differences.iter().zip(&weights).map(|(u, w)| u * *w).sum());
    let spread = (-2.0 * libm::log(resultant.max(1e-9))).max(1e-8).sqrt();
    let together = PhaseNoise::of(&unwrapped(differences.into_iter()), &weights);
    let periods = frames as f64 * HOP;
    let covariance: f64 = alone_a.rest.iter().zip(&alone_b.rest).zip(&weights).map(|((a, b), w)| w * a * b).sum();
    let [envelope_a, envelope_b] =
        amplitudes.each_ref().map(|z| z.iter().map(|z| libm::log(length(*z) + 1e-12)).collect::<Vec<f64>>());
    Some([
        libm::log(spread),
        0.5 * libm::log(together.variance),
        0.5 * libm::log(alone_a.variance + alone_b.variance),
        0.5 * libm::log(alone_a.variance.min(alone_b.variance)),
        libm::log((together.slope * frames as f64).abs() + 0.02),
        libm::log(periods),
        lag::correlation(&envelope_a, &envelope_b),
        libm::log(rank_among_shifted(&alone_a.rest, &alone_b.rest, together.variance, frame)),
        covariance / (alone_a.variance * alone_b.variance).sqrt(),
        libm::log((a.frequency_hz - b.frequency_hz).abs() / frequency * periods + 0.02),
        a.share.min(b.share),
    ])
}

/// The regressors of the link's logit: the figures, their squares, and the products of spread, rank and wander.
pub(super) fn expanded(pair: &Pair) -> Vec<f64> {
    let mut terms = pair.to_vec();
    terms.extend(pair.iter().map(|x| x * x));
    terms.extend(pair[1..].iter().map(|x| x * pair[0]));
    terms.extend(pair[1..3].iter().map(|x| x * pair[3]));
    terms
}

/// The logit that a pair shares an oscillation.
pub(super) fn link(pair: &Pair, logit: &Logit) -> f64 {
    logit.of(&expanded(pair))
}

/// Weight of each frame, by the amplitudes of both cycles; the sum is 1.
fn weights([a, b]: &[Vec<Complex<f64>>; 2]) -> Vec<f64> {
    let mut weights: Vec<f64> = a.iter().zip(b).map(|(a, b)| length(*a) * length(*b)).collect();
    let most = LARGEST_WEIGHT * crate::core::signal::stats::median(&weights);
    weights.iter_mut().for_each(|w| *w = w.min(most));
    let total: f64 = weights.iter().sum();
    weights.iter_mut().for_each(|w| *w /= total.max(f64::MIN_POSITIVE));
    weights
}

/// Unwrapped angles, rad.
fn unwrapped(z: impl Iterator<Item = Complex<f64>>) -> Vec<f64> {
    let turn = 2.0 * core::f64::consts::PI;
    let mut angles: Vec<f64> = z.map(angle).collect();
    for k in 1..angles.len() {
        let step = angles[k] - angles[k - 1];
        angles[k] -= turn * (step / turn).round();
    }
    angles
}

/// Phase noise: a phase minus its weighted straight line.
struct PhaseNoise {
    rest: Vec<f64>,
    /// Weighted mean square of the rest, at least 1e-6.
    variance: f64,
    /// Slope of the line, rad per frame.
    slope: f64,
}

impl PhaseNoise {
    fn of(phase: &[f64], weights: &[f64]) -> Self {
        let weighted = |x: &dyn Fn(usize) -> f64| weights.iter().enumerate().map(|(k, w)| w * x(k)).sum::<f64>();
        let (middle, mean) = (weighted(&|k| k as f64), weighted(&|k| phase[k]));
        let spread = weighted(&|k| (k as f64 - middle) * (k as f64 - middle));
        let slope = weighted(&|k| (k as f64 - middle) * (phase[k] - mean)) / spread.max(f64::MIN_POSITIVE);
        let rest: Vec<f64> = phase.iter().enumerate().map(|(k, p)| p - mean - slope * (k as f64 - middle)).collect();
        let variance = weighted(&|k| rest[k] * rest[k]).max(1e-6);
        Self { rest, variance, slope }
    }
}

/// Rank, above 0 and at most 1, of the variance `of_pair` among those with the two wanders shifted against each other by more
/// than a frame: the shifted wanders are surrogates of an unrelated pair.
fn rank_among_shifted(a: &[f64], b: &[f64], of_pair: f64, frame: f64) -> f64 {
    let m = a.len();
    let (mut tried, mut smaller) = (0, 0);
    for shift in 6 - m as isize..=m as isize - 6 {
        if shift.unsigned_abs() as f64 * HOP < frame + 1.0 {
            continue;
        }
        let (from_a, from_b) = (shift.max(0) as usize, (-shift).max(0) as usize);
        let overlap = m - shift.unsigned_abs();
        let shifted: Vec<f64> = (0..overlap).map(|k| a[from_a + k] - b[from_b + k]).collect();
        tried += 1;
        smaller += usize::from(stats::variance(&crate::core::signal::detrend::remove_line(&shifted)) <= of_pair);
    }
    if tried == 0 { 0.5 } else { (1 + smaller) as f64 / (1 + tried) as f64 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::record::Record;
    use crate::core::sim::noise::Noise;

    /// A cycle of 100 s with the given phase.
    fn loop_of(phase: &[f64], lag: f64) -> Cycle {
        let pv: Vec<f64> = phase.iter().map(|p| libm::sin(p - lag)).collect();
        Cycle::of(&Record::uniform(1.0, vec![50.0; pv.len()], pv), 0).unwrap()
    }

    fn phase(seed: u64, period: f64, n: usize) -> Vec<f64> {
        let mut noise = Noise::new(seed, 0);
        let mut now = 0.0;
        (0..n)
            .map(|_| {
                now += 2.0 * core::f64::consts::PI / period + 0.01 * noise.gaussian();
                now
            })
            .collect()
    }

    #[test]
    fn loops_of_one_source_stay_locked_and_others_do_not() {
        let one = phase(1, 100.0, 2000);
        let together = compare(&loop_of(&one, 0.0), &loop_of(&one, 1.0)).unwrap();
        let apart = compare(&loop_of(&one, 0.0), &loop_of(&phase(2, 100.5, 2000), 1.0)).unwrap();
        assert!(together[0] + 1.0 < apart[0], "{together:?} {apart:?}");
        assert!(together[8] > 0.9 && apart[8] < 0.9);
    }

    #[test]
    fn frequencies_that_differ_or_windows_that_do_not_overlap_are_not_compared() {
        let one = loop_of(&phase(1, 100.0, 2000), 0.0);
        assert_eq!(compare(&one, &loop_of(&phase(1, 130.0, 2000), 0.0)), None);
        let later = Cycle { start_s: 1800.0, ..one.clone() };
        assert_eq!(compare(&one, &later), None);
    }
}
