//! The gap by where the loop stands.

use super::held::Held;
use super::{Level, LevelR2, Test};
use crate::core::signal::stats;

/// Bins of a level.
const BINS: usize = 8;

/// Equal bins of a signal between its extremes.
struct Bins<'a> {
    signal: &'a [f64],
    low: f64,
    width: f64,
}

impl<'a> Bins<'a> {
    fn of(signal: &'a [f64], held: &Held<'_>) -> Self {
        let at: Vec<f64> =
            held.points.iter().filter_map(|&k| signal.get(k).copied()).filter(|v| v.is_finite()).collect();
        let low = at.iter().copied().fold(f64::INFINITY, f64::min);
        let high = at.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let width = (high - low) / BINS as f64;
        // A signal that stands still, or spans more than numbers hold, has one bin.
        if width.is_finite() && width > 0.0 {
            Self { signal, low, width }
        } else {
            Self { signal, low: 0.0, width: 0.0 }
        }
    }

    fn is_split(&self) -> bool {
        self.width > 0.0
    }

    fn index(&self, point: usize) -> usize {
        let place = (self.signal.get(point).copied().unwrap_or(self.low) - self.low) / self.width;
        if place.is_finite() { (place.max(0.0) as usize).min(BINS - 1) } else { 0 }
    }
}

/// Shares of the squared residual by OP; empty where OP stands still.
pub(super) fn by_op(held: &Held<'_>) -> (Vec<Level>, Option<Test>) {
    let bins = Bins::of(&held.op, held);
    if !bins.is_split() {
        return (Vec::new(), None);
    }
    let shares = held.shares("level", BINS, |k| bins.index(k));
    let mean = |i: usize| {
        let inside = held.points.iter().filter(|k| bins.index(**k) == i).map(|&k| held.residual[k]);
        let inside: Vec<f64> = inside.collect();
        (!inside.is_empty()).then(|| stats::mean(&inside))
    };
    let level = |i: usize| Level {
        from: bins.low + i as f64 * bins.width,
        to: bins.low + (i + 1) as f64 * bins.width,
        share: shares.share[i],
        expected: shares.expected[i],
        mean: mean(i),
    };
    ((0..BINS).map(level).collect(), shares.test)
}

/// R2 of the residual by bins of OP, simulated PV and valve position.
pub(super) fn r2(held: &Held<'_>) -> LevelR2 {
    let of = |purpose: &str, signal: &[f64]| {
        let bins = Bins::of(signal, held);
        if bins.is_split() { held.explained(purpose, BINS, |k| bins.index(k)) } else { None }
    };
    LevelR2 {
        op: of("level of op", &held.op),
        pv: of("level of pv", &held.fit.prediction),
        valve: of("level of the valve", &held.fit.valve),
    }
}
