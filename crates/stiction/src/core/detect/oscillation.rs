//! Oscillation: whether there is one, its period and its regularity.
//!
//! Regularity of the zero crossings of the autocorrelation (Thornhill, Huang and Zhang 2003): a third of mean over standard
//! deviation of the intervals between them; above 1 the loop oscillates. The autocorrelation spreads the noise over all lags,
//! so the crossings show the oscillation.

use crate::core::signal::{detrend, spectrum, stats};

/// An oscillation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Oscillates {
    /// Length of a period, points.
    pub period_points: f64,
    /// Periods in the record.
    pub periods: f64,
    /// Thornhill's regularity; above 1 is regular. Capped at 100.
    pub regularity: f64,
    /// Autocorrelation one period later, -1..1: the share of variance that repeats.
    pub persistence: f64,
    /// The part of it left two periods later, corrected for the shorter overlap: 1 for an external periodic disturbance,
    /// `exp(-4 pi zeta)` for a loop of damping `zeta` ringing under random load. `None` below five periods.
    pub endurance: Option<f64>,
    /// Regular, persistent and at least two periods long.
    pub oscillating: bool,
}

/// Longest signal correlated directly; longer ones are averaged in bins first.
const MAX_POINTS: usize = 2048;
/// Most intervals between crossings used for the regularity.
const INTERVALS: usize = 10;
/// Intervals used for a typical period.
const TYPICAL: usize = 8;
/// Persistence below which crossings are due to chance.
const MIN_PERSISTENCE: f64 = 0.2;

/// Rounding residual of a straight line, as a share of its largest value.
const ROUNDING: f64 = 1e-12;

/// Oscillations of a loop's signals.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Looks {
    /// The controller output alone.
    pub op: Option<Oscillates>,
    /// The process variable alone.
    pub pv: Option<Oscillates>,
    /// See `typical_period`, of the controller output.
    pub typical_period: Option<f64>,
}

impl Looks {
    /// Analyses controller output and process variable, each `n` points long.
    #[must_use]
    pub(crate) fn of(op: &[f64], pv: &[f64]) -> Self {
        let output = Signal::of(op);
        Self {
            op: output.as_ref().and_then(Signal::oscillates),
            pv: detect_one(pv),
            typical_period: output.as_ref().and_then(Signal::typical_period),
        }
    }

    /// The loop's oscillation: OP has priority (the controller's integral action smooths it); PV is used if only PV has a
    /// regular oscillation. `None` if neither has four half periods between zero crossings.
    #[must_use]
    pub(crate) fn together(&self) -> Option<Oscillates> {
        match (self.op, self.pv) {
            (Some(a), Some(b)) => Some(if b.oscillating && !a.oscillating { b } else { a }),
            (a, b) => a.or(b),
        }
    }
}

/// Finds an oscillation in controller output and process variable, each `n` points long; see `Looks::together`.
#[must_use]
pub fn detect(op: &[f64], pv: &[f64]) -> Option<Oscillates> {
    Looks { op: detect_one(op), pv: detect_one(pv), typical_period: None }.together()
}

/// Finds an oscillation in one signal, both as recorded and without components slower than a third of it.
#[must_use]
pub(crate) fn detect_one(x: &[f64]) -> Option<Oscillates> {
    Signal::of(x)?.oscillates()
}

/// A typical period of a signal, points, whether or not it oscillates: twice the mean of the first eight intervals between
/// zero crossings of the autocorrelation, after removing a line and components slower than a third of the record. Between 2
/// and half the record; `None` for a constant.
#[must_use]
pub(crate) fn typical_period(x: &[f64]) -> Option<f64> {
    Signal::of(x)?.typical_period()
}

/// A signal in at most [`MAX_POINTS`] bins, as its autocorrelation.
struct Signal {
    /// Points per bin.
    factor: usize,
    boxes: usize,
    /// Of the signal minus its line.
    whole: Vec<f64>,
    /// Of the same without components slower than a third of it.
    faster: Vec<f64>,
}

impl Signal {
    fn of(x: &[f64]) -> Option<Self> {
        if x.len() < 16 || x.iter().any(|v| !v.is_finite()) {
            return None;
        }
        let factor = x.len().div_ceil(MAX_POINTS);
        let means = detrend::box_means(x, factor);
        let x = detrend::remove_line(&means);
        let largest = |x: &[f64]| x.iter().fold(0.0_f64, |most, v| most.max(v.abs()));
        if largest(&x) <= ROUNDING * largest(&means) {
            return None;
        }
        let boxes = x.len();
        let less = detrend::remove_mean(&detrend::high_pass(&x, boxes / 3));
        let [whole, faster] = spectrum::autocorrelations([&x, &less], 3 * boxes / 5);
        Some(Self { factor, boxes, whole, faster })
    }

