//! Validity checks: which limits a record has, and why.

use super::document::{Gate, Oscillation};
use super::params::AssessParams;
use super::swapped;
use crate::core::record::Record;
use crate::core::signal::{detrend, stats};

/// Fewest points for an estimate.
const MIN_SAMPLES: usize = 30;
/// Largest share of samples in manual, or bad and filled, in a window.
const MANUAL_SHARE: f64 = 0.05;
const BAD_SHARE: f64 = 0.2;
/// Samples per period below which the cause of the cycle cannot be named.
const FEWEST_A_PERIOD: f64 = 10.0;
/// PV does not respond: its distance from the set point throughout the window, standard deviations of PV; the share of OP's
/// variance in a straight line; and the share of PV's variance that must not be in one. An integrating controller ramps like
/// this against an error that it cannot remove.
const AWAY: f64 = 3.0;
const RUNS: f64 = 0.9;
const FOLLOWS: f64 = 0.5;
/// The span of OP relative to its range below which an OP between 0 and 1 is taken for a fraction, and the smallest median of a
/// fraction: a nearly shut valve has such an OP, too.
const FRACTION_SPAN: f64 = 0.01;
const FRACTION_MIDDLE: f64 = 0.05;
/// Share of repeated samples above which a signal counts as frozen.
const FROZEN_SHARE: f64 = 0.995;
/// Share of OP samples at an end of its range above which OP counts as saturated, and the width of an end, spans. At a limit
/// neither valve nor controller is visible, so most of the window must be between the limits.
const SATURATED_SHARE: f64 = 0.4;
const END_WIDTH: f64 = 1e-3;
/// Share of held or interpolated PV samples above which a history counts as compressed (a third, as in public tools).
const COMPRESSED_SHARE: f64 = 0.3;
/// Most levels of a quantised signal, and the quantum in standard deviations from which it is coarse.
const FEW_LEVELS: usize = 24;
const COARSE_QUANTUM: f64 = 0.25;
/// Variation of the sampling time (spread over mean) above which sampling counts as irregular.
const IRREGULAR: f64 = 0.1;

/// All validity checks that apply to the record, in the order of [`Gate::ALL`].
#[must_use]
pub(crate) fn gates(record: &Record, oscillation: &Oscillation, params: &AssessParams) -> Vec<Gate> {
    if record.len() < MIN_SAMPLES {
        // So few samples show nothing, not even whether a signal is frozen.
        return vec![Gate::TooFewSamples];
    }
    let op = record.op();
    let raw = record.raw_samples.max(1) as f64;
    let facts = &record.facts;
    let density = oscillation.samples_per_period;
    let periods = oscillation.periods;
    let quantised = is_coarse(&record.op_path) || is_coarse(&record.pv);
    let met = |gate: Gate| match gate {
        Gate::Manual => f64::from(facts.manual) > MANUAL_SHARE * raw,
        Gate::BadQuality => f64::from(facts.bad) + f64::from(facts.filled) > BAD_SHARE * raw,
        Gate::FrozenPv => is_frozen(&record.pv, f64::from(facts.pv_repeats) / raw),
        Gate::FrozenOp => is_frozen(&record.op_path, f64::from(facts.op_repeats) / raw),
        Gate::NoResponse => has_no_response(record, &op),
        Gate::OpScale => params.op_range.is_some_and(|range| is_fraction(&record.op_path, range)),
        // Not by the controller: that takes as long as a fit, so it is left to records worth one.
        Gate::Swapped => swapped::by_set_point(record),
        Gate::Saturated => is_saturated(&op, params.op_range),
        Gate::TooFewSamples => periods.is_some_and(|p| p < 2.0),
        Gate::RateTooLow => oscillation.oscillating && density.is_some_and(|n| n < FEWEST_A_PERIOD),
        Gate::Skipped => false,
        Gate::TooFewPeriods => periods.is_some_and(|p| p < params.min_periods),
        Gate::TooCoarse => density.is_some_and(|n| n < params.min_samples_per_period),
        Gate::SetpointSteps => record.sp.as_deref().is_some_and(|sp| has_steps(sp, &record.pv)),
        Gate::Quantised => quantised,
        Gate::Compressed => is_compressed(record, quantised),
        Gate::Irregular => record.irregularity > IRREGULAR,
        // Set by the code that finds them.
        Gate::TooFewReversals | Gate::Excursion | Gate::StepOrUpset => false,
    };
    Gate::ALL.into_iter().filter(|g| met(*g)).collect()
}

