//! One record in, one assessment out: first look, evidence, judgement, document.

use super::detectable;
use super::document::{Assessment, Controller, Gate, NO_VALVE, Process, Search, Verdict, Window};
use super::evidence::{Answer, FirstLook, Windows, describe, options};
use super::excursion;
use super::features::Figures;
use super::judgement::{Judgement, counted_by, grade, reversals_of_op};
use super::params::AssessParams;
use super::prevalence::for_prevalence;
use super::rule::Rule;
use super::screen;
use super::swapped;
use super::valve_position::ValvePosition;
use crate::core::ident::Estimate;
use crate::core::ident::controller::Reading;
use crate::core::ident::region::{self, region, severity_by_range, strength_by_span};
use crate::core::ident::width::{Intervals, Settings, agree};
use crate::core::optim::SolverName;
use crate::core::record::Record;
use crate::core::signal::stats;
use crate::core::units::FinalElement;

/// Reason for no answer: PV never moves although OP does.
const STUCK_SIGNAL: &str = "stuck_signal";
/// Gates that do not make a fit worse: steps of the set point excite the loop, and an excursion is cut out.
const EXPLAINED: [Gate; 2] = [Gate::SetpointSteps, Gate::Excursion];
/// Share of OP's span from which a band counts as wide as the whole span.
pub(super) const WHOLE_SWING: f64 = 0.999;
/// Factor on an interval's upper end where no stiction is found. That interval belongs to a model that the verdict does not
/// believe: of 103 sticking loops with a "no" (verdict cases of the calibration half, seeds 71500 to 72299) the valve's s was
/// below the upper end in 78 %, and below twice the upper end in 94 %.
const BOUND_MARGIN: f64 = 2.0;
/// Standard deviation of the set point over PV's from which its moves separate the process from the controller.
const MOVED: f64 = 0.2;
/// Share of PV's movement that a model may leave unexplained in the part of a record that it was not fitted to.
const HOLDS: f64 = 0.7;
/// Level of the intervals in every document.
const INTERVAL_LEVEL: f64 = 0.9;

/// Judges one record: gates, oscillation, fit, verdict, grade.
///
/// Pure and deterministic: the same record and parameters give the same assessment to the last bit. A blocking gate leaves all
/// numbers absent; the gates of frozen signals catch values that are not finite.
#[must_use]
pub fn assess(record: &Record, params: &AssessParams) -> Assessment {
    assess_in_windows(record, &[], params)
}

/// As [`assess`], for a record too long to be judged at once: gates, oscillation and size come from the whole, the probability
/// from the window with the median logit. If the whole is held in boxes only, the sizes come from that window, too.
#[must_use]
pub fn assess_in_windows(record: &Record, windows: &[Record], params: &AssessParams) -> Assessment {
    let window = Window::of(record);
    let event = excursion::without(record).filter(|_| windows.is_empty());
    // Without a set point the event may be the response to a step.
    let is_upset = record.sp.is_some();
    let calm = event.filter(|_| is_upset).map(|[from, to]| record.part(from, to));
    let record = calm.as_ref().unwrap_or(record);
    let mut first = FirstLook::of(record, params);
    if event.is_some() {
        first.gates.push(if is_upset { Gate::Excursion } else { Gate::StepOrUpset });
    }
    let whole = Assessment {
        gates: first.gates.clone(),
        interval_level: Some(INTERVAL_LEVEL),
        op_range: params.op_range,
        op_unit: params.op_unit.clone(),
        prevalence: params.prevalence,
        valve_position: ValvePosition::of(record),
        ..Assessment::empty(window, describe(first.oscillation().as_ref(), record))
    };
    if params.final_element != FinalElement::Valve {
        return Assessment { reason: Some(NO_VALVE), ..whole };
    }
    if let Some(gate) = first.blocking() {
        let stuck = gate == Gate::FrozenPv && !first.gates.contains(&Gate::FrozenOp);
        return Assessment { reason: Some(if stuck { STUCK_SIGNAL } else { gate.name() }), ..whole };
    }
    if params.screening && !params.always_fit && screen::is_screened_out(record, &first.looks, &first.gates) {
        let reversals = reversals_of_op(record);
        let counted_by = counted_by(&whole.oscillation, reversals, params);
        return screen::answer(Assessment { reversals: Some(reversals), counted_by, ..whole });
    }
    if record.sp.is_none() && swapped::by_controller(record) {
        let mut gates = whole.gates;
        gates.push(Gate::Swapped);
        gates.sort_unstable();
        return Assessment { reason: Some(Gate::Swapped.name()), gates, ..whole };
    }
    let pv_span = Some(stats::span(&record.pv)).filter(|span| span.is_finite());
    let Some(answer) = Windows::of(record, windows, params, first).answer(params) else { return whole };
    let judgement = Judgement::of(&answer, &whole, params);
    document(&answer, judgement, Assessment { pv_span, ..whole }, params)
}

