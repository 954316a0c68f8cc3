//! One record in, one assessment out.

use super::cause;
use super::detectable;
use super::document::{Assessment, Controller, Gate, Oscillation, Process, Search, Window};
use super::gates::{gates, is_interpolated};
use super::judge::{grade, judge};
use super::params::AssessParams;
use super::rule::{self, Features, Rule};
use super::screen;
use crate::detect::oscillation::{Looks, Oscillates};
use crate::detect::{self, View, Witness};
use crate::ident::controller::{self, Reading};
use crate::ident::region::{region, severity, strength};
use crate::ident::width::Settings;
use crate::ident::{Estimate, Options, quantify};
use crate::record::Record;
use crate::signal::stats;
use crate::sim::slips::Law;

/// Level of the intervals in every document.
const INTERVAL_LEVEL: f64 = 0.9;

/// Judges one record: gates, oscillation, fit, verdict, grade.
///
/// Pure and deterministic: the same record and parameters give the same assessment to the last bit. A blocking gate
/// leaves every number out; values that are not finite are answered by the gates of frozen signals.
#[must_use]
pub fn assess(record: &Record, params: &AssessParams) -> Assessment {
    let seen = Seen::of(record, params);
    let empty = Assessment::empty(Window::of(record), describe(seen.found().as_ref(), record));
    let mut out = Assessment { gates: seen.gates.clone(), interval_level: Some(INTERVAL_LEVEL), ..empty };
    if let Some(gate) = seen.blocked() {
        out.reason = Some(gate.name());
        return out;
    }
    if params.screening && !params.always_fit && screen::lets_go(record, &seen.looks, &seen.gates) {
        screen::answer(&mut out);
        return out;
    }
    let found = seen.found();
    let evidence = &Evidence::of(record, params, &seen);
    if let Some(e) = &evidence.estimate {
        fill(&mut out, e, record, params);
    }
    decide(&mut out, evidence, record, found.as_ref());
    // Where it sticks the question does not arise.
    let open = evidence.estimate.as_ref().filter(|_| out.stiction != Some(true));
    out.s_detectable = open.and_then(|e| {
        let options = options(params, found.as_ref());
        detectable::smallest(record, &evidence.view, &options, e, is_interpolated(record))
    });
    out
}

/// The figures that the rule asks for, or the blocking gate that leaves the record without an answer.
///
/// # Errors
/// The first blocking gate.
pub fn figures(record: &Record, params: &AssessParams) -> Result<Features, Gate> {
    let seen = Seen::of(record, params);
    match seen.blocked() {
        Some(gate) => Err(gate),
        None => Ok(Evidence::of(record, params, &seen).figures),
    }
}

/// Whether [`assess`] with these parameters lets the record go as that of a calm loop; their `screening` aside.
#[must_use]
pub fn lets_go(record: &Record, params: &AssessParams) -> bool {
    let seen = Seen::of(record, params);
    seen.blocked().is_none() && screen::lets_go(record, &seen.looks, &seen.gates)
}

/// What a record shows at once.
struct Seen {
    looks: Looks,
    gates: Vec<Gate>,
}

impl Seen {
    fn of(record: &Record, params: &AssessParams) -> Self {
        let looks = Looks::of(&record.op(), &record.pv);
        let gates = gates(record, &describe(looks.together().as_ref(), record), params);
        Self { looks, gates }
    }

    fn found(&self) -> Option<Oscillates> {
        self.looks.together()
    }

    fn blocked(&self) -> Option<Gate> {
        self.gates.iter().copied().find(|g| g.blocks())
    }
}

/// What the verdict stands on.
struct Evidence {
    /// `None` where nothing was fitted.
    estimate: Option<Estimate>,
    /// The record as the detectors look at it.
    view: View,
    figures: Features,
}

impl Evidence {
    fn of(record: &Record, params: &AssessParams, seen: &Seen) -> Self {
        let found = seen.found();
        let worth_it = params.always_fit
            || found.is_some_and(|o| o.oscillating && o.periods >= params.min_periods)
            || reversals(&record.op()) as f64 >= params.min_periods;
        let estimate = if worth_it { quantify(record, &options(params, found.as_ref())) } else { None };
        let view = View::with_period(record, seen.looks.typical_period);
        let figures = rule::figures(estimate.as_ref(), record, &view, &detect::ALL, is_interpolated(record));
        Self { estimate, view, figures }
    }
}