/// The signal never or hardly ever moves; values that are not finite count as not moving.
fn is_frozen(x: &[f64], repeats: f64) -> bool {
    let low = x.iter().copied().fold(f64::INFINITY, f64::min);
    let high = x.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let width = high - low;
    !width.is_finite() || width <= 1e-9 * high.abs().max(low.abs()) || repeats >= FROZEN_SHARE
}

/// OP ramps in a straight line while PV rests away from its set point. Without a set point, a loop that holds its PV against a
/// drifting load looks the same.
fn has_no_response(record: &Record, op: &[f64]) -> bool {
    let Some(sp) = record.sp.as_deref().filter(|sp| sp.len() == record.len()) else { return false };
    let error: Vec<f64> = sp.iter().zip(&record.pv).map(|(s, p)| s - p).collect();
    let mean = stats::mean(&error);
    let away = mean.abs() > AWAY * stats::std_dev(&record.pv) && error.iter().all(|e| e * mean > 0.0);
    let in_line = |x: &[f64]| 1.0 - stats::variance(&detrend::remove_line(x)) / stats::variance(x);
    // A purely proportional controller also rests away from its set point, but its OP is an image of PV.
    away && in_line(op) > RUNS && in_line(&record.pv) < FOLLOWS
}

/// Whether OP moves between 0 and 1 although its range is much wider: it seems to be a fraction of that range.
#[must_use]
pub fn is_fraction(op: &[f64], [low, high]: [f64; 2]) -> bool {
    let narrow = stats::span(op) < FRACTION_SPAN * (high - low).abs();
    narrow && op.iter().all(|u| (0.0..=1.0).contains(u)) && stats::median(op) >= FRACTION_MIDDLE && !is_frozen(op, 0.0)
}

/// OP is within 0.2 % of a limit of its range for two fifths of the time or, if no limit is reached or known, within 0.1 % of
/// its own extreme although it has many levels.
fn is_saturated(op: &[f64], range: Option<[f64; 2]>) -> bool {
    let n = op.len() as f64;
    let share = |test: &dyn Fn(f64) -> bool| op.iter().filter(|u| test(**u)).count() as f64 / n > SATURATED_SHARE;
    if let Some([a, b]) = range {
        let (low, high) = (a.min(b), a.max(b));
        let margin = 0.002 * (high - low);
        if share(&|u| u >= high - margin) || share(&|u| u <= low + margin) {
            return true;
        }
    }
    let low = op.iter().copied().fold(f64::INFINITY, f64::min);
    let high = op.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let width = END_WIDTH * (high - low);
    stats::levels(op, FEW_LEVELS + 1) > FEW_LEVELS && (share(&|u| u >= high - width) || share(&|u| u <= low + width))
}

/// The set point moves occasionally, not at every sample, and by a visible share of PV's movement.
fn has_steps(sp: &[f64], pv: &[f64]) -> bool {
    let moves: Vec<f64> = sp.windows(2).map(|w| (w[1] - w[0]).abs()).filter(|m| *m > 0.0).collect();
    let largest = moves.iter().copied().fold(0.0, f64::max);
    !moves.is_empty() && moves.len() * 5 < sp.len() && largest > 0.2 * stats::std_dev(pv)
}

/// The signal has few levels, or a resolution that is coarse compared with its movement.
fn is_coarse(x: &[f64]) -> bool {
    // Most signals soon show so many different values that neither can apply.
    let many = (x.len() / 4 + 1).max(FEW_LEVELS + 1);
    if stats::levels(&x[..x.len().min(2 * many)], many + 1) > many {
        return false;
    }
    if stats::levels(x, FEW_LEVELS + 1) <= FEW_LEVELS {
        return true;
    }
    let sorted = stats::sorted(x);
    let gaps: Vec<f64> = sorted.windows(2).map(|w| w[1] - w[0]).filter(|g| *g > 0.0).collect();
    // The tenth percentile of the gaps between used values: on a grid it is the quantum, else far below it.
    gaps.len() * 4 < x.len() && stats::quantile(&gaps, 0.1) > COARSE_QUANTUM * stats::std_dev(x)
}