/// The figures that the rule needs, for every window of the record, or the blocking gate that prevents an answer.
///
/// # Errors
/// The first blocking gate.
pub fn figures(record: &Record, windows: &[Record], params: &AssessParams) -> Result<Vec<Figures>, Gate> {
    let first = FirstLook::of(record, params);
    match first.blocking() {
        Some(gate) => Err(gate),
        None => Ok(Windows::of(record, windows, params, first).figures()),
    }
}

/// Whether screening would skip the record as that of a calm loop, whatever `params.screening` says.
#[must_use]
pub fn is_screened_out(record: &Record, params: &AssessParams) -> bool {
    let first = FirstLook::of(record, params);
    first.blocking().is_none() && screen::is_screened_out(record, &first.looks, &first.gates)
}

/// Writes the assessment; `whole` holds the results from before any fit.
fn document(answer: &Answer<'_>, judgement: Judgement, whole: Assessment, params: &AssessParams) -> Assessment {
    let fit = answer.sized.estimate.as_ref();
    let p = answer.opinion.p();
    let confidence = judgement.confidence(p);
    let mut gates = whole.gates;
    if judgement.counted_by.is_none() {
        gates.push(Gate::TooFewReversals);
        gates.sort_unstable();
    }
    let found = Assessment {
        verdict: judgement.verdict,
        stiction: judgement.verdict.stiction(),
        reason: judgement.reason,
        p_stiction: Some(for_prevalence(p, params.prevalence)),
        p_calibrated: Some(p),
        confidence,
        gates,
        missing: judgement.missing,
        counted_by: judgement.counted_by,
        reversals: Some(judgement.reversals),
        stiction_index: fit.map(Estimate::stiction_index),
        controller: answer.controller.as_ref().map(as_document),
        indicators: Rule::shipped().indicators(&answer.features),
        explanation: Some(answer.opinion),
        search: fit.map(as_search),
        ..whole
    };
    let Some(e) = fit.filter(|_| judgement.implausible.is_empty()) else {
        let grade = found.stiction.and_then(|sticks| grade(sticks, confidence, !found.gates.is_empty(), None));
        return Assessment { grade, contributing: judgement.contributing, implausible: judgement.implausible, ..found };
    };
    let s_detectable = if found.stiction == Some(false) { detectable(answer, e, params) } else { None };
    let measured = intervals(e, &found.gates);
    let intervals = if judgement.not_found { bounded(&measured, s_detectable, e.span) } else { measured };
    // An interval that ends at OP's span was not measured there, and neither was that of a valve that does not stick.
    let is_measured = !judgement.not_found && measured.s[1] < WHOLE_SWING * e.span;
    let width = is_measured.then(|| (measured.s[1] - measured.s[0]) / e.s);
    let j_identifiable = e.spread.j_identifiable && is_one_kind(&intervals, e.s);
    let verdict = match found.verdict {
        // Slip and play cannot be distinguished.
        Verdict::Deadband if !j_identifiable => Verdict::Stiction,
        other => other,
    };
    // A likelihood that is reliable says more than thirds of the record do.
    let s_thirds: Vec<f64> =
        e.spread.thirds.iter().flatten().map(|third| third.s).filter(|_| !e.spread.stands()).collect();
    let limited = !found.gates.is_empty() || !agree(&s_thirds, measured.s);
    Assessment {
        verdict,
        contributing: judgement.contributing,
        grade: found.stiction.and_then(|sticks| grade(sticks, confidence, limited, width)),
        fs: Some(0.5 * (e.s + e.j)),
        fd: Some(0.5 * (e.s - e.j)),
        s: Some(e.s),
        j: Some(e.j),
        fs_interval: Some(intervals.fs),
        fd_interval: Some(intervals.fd),
        s_interval: Some(intervals.s),
        j_interval: Some(intervals.j),
        s_thirds,
        j_identifiable: Some(j_identifiable),
        s_detectable,
        s_over_span: Some(e.s / e.span),
        region: Some(region(e.s, e.j, e.span)),
        strength_by_span: Some(strength_by_span(e.s, e.span)),
        severity_by_range: params.op_range.and_then(|range| severity_by_range(e.s, range)),
        valve_model: Some(e.law),
        process: answer.sized.process().map(|p| Process { tested: is_tested(answer, e, found.stiction), ..p }),
        fitted_by: Some(e.basis),
        ..found
    }
}