    fn oscillates(&self) -> Option<Oscillates> {
        let whole = judge(&self.whole, self.boxes, self.factor);
        if whole.is_some_and(|o| o.oscillating) {
            return whole;
        }
        match (whole, judge(&self.faster, self.boxes, self.factor)) {
            (Some(a), Some(b)) => Some(if b.oscillating || b.regularity > a.regularity { b } else { a }),
            (a, b) => a.or(b),
        }
    }

    fn typical_period(&self) -> Option<f64> {
        let places = spectrum::zero_crossings(&self.faster, 0.0);
        let gaps: Vec<f64> = places.windows(2).take(TYPICAL).map(|w| w[1] - w[0]).collect();
        let period = if gaps.is_empty() { return None } else { 2.0 * stats::mean(&gaps) };
        Some((period * self.factor as f64).clamp(2.0, 0.5 * (self.boxes * self.factor) as f64))
    }
}

/// The oscillation of a detrended signal of `n` bins of `factor` record points each, from its autocorrelation.
fn judge(acf: &[f64], n: usize, factor: usize) -> Option<Oscillates> {
    let places = spectrum::zero_crossings(acf, (1.5 / (n as f64).sqrt()).max(0.02));
    let gaps: Vec<f64> = places.windows(2).take(INTERVALS).map(|w| w[1] - w[0]).collect();
    if gaps.len() < 3 {
        return None;
    }
    let period = 2.0 * stats::mean(&gaps);
    // Sample variance, not population variance: a few intervals must not look regular by chance.
    let spread = (stats::variance(&gaps) * gaps.len() as f64 / (gaps.len() - 1) as f64).sqrt();
    let regularity = if spread > 0.0 { (period / 2.0 / (3.0 * spread)).min(100.0) } else { 100.0 };
    // The peak near a whole number of periods, corrected as if every lag overlapped fully.
    let peak = |count: f64| {
        let (from, to) = ((count - 0.2) * period, (count + 0.2) * period);
        let around = acf.iter().enumerate().skip(from as usize).take_while(|(lag, _)| *lag as f64 <= to + 1.0);
        around.map(|(lag, r)| r * n as f64 / (n - lag) as f64).reduce(f64::max)
    };
    let (from, to) = ((0.8 * period) as usize, ((1.2 * period).ceil() as usize).min(acf.len() - 1));
    let persistence = acf.get(from..=to)?.iter().copied().fold(-1.0, f64::max);
    let periods = n as f64 / period;
    let endurance = match (peak(1.0), peak(3.0)) {
        (Some(sooner), Some(later)) if periods >= 5.0 && sooner > 0.0 => Some(later / sooner),
        _ => None,
    };
    Some(Oscillates {
        period_points: period * factor as f64,
        periods,
        regularity,
        persistence,
        endurance,
        oscillating: regularity > 1.0 && persistence > MIN_PERSISTENCE && periods >= 2.0 && period >= 3.0,
    })
}

#[cfg(test)]
mod tests {
    use super::super::noise;
    use super::*;

    fn sine(n: usize, period: f64) -> Vec<f64> {
        (0..n).map(|k| libm::sin(2.0 * core::f64::consts::PI * k as f64 / period)).collect()
    }

    #[test]
    fn a_noisy_drifting_sine_is_found() {
        for period in [12.0, 50.0, 233.0] {
            let x: Vec<f64> = sine(2000, period)
                .iter()
                .zip(noise(2000, 3))
                .enumerate()
                .map(|(k, (s, e))| s + 2.0 * e + 0.002 * k as f64)
                .collect();
            let found = detect_one(&x).unwrap();
            assert!(found.oscillating, "{period}: {found:?}");
            assert!((found.period_points / period - 1.0).abs() < 0.05, "{period}: {found:?}");
        }
    }

    #[test]
    fn noise_a_step_and_a_walk_do_not_oscillate() {
        let mut false_alarms = 0;
        for seed in 1..20 {
            let white = noise(1500, seed);
            let mut level = 0.0;
            let walk: Vec<f64> = white
                .iter()
                .map(|e| {
                    level += e;
                    level
                })
                .collect();
            false_alarms += usize::from(detect_one(&white).is_some_and(|o| o.oscillating));
            false_alarms += usize::from(detect_one(&walk).is_some_and(|o| o.oscillating));
        }
        assert!(false_alarms <= 2, "{false_alarms} of 38");
        let step: Vec<f64> = (0..1000).map(|k| f64::from(u8::from(k > 400))).collect();
        assert!(!detect_one(&step).is_some_and(|o| o.oscillating));
        assert!(detect_one(&[1.0; 500]).is_none());
        assert!(detect_one(&[]).is_none());
    }

    #[test]
    fn long_signals_are_averaged_first() {
        let found = detect_one(&sine(20_000, 900.0)).unwrap();
        assert!(found.oscillating && (found.period_points / 900.0 - 1.0).abs() < 0.05);
    }
}