/// Asks the rule and says what it answers, and why.
fn decide(out: &mut Assessment, evidence: &Evidence, record: &Record, found: Option<&Oscillates>) {
    let rule = Rule::shipped();
    let estimate = evidence.estimate.as_ref();
    let features = rule::features(evidence.figures.clone());
    let opinion = rule.opinion(&features);
    let names = rule::OF_THE_FIT.into_iter().chain(detect::ALL.iter().map(|d| d.name()));
    let witness = |name| {
        let voice = rule.voice(name, &features);
        let vote = (voice.contribution != 0.0).then_some(voice.contribution > 0.0);
        Witness { name, score: voice.score, vote, contribution: voice.contribution }
    };
    out.witnesses = names.map(witness).collect();
    let reading = controller::read(record);
    out.controller = reading.as_ref().map(as_document);
    let ringing = cause::ringing(record, found);
    let damping = cause::moved_damping(estimate, reading.as_ref(), record);
    let otherwise = || cause::cause(found, ringing.as_ref(), damping);
    let beside = |e: &Estimate| cause::beside_sticking(e, reading.as_ref(), record, ringing.as_ref());
    (out.verdict, out.contributing) = judge(estimate, &opinion, otherwise, beside);
    out.stiction = out.verdict.stiction();
    let p = opinion.p();
    out.p_stiction = Some(p);
    out.explanation = Some(opinion);
    out.confidence = out.stiction.map(|_| p.max(1.0 - p));
    out.reason = out.stiction.is_none().then_some(if opinion.sticks().is_none() { "undecided" } else { "not_fitted" });
    let width = out.s_interval.zip(out.s).map(|([low, high], s)| (high - low) / s);
    out.grade = Some(grade(out.confidence, !out.gates.is_empty(), width));
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

fn options(params: &AssessParams, found: Option<&Oscillates>) -> Options {
    params.options(found.map(|o| o.period_points))
}

fn describe(found: Option<&Oscillates>, record: &Record) -> Oscillation {
    Oscillation {
        oscillating: found.is_some_and(|o| o.oscillating),
        period_s: found.map(|o| o.period_points * record.point_s()),
        periods: found.map(|o| o.periods),
        samples_per_period: found.map(|o| o.period_points * recorded_per_point(record)),
        regularity: found.map(|o| o.regularity),
    }
}

/// Samples, as they were recorded, in a point.
fn recorded_per_point(record: &Record) -> f64 {
    if record.recorded_ts_s == record.ts_s {
        record.box_samples as f64
    } else {
        record.point_s() / record.recorded_ts_s
    }
}

/// Turns of OP that are larger than its noise and a twentieth of its span.
fn reversals(op: &[f64]) -> usize {
    let band = (6.0 * stats::noise_sd(op)).max(0.05 * stats::span(op));
    let (mut high, mut low, mut rising, mut count) = (f64::NEG_INFINITY, f64::INFINITY, None, 0);
    for &u in op {
        high = high.max(u);
        low = low.min(u);
        if rising != Some(false) && u < high - band {
            count += usize::from(rising.is_some());
            (rising, low) = (Some(false), u);
        } else if rising != Some(true) && u > low + band {
            count += usize::from(rising.is_some());
            (rising, high) = (Some(true), u);
        }
    }
    count
}

fn fill(out: &mut Assessment, e: &Estimate, record: &Record, params: &AssessParams) {
    let (fs, fd) = (0.5 * (e.s + e.j), 0.5 * (e.s - e.j));
    (out.fs, out.fd, out.s, out.j) = (Some(fs), Some(fd), Some(e.s), Some(e.j));
    out.stiction_index = Some(e.index);
    out.s_over_span = Some(e.s / e.span);
    out.region = Some(region(e.s, e.j, e.span));
    out.strength = Some(strength(e.s, e.span));
    out.severity = params.op_range.and_then(|range| severity(e.s, range));
    out.j_identifiable = Some(e.spread.j_identifiable);
    // The set point's steps do not make a fit worse by themselves.
    let limiting = out.gates.iter().filter(|g| !g.blocks() && **g != Gate::SetpointSteps).count();
    let settings = Settings::shipped();
    let times = (0..limiting).fold(1.0, |times, _| times * settings.gate);
    let told = e.spread.told(e.s, e.j, settings.of(e.spread.trust(e.s)), times).within(e.span, e.s, e.j);
    (out.s_interval, out.j_interval) = (Some(told.s), Some(told.j));
    (out.fs_interval, out.fd_interval) = (Some(told.fs), Some(told.fd));
    out.valve_model = Some(match e.law {
        Law::He => "he",
        Law::Tracking => "tracking",
    });
    let spread = stats::std_dev(&record.pv);
    out.process = Some(Process {
        order: e.class.order(),
        gain: e.gain,
        time_constants_s: e.time_constants_s.clone(),
        dead_time_s: e.dead_time_s,
        integrating: e.class.integrates(),
        mse: e.mse,
        fit_pct: 100.0 * (1.0 - e.mse.sqrt() / spread),
    });
    out.search =
        Some(Search { solver: e.solver, evaluations: e.evaluations, rounds: e.rounds, stopped: e.ended.name() });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn turns_are_counted_above_the_noise() {
        let op: Vec<f64> = (0..600).map(|k| libm::sin(k as f64 * 0.0628) + 0.001 * f64::from(k % 2)).collect();
        assert_eq!(reversals(&op), 12);
        assert_eq!(reversals(&[]), 0);
        assert_eq!(reversals(&[1.0; 50]), 0);
    }
}