/// Whether both ends of j's interval are the same kind of sticking.
fn is_one_kind(intervals: &Intervals, s: f64) -> bool {
    let [low, high] = intervals.j.map(|j| region::kind(s, j));
    low == high
}

/// Whether the record tests the process model: the set point or the valve moves PV independently of the controller, and the
/// model holds in the part that it was not fitted to.
fn is_tested(answer: &Answer<'_>, e: &Estimate, stiction: Option<bool>) -> bool {
    let is_excited = stiction == Some(true) || answer.sized.figures.setpoint_share >= MOVED;
    is_excited && e.held_out <= HOLDS
}

/// The intervals of the bands, wider for every gate that limits the fit.
fn intervals(e: &Estimate, gates: &[Gate]) -> Intervals {
    let limiting = gates.iter().filter(|g| !g.blocks() && !EXPLAINED.contains(g)).count();
    let settings = Settings::shipped();
    let times = (0..limiting).fold(1.0, |times, _| times * settings.gate);
    e.spread.told(e.s, e.j, &settings.least(&e.spread, e.s), times).within(e.span, e.s, e.j)
}

/// Where no stiction is found, each band lies between zero and the value that the record would contradict, but at least the
/// detection limit; `swing` is OP's span, OP units.
fn bounded(measured: &Intervals, s_detectable: Option<f64>, swing: f64) -> Intervals {
    let found = s_detectable.map_or(0.0, |least| least / measured.s[1].max(f64::MIN_POSITIVE));
    let times = BOUND_MARGIN.max(found);
    let bound = |[_, high]: [f64; 2]| [0.0, (times * high).min(swing.max(high))];
    Intervals { s: bound(measured.s), j: bound(measured.j), fs: bound(measured.fs), fd: bound(measured.fd) }
}

fn detectable(answer: &Answer<'_>, e: &Estimate, params: &AssessParams) -> Option<f64> {
    let sized = &answer.sized;
    detectable::smallest(sized.record, &sized.view, &options(params, &sized.first), e, sized.interpolated)
}

const fn as_document(r: &Reading) -> Controller {
    Controller {
        kc: r.kc,
        ti_s: r.ti_s,
        td_s: r.td_s,
        lag_samples: r.lag_samples,
        r2: r.r2,
        unexplained: r.unexplained,
    }
}

