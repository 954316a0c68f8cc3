//! The gap over time: segments, a change of its power, its trend.

use super::held::Held;
use super::{Course, Segment, Test};
use crate::core::gap::noise::least_squares::line;
use crate::core::signal::stats;

/// Segments of the record.
const SEGMENTS: usize = 16;
/// p below which a change of power is told, and the least ratio that is.
const TOLD_P: f64 = 0.05;
const TOLD_RATIO: f64 = 2.0;
/// Fewest stretches whose course is judged.
const MIN_STRETCHES: usize = 5;
/// Power below this share of the mean counts as this share: a perfect stretch must not decide alone.
const LEAST_POWER: f64 = 1e-6;

/// Sixteen equal stretches of what counts.
pub(super) fn segments(held: &Held<'_>) -> (Vec<Segment>, Option<Test>) {
    let n = held.residual.len();
    let length = (n - held.from) as f64 / SEGMENTS as f64;
    let edge = |i: usize| held.from as f64 + i as f64 * length;
    let of = |k: usize| if length > 0.0 { ((k - held.from) as f64 / length) as usize } else { 0 };
    let shares = held.shares("segments", SEGMENTS, of);
    let list = (0..SEGMENTS).map(|i| Segment {
        from_s: edge(i) * held.point_s,
        to_s: edge(i + 1) * held.point_s,
        share: shares.share[i],
        expected: shares.expected[i],
    });
    (list.collect(), shares.test)
}

/// Mean square of the free run's residual, fitted stretches included, over stretches of one period: place and value.
fn powers(held: &Held<'_>) -> Vec<(f64, f64)> {
    let length = held.period.round().max(1.0) as usize;
    let all = &held.residual[held.from..];
    let mean = stats::mean(&all.iter().map(|e| e * e).collect::<Vec<_>>());
    let chunks = all.chunks(length).enumerate().filter(|(_, c)| 2 * c.len() > length);
    let power = |c: &[f64]| (c.iter().map(|e| e * e).sum::<f64>() / c.len() as f64).max(LEAST_POWER * mean);
    chunks.map(|(i, c)| ((held.from + i * length) as f64, power(c))).collect()
}

/// Log-likelihood gain of one change of variance after the first `at` stretches, over none.
fn change_gain(powers: &[f64], at: usize) -> f64 {
    let log_mean = |x: &[f64]| libm::log(stats::mean(x));
    let n = powers.len() as f64;
    n * log_mean(powers) - at as f64 * log_mean(&powers[..at]) - (n - at as f64) * log_mean(&powers[at..])
}

/// Where the change gains most, and how much; at least two stretches on each side.
fn best_change(powers: &[f64]) -> (usize, f64) {
    let places = 2..powers.len().saturating_sub(1);
    places.map(|at| (at, change_gain(powers, at))).fold((0, 0.0), |best, x| if x.1 > best.1 { x } else { best })
}

/// Slope of the logarithm with time, and its correlation.
fn trend_of(logs: &[f64]) -> [f64; 2] {
    line(&(0..logs.len()).map(|k| k as f64).collect::<Vec<f64>>(), logs)
}

/// Change, trend and drift.
pub(super) fn course(held: &Held<'_>) -> Course {
    let none =
        Course { onset_s: None, onset_ratio: None, onset: None, trend_ratio: None, trend: None, drift: drift(held) };
    let stretches = powers(held);
    let values: Vec<f64> = stretches.iter().map(|(_, p)| *p).collect();
    if values.len() < MIN_STRETCHES || values.iter().any(|p| !p.is_finite() || *p <= 0.0) {
        return none;
    }
    let logs: Vec<f64> = values.iter().map(|p| libm::log(*p)).collect();
    let (at, _) = best_change(&values);
    let ratio = stats::mean(&values[at..]) / stats::mean(&values[..at.max(1)]);
    // The stretches are whole periods: they may change places one by one.
    let onset = held.test_singly("onset", &values, |x| best_change(x).1);
    let told = at > 0 && onset.is_some_and(|t| t.p < TOLD_P) && !(1.0 / TOLD_RATIO..=TOLD_RATIO).contains(&ratio);
    Course {
        onset_s: told.then(|| stretches[at].0 * held.point_s),
        onset_ratio: (at > 0).then_some(ratio),
        onset,
        trend_ratio: Some(libm::exp(trend_of(&logs)[0] * (logs.len() - 1) as f64)),
        trend: held
            .test_singly("trend", &logs, |x| Some(trend_of(x)[1].abs()).filter(|r| r.is_finite()).unwrap_or(0.0)),
        ..none
    }
}

/// Rise of the residual over the record by a line through the held-out points, PV units.
fn drift(held: &Held<'_>) -> Option<f64> {
    let t: Vec<f64> = held.points.iter().map(|&k| k as f64).collect();
    let rise = line(&t, &held.values())[0] * (held.residual.len() - held.from) as f64;
    rise.is_finite().then_some(rise)
}
