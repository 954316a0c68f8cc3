//! Plausibility of a model, as a control engineer would judge it.
//!
//! A fit finds the best numbers, not the possible ones: it may explain a daily cycle of the load by a time constant of weeks,
//! or a ramp by a gain of thousands. Values that no plant has are not reported.

use super::document::{Implausible, Oscillation, Process};
use crate::core::record::Record;
use crate::core::signal::{detrend, stats};
use crate::core::units::LoopKind;

/// Plausible values for a kind of loop.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Range {
    /// The kind.
    pub kind: LoopKind,
    /// Longest dead time, s.
    pub dead_time_s: f64,
    /// Longest time constant, s.
    pub time_constant_s: f64,
    /// Whether such a loop may integrate.
    pub integrates: bool,
}

const fn range(kind: LoopKind, dead_time_s: f64, time_constant_s: f64, integrates: bool) -> Range {
    Range { kind, dead_time_s, time_constant_s, integrates }
}

/// Plausible ranges by kind of loop.
///
/// Textbooks give typical values: flow and liquid pressure respond within seconds, gas pressure and level within seconds to
/// minutes, temperature within minutes to an hour, composition within minutes to hours (Shinskey, Process Control Systems, 4th
/// ed. 1996, properties of common loops; Seborg, Edgar, Mellichamp and Doyle, Process Dynamics and Control, ch. 12, guidelines
/// for common loops; Smith and Corripio, Principles and Practice of Automatic Process Control, ch. 6). The limits are about a
/// decade beyond, so that a damped transmitter, a long impulse line or a slow actuator passes. Flow of liquid or gas through a
/// valve is self-regulating: nothing is stored.
pub(crate) const RANGES: [Range; 6] = [
    range(LoopKind::Flow, 60.0, 300.0, false),
    range(LoopKind::Pressure, 120.0, 3_600.0, true),
    range(LoopKind::Level, 600.0, 14_400.0, true),
    range(LoopKind::Temperature, 1_800.0, 14_400.0, true),
    range(LoopKind::Analysis, 7_200.0, 28_800.0, true),
    range(LoopKind::Other, 7_200.0, 28_800.0, true),
];

impl Range {
    /// Plausible values for this kind of loop.
    #[must_use]
    pub(crate) fn of(kind: LoopKind) -> Self {
        RANGES.into_iter().find(|r| r.kind == kind).unwrap_or(RANGES[5])
    }
}

/// Samples that a time may last for any kind of loop: the record does not resolve shorter times.
const SAMPLES: f64 = 3.0;
/// Largest dead time relative to the loop's period: feedback delayed by more than half a period would not sustain it.
const HALF_A_PERIOD: f64 = 0.5;
/// Largest gain times OP's span, spans of PV.
const AMPLIFIES: f64 = 30.0;
/// Smallest fit of a credible model, % of PV's standard deviation.
const LEAST_FIT_PCT: f64 = 10.0;
/// A day, s, and the tolerance for a period of a day.
const DAY_S: f64 = 86_400.0;
const NEAR: f64 = 0.15;
/// Share of PV's variance in a straight line above which nothing else is visible.
const TREND: f64 = 0.8;

/// Implausible properties of a record's cycle and model.
#[must_use]
pub(crate) fn implausible(
    record: &Record,
    oscillation: &Oscillation,
    process: Option<&Process>,
    kind: LoopKind,
) -> Vec<Implausible> {
    let limits = Range::of(kind);
    let mut out = Vec::new();
    let mut add = |what, met: bool| {
        if met {
            out.push(what);
        }
    };
    let daily = |period: f64| (period / DAY_S - 1.0).abs() < NEAR;
    add(Implausible::DailyCycle, oscillation.period_s.is_some_and(daily));
    let line = 1.0 - stats::variance(&detrend::remove_line(&record.pv)) / stats::variance(&record.pv);
    add(Implausible::Trend, line > TREND);
    let Some(process) = process else { return out };
    let finest = SAMPLES * record.point_s();
    let half = oscillation.period_s.filter(|_| oscillation.oscillating).map_or(f64::INFINITY, |p| HALF_A_PERIOD * p);
    let dead = process.dead_time_s;
    add(Implausible::DeadTime, dead > finest && (dead > limits.dead_time_s || dead > half));
    let slowest = process.time_constants_s.first().copied().unwrap_or(0.0);
    let window_s = record.len() as f64 * record.point_s();
    add(Implausible::TimeConstant, slowest > finest && slowest > limits.time_constant_s.min(window_s));
    let (op, pv) = (stats::span(&record.op_path), stats::span(&record.pv));
    add(Implausible::Gain, !process.integrating && process.gain.abs() * op > AMPLIFIES * pv);
    add(Implausible::Integrating, process.integrating && !limits.integrates);
    add(Implausible::Fit, process.fit_pct < LEAST_FIT_PCT);
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn process() -> Process {
        Process {
            order: 1,
            gain: 1.0,
            time_constants_s: vec![5.0],
            dead_time_s: 2.0,
            integrating: false,
            mse: 0.1,
            fit_pct: 80.0,
            tested: true,
            gain_interval: None,
            dead_time_interval_s: None,
        }
    }

    fn judged(period_s: f64, process: &Process, kind: LoopKind) -> Vec<Implausible> {
        let wave = |phase: f64| (0..1000).map(|k| libm::sin(k as f64 * 0.1 + phase)).collect();
        let record = Record::uniform(1.0, wave(0.0), wave(1.0));
        let (periods, samples_per_period) = (Some(10.0), Some(period_s));
        let oscillation =
            Oscillation { oscillating: true, period_s: Some(period_s), periods, samples_per_period, regularity: None };
        implausible(&record, &oscillation, Some(process), kind)
    }

    #[test]
    fn what_a_flow_loop_cannot_have_is_named() {
        assert!(judged(62.8, &process(), LoopKind::Flow).is_empty());
        let dead = Process { dead_time_s: 655.0, ..process() };
        assert_eq!(judged(3_000.0, &dead, LoopKind::Flow), vec![Implausible::DeadTime]);
        assert!(judged(3_000.0, &dead, LoopKind::Analysis).is_empty());
        let tank = Process { integrating: true, ..process() };
        assert_eq!(judged(62.8, &tank, LoopKind::Flow), vec![Implausible::Integrating]);
        assert!(judged(62.8, &tank, LoopKind::Level).is_empty());
    }

    #[test]
    fn what_no_loop_has_is_named_whatever_its_kind() {
        let late = Process { dead_time_s: 40.0, ..process() };
        assert_eq!(judged(62.8, &late, LoopKind::Other), vec![Implausible::DeadTime]);
        let slow = Process { time_constants_s: vec![1.2e6], gain: -731.0, ..process() };
        assert_eq!(judged(62.8, &slow, LoopKind::Other), vec![Implausible::TimeConstant, Implausible::Gain]);
        assert_eq!(judged(86_000.0, &process(), LoopKind::Other), vec![Implausible::DailyCycle]);
        let blind = Process { fit_pct: -3.0, ..process() };
        assert_eq!(judged(62.8, &blind, LoopKind::Other), vec![Implausible::Fit]);
    }
}