/// PV repeats itself, or lies on straight lines between stored values.
fn is_compressed(record: &Record, quantised: bool) -> bool {
    let raw = record.raw_samples.max(1) as f64;
    if quantised {
        return false;
    }
    if f64::from(record.facts.pv_repeats) / raw > COMPRESSED_SHARE {
        return true;
    }
    is_interpolated(record)
}

/// PV lies on straight lines between stored values: its corners come from the historian.
pub(super) fn is_interpolated(record: &Record) -> bool {
    let scale = 1e-6 * stats::std_dev(&record.pv);
    let straight =
        record.pv.windows(3).filter(|w| (w[2] - 2.0 * w[1] + w[0]).abs() < scale && (w[1] - w[0]).abs() > 0.0).count();
    straight as f64 > COMPRESSED_SHARE * record.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    const STILL: Oscillation =
        Oscillation { oscillating: false, period_s: None, periods: None, samples_per_period: None, regularity: None };

    fn wave(n: usize, period: f64) -> Vec<f64> {
        (0..n).map(|k| 50.0 + 3.0 * libm::sin(2.0 * core::f64::consts::PI * k as f64 / period)).collect()
    }

    fn of(op: Vec<f64>, pv: Vec<f64>) -> Vec<Gate> {
        gates(&Record::uniform(1.0, op, pv), &STILL, &AssessParams::default())
    }

    #[test]
    fn a_plain_record_meets_no_gate() {
        assert!(of(wave(500, 61.3), wave(500, 61.3)).is_empty());
    }

    #[test]
    fn each_fault_meets_its_gate() {
        let good = || wave(500, 61.3);
        assert_eq!(of(good(), vec![1.0; 500])[0], Gate::FrozenPv);
        assert_eq!(of(vec![1.0; 500], good())[0], Gate::FrozenOp);
        let clipped: Vec<f64> = good().iter().map(|u| u.min(49.5)).collect();
        assert_eq!(of(clipped, good()), vec![Gate::Saturated]);
        assert_eq!(of(wave(20, 7.3), wave(20, 7.3))[0], Gate::TooFewSamples);
        assert_eq!(of(vec![50.0], vec![20.0])[0], Gate::TooFewSamples);
        let rounded: Vec<f64> = good().iter().map(|u| u.round()).collect();
        assert_eq!(of(good(), rounded), vec![Gate::Quantised]);
        let held: Vec<f64> = good().iter().enumerate().map(|(k, _)| wave(500, 61.3)[k - k % 3]).collect();
        assert_eq!(of(good(), held), vec![Gate::Compressed]);
        let lines: Vec<f64> = (0..500)
            .map(|k| {
                let (w, m) = (wave(520, 61.3), k - k % 10);
                w[m] + (w[m + 10] - w[m]) * (k - m) as f64 / 10.0
            })
            .collect();
        assert_eq!(of(good(), lines), vec![Gate::Compressed]);
    }

    #[test]
    fn facts_and_set_point_meet_their_gates() {
        let mut record = Record::uniform(1.0, wave(500, 61.3), wave(500, 61.3));
        record.irregularity = 0.3;
        record.sp = Some((0..500).map(|k| if k < 250 { 50.0 } else { 53.0 }).collect());
        record.facts.manual = 100;
        record.facts.bad = 200;
        let found = gates(&record, &STILL, &AssessParams::default());
        assert_eq!(found, vec![Gate::Manual, Gate::BadQuality, Gate::SetpointSteps, Gate::Irregular]);
    }

    #[test]
    fn swapped_signals_are_a_gate_where_the_set_point_shows_them() {
        let far = wave(500, 61.3).iter().map(|x| x - 20.0).collect::<Vec<_>>();
        let record = Record { sp: Some(vec![50.0; 500]), ..Record::uniform(1.0, wave(500, 61.3), far.clone()) };
        assert_eq!(gates(&record, &STILL, &AssessParams::default()), vec![Gate::Swapped]);
        assert!(of(wave(500, 61.3), far).is_empty());
    }

    #[test]
    fn a_few_samples_show_only_that_they_are_few() {
        for n in [1, 29] {
            assert_eq!(of(vec![1.0; n], vec![1.0; n]), vec![Gate::TooFewSamples]);
        }
    }

    #[test]
    fn below_ten_samples_a_period_nothing_is_said() {
        let density = |n: f64, oscillating: bool| {
            let seen = Oscillation { oscillating, samples_per_period: Some(n), ..STILL };
            gates(&Record::uniform(1.0, wave(500, 61.3), wave(500, 61.3)), &seen, &AssessParams::default())
        };
        assert_eq!(density(9.9, true), vec![Gate::RateTooLow, Gate::TooCoarse]);
        assert_eq!(density(10.1, true), vec![Gate::TooCoarse]);
        // Without an oscillation the zero crossings are those of noise.
        assert_eq!(density(3.0, false), vec![Gate::TooCoarse]);
    }

    #[test]
    fn a_pv_that_does_not_answer_is_told_from_one_that_is_held() {
        let noise = |k: usize| libm::sin(k as f64 * k as f64 * 0.7);
        let found = |pv: &dyn Fn(usize) -> f64, op: &dyn Fn(usize) -> f64| {
            let [op, pv] = [op, pv].map(|of| (0..500).map(of).collect::<Vec<f64>>());
            gates(
                &Record { sp: Some(vec![2.5; 500]), ..Record::uniform(1.0, op, pv) },
                &STILL,
                &AssessParams::default(),
            )
        };
        let ramp = |k: usize| 5.0 + 0.1 * k as f64;
        assert_eq!(found(&|k| 0.02 * noise(k), &ramp), vec![Gate::NoResponse]);
        // Held at the set point against a drifting load; proportional control, whose OP is an image of PV; an OP at rest.
        let answers = |pv: &dyn Fn(usize) -> f64, op: &dyn Fn(usize) -> f64| !found(pv, op).contains(&Gate::NoResponse);
        assert!(answers(&|k| 2.5 + 0.02 * noise(k), &ramp));
        assert!(answers(&|k| 1.0 + 1e-3 * k as f64, &|k| 50.0 - 0.1 * k as f64 + noise(k)));
        assert!(answers(&|k| 0.02 * noise(k), &|k| 50.0 + noise(k + 7)));
    }

    #[test]
    fn an_op_between_0_and_1_is_no_percentage() {
        let range = [0.0, 100.0];
        let around = |middle: f64, height: f64| -> Vec<f64> {
            wave(500, 61.3).iter().map(|u| middle + height * (u - 50.0) / 3.0).collect()
        };
        assert!(is_fraction(&around(0.5, 0.06), range));
        // The right range, a percentage, a shut valve, and a valve at rest.
        assert!(!is_fraction(&around(0.5, 0.06), [0.0, 1.0]) && !is_fraction(&around(50.0, 0.06), range));
        assert!(!is_fraction(&around(0.01, 0.01), range) && !is_fraction(&[0.5; 500], range));
        let record = Record::uniform(1.0, around(0.5, 0.06), wave(500, 61.3));
        let params = AssessParams { op_range: Some(range), ..AssessParams::default() };
        assert_eq!(gates(&record, &STILL, &params), vec![Gate::OpScale]);
    }

    #[test]
    fn a_range_tells_saturation_of_few_levels() {
        let op: Vec<f64> = (0..300).map(|k| if k % 3 > 0 { 100.0 } else { 60.0 + f64::from(k % 7) }).collect();
        let record = Record::uniform(1.0, op, wave(300, 61.3));
        let params = AssessParams { op_range: Some([0.0, 100.0]), ..AssessParams::default() };
        assert!(gates(&record, &STILL, &params).contains(&Gate::Saturated));
    }
}