const fn as_search(e: &Estimate) -> Search {
    Search { solver: SolverName::Contour, evaluations: e.evaluations, rounds: e.rounds, stopped: e.ended }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wave(n: usize, period: f64) -> Vec<f64> {
        (0..n).map(|k| 50.0 + 3.0 * libm::sin(2.0 * core::f64::consts::PI * k as f64 / period)).collect()
    }

    #[test]
    fn a_signal_that_stands_still_while_op_travels_is_said_in_words() {
        let found = assess(&Record::uniform(1.0, wave(500, 61.3), vec![1.0; 500]), &AssessParams::default());
        assert_eq!((found.reason, found.stiction, found.p_stiction), (Some(STUCK_SIGNAL), None, None));
        let both = assess(&Record::uniform(1.0, vec![2.0; 500], vec![1.0; 500]), &AssessParams::default());
        assert_eq!(both.reason, Some(Gate::FrozenPv.name()));
    }

    #[test]
    fn without_a_set_point_a_step_is_not_called_an_upset() {
        let jumped = |x: Vec<f64>| x.into_iter().enumerate().map(|(k, v)| if k < 450 { v } else { v - 90.0 }).collect();
        let [op, pv] = [61.3, 61.3].map(|period| jumped(wave(500, period)));
        // In manual, so that no fit is made.
        let mut record = Record::uniform(1.0, op, pv);
        record.facts.manual = 100;
        let of = |record: &Record| assess(record, &AssessParams::default());
        let kept = of(&record);
        assert!(kept.gates.ends_with(&[Gate::StepOrUpset]) && kept.counted_by.is_none(), "{:?}", kept.gates);
        let cut = of(&Record { sp: Some(vec![50.0; 500]), ..record });
        assert!(cut.gates.ends_with(&[Gate::Excursion]), "{:?}", cut.gates);
    }

    #[test]
    fn swapped_signals_without_a_set_point_are_named_in_the_answer() {
        let at = |t: f64| libm::sin(t * 0.13) + 0.3 * libm::sin(t * 0.9) + 0.2 * libm::sin(t * t * 0.01);
        let pv: Vec<f64> = (0..600).map(|k| 50.0 + at(f64::from(k))).collect();
        let mut integral = 0.0;
        let pi = |p: &f64| {
            integral += 0.035 * (50.0 - p);
            30.0 + 0.7 * (50.0 - p) + integral
        };
        let op: Vec<f64> = pv.iter().map(pi).collect();
        let found =
            assess(&Record::uniform(5.0, pv, op), &AssessParams { always_fit: true, ..AssessParams::default() });
        assert_eq!((found.reason, found.p_stiction), (Some("swapped"), None));
        assert!(found.gates.contains(&Gate::Swapped));
    }

    #[test]
    fn where_nothing_is_found_the_bands_have_bounds() {
        let measured = Intervals { s: [1.5, 2.5], j: [0.5, 0.7], fs: [1.0, 1.6], fd: [0.4, 1.0] };
        let within_swing = bounded(&measured, None, 4.0);
        assert_eq!((within_swing.s, within_swing.j), ([0.0, 4.0], [0.0, 0.7 * BOUND_MARGIN]));
        // A band below the detection limit is not excluded; j scales with s.
        let beyond = bounded(&measured, Some(10.0), 50.0);
        assert_eq!((beyond.s, beyond.j), ([0.0, 10.0], [0.0, 0.7 * 4.0]));
    }

    #[test]
    fn a_jump_that_may_be_none_or_a_slip_is_not_one_kind() {
        let with = |j: [f64; 2]| is_one_kind(&Intervals { s: [5.0, 7.0], j, fs: [0.0; 2], fd: [0.0; 2] }, 5.8);
        assert!(!with([0.0, 4.64]) && !with([0.0, 7.75]) && with([1.2, 4.64]) && with([0.0, 0.3]));
    }
}
