//! One record in, one assessment out.

use super::cause;
use super::detectable;
use super::document::{Assessment, Controller, Gate, Oscillation, Process, Search, Verdict, Window};
use super::excursion;
use super::gates::{gates, is_interpolated};
use super::judge::{grade, judge};
use super::params::AssessParams;
use super::plausible::implausible;
use super::rule::{self, Features, Opinion, Rule};
use super::screen;
use crate::detect::oscillation::{Looks, Oscillates};
use crate::detect::{self, Indicator, View};
use crate::ident::controller::{self, Reading};
use crate::ident::region::{region, severity_by_range, strength_by_span};
use crate::ident::width::Settings;
use crate::ident::{Estimate, Options, quantify};
use crate::optim::SolverName;
use crate::record::Record;
use crate::signal::stats;

/// Reasons for no answer beside the gates and what is implausible in a record.
const STUCK_SIGNAL: &str = "stuck_signal";
const IMPLAUSIBLE_MODEL: &str = "implausible_model";
const OP_IS_HELD: &str = "op_held";
/// Share of OP samples equal to the one before from which its store is asked about, the samples a period that make that a
/// matter of the store, and the moves a period below which a cycle of the valve's signal is not seen.
const OP_HELD: f64 = 0.8;
const DENSE: f64 = 50.0;
const FEW_MOVES: f64 = 12.0;
/// Gates that do not make a fit worse by themselves: a set point that steps excites, an excursion is cut out.
const EXPLAINED: [Gate; 2] = [Gate::SetpointSteps, Gate::Excursion];
/// Share of OP's span from which on a band is as wide as OP ever went.
pub(super) const WHOLE_SWING: f64 = 0.999;
/// An interval's upper end is multiplied by this where nothing sticks. It is that of a model that the verdict does not
/// believe in: of sticking loops with a "no" (verdict cases of the calibration half, seeds 71500 to 72299) the valve's s
/// lay under the end itself in 78 % of 103, under twice the end in 94 %.
const BOUND_MARGIN: f64 = 2.0;
/// Level of the intervals in every document.
const INTERVAL_LEVEL: f64 = 0.9;

/// Judges one record: gates, oscillation, fit, verdict, grade.
///
/// Pure and deterministic: the same record and parameters give the same assessment to the last bit. A blocking gate
/// leaves every number out; values that are not finite are answered by the gates of frozen signals.
#[must_use]
pub fn assess(record: &Record, params: &AssessParams) -> Assessment {
    assess_in_windows(record, &[], params)
}

/// The same for a record too long to be judged at once: gates, oscillation and size are those of the whole, the
/// probability is that of the window with the median logit. Where the whole is held in boxes only, the sizes are that
/// window's, too.
#[must_use]
pub fn assess_in_windows(record: &Record, windows: &[Record], params: &AssessParams) -> Assessment {
    let whole = Window::of(record);
    let calm = excursion::without(record).filter(|_| windows.is_empty()).map(|[from, to]| record.part(from, to));
    let cut = calm.is_some();
    let record = calm.as_ref().unwrap_or(record);
    let mut seen = Seen::of(record, params);
    if cut {
        seen.gates.push(Gate::Excursion);
    }
    let empty = Assessment::empty(whole, describe(seen.found().as_ref(), record));
    let mut out = Assessment { gates: seen.gates.clone(), interval_level: Some(INTERVAL_LEVEL), ..empty };
    if let Some(gate) = seen.blocked() {
        let stuck = gate == Gate::FrozenPv && !seen.gates.contains(&Gate::FrozenOp);
        out.reason = Some(if stuck { STUCK_SIGNAL } else { gate.name() });
        return out;
    }
    if params.screening && !params.always_fit && screen::is_screened_out(record, &seen.looks, &seen.gates) {
        screen::answer(&mut out);
        return out;
    }
    let sights = Sights::of(record, windows, params, seen);
    let Some((window, opinion)) = Rule::shipped().answer(&sights.figures()) else { return out };
    let (features, sized) = sights.chosen(window, params);
    out.pv_span = Some(stats::span(&record.pv)).filter(|span| span.is_finite());
    if let Some(e) = &sized.evidence.estimate {
        fill(&mut out, e, sized.record, params);
    }
    decide(&mut out, opinion, &features, &sized);
    out.implausible = implausible(sized.record, &out.oscillation, out.process.as_ref(), params.kind);
    if !out.implausible.is_empty() {
        disbelieve(&mut out, &features);
    }
    let no = out.stiction == Some(false);
    if no {
        hold_back(&mut out, sized.record, params);
    }
    // An interval that ends where OP's swing does was not measured there.
    let swing = out.s.zip(out.s_over_span).map_or(f64::INFINITY, |(s, share)| s / share);
    let measured = out.s_interval.filter(|[_, high]| *high < WHOLE_SWING * swing);
    // Nothing sticks: s is bounded, not measured.
    let width = measured.filter(|_| !no).zip(out.s).map(|([low, high], s)| (high - low) / s);
    out.grade = Some(grade(out.confidence, !out.gates.is_empty(), width));
    // Where it sticks the question does not arise.
    let open = sized.evidence.estimate.as_ref().filter(|_| out.stiction == Some(false) && out.process.is_some());
    out.s_detectable = open.and_then(|e| {
        let options = options(params, sized.seen.found().as_ref());
        let interpolated = is_interpolated(sized.record);
        detectable::smallest(sized.record, &sized.evidence.view, &options, e, interpolated)
    });
    if no {
        bound(&mut out, swing);
    }
    out
}

/// The figures that the rule asks for, of every window of the record, or the blocking gate that leaves it without an answer.
///
/// # Errors
/// The first blocking gate.
pub fn figures(record: &Record, windows: &[Record], params: &AssessParams) -> Result<Vec<Features>, Gate> {
    let seen = Seen::of(record, params);
    match seen.blocked() {
        Some(gate) => Err(gate),
        None => Ok(Sights::of(record, windows, params, seen).figures()),
    }
}

/// Whether screening rules the record out as that of a calm loop, whatever `params.screening` says.
#[must_use]
pub fn is_screened_out(record: &Record, params: &AssessParams) -> bool {
    let seen = Seen::of(record, params);
    seen.blocked().is_none() && screen::is_screened_out(record, &seen.looks, &seen.gates)
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
        let options = options(params, found.as_ref());
        let estimate = if worth_it { quantify(record, &options) } else { None };
        let view = View::with_period(record, seen.looks.typical_period);
        let figures = rule::figures(estimate.as_ref(), record, &view, &detect::ALL, is_interpolated(record));
        Self { estimate, view, figures }
    }
}

/// A record with what it shows.
struct Sight<'r> {
    record: &'r Record,
    seen: Seen,
    evidence: Evidence,
}

impl<'r> Sight<'r> {
    fn of(record: &'r Record, params: &AssessParams, seen: Seen) -> Self {
        let evidence = Evidence::of(record, params, &seen);
        Self { record, seen, evidence }
    }
}

/// Every window that a record is judged in.
struct Sights<'r> {
    whole: &'r Record,
    /// What stands for it: windows, or the record itself.
    windows: Vec<Sight<'r>>,
}

impl<'r> Sights<'r> {
    fn of(whole: &'r Record, windows: &'r [Record], params: &AssessParams, seen: Seen) -> Self {
        let open = |record: &'r Record| {
            let seen = Seen::of(record, params);
            seen.blocked().is_none().then(|| Sight::of(record, params, seen))
        };
        let mut windows: Vec<Sight<'r>> = windows.iter().filter_map(open).collect();
        if windows.is_empty() {
            windows.push(Sight::of(whole, params, seen));
        }
        Self { whole, windows }
    }

    fn figures(&self) -> Vec<Features> {
        self.windows.iter().map(|sight| sight.evidence.figures.clone()).collect()
    }

    /// The features that the answering window is judged by, and the sight that sizes are taken from: the whole, where it
    /// is held as recorded.
    fn chosen(mut self, window: usize, params: &AssessParams) -> (Features, Sight<'r>) {
        let sized = self.windows.swap_remove(window);
        let features = rule::features(sized.evidence.figures.clone());
        if core::ptr::eq(sized.record, self.whole) || self.whole.box_samples > 1 {
            return (features, sized);
        }
        (features, Sight::of(self.whole, params, Seen::of(self.whole, params)))
    }
}

/// Says what the rule answers, and why.
fn decide(out: &mut Assessment, opinion: Opinion, features: &Features, sized: &Sight<'_>) {
    let (record, estimate, found) = (sized.record, sized.evidence.estimate.as_ref(), sized.seen.found());
    let rule = Rule::shipped();
    let names = rule::OF_THE_FIT.into_iter().chain(detect::ALL.iter().map(|d| d.name()));
    let indicator = |name| {
        let scored = rule.indicator_score(name, features);
        let vote = (scored.contribution != 0.0).then_some(scored.contribution > 0.0);
        Indicator { name, score: scored.score, vote, contribution: scored.contribution }
    };
    out.indicators = names.map(indicator).collect();
    let reading = controller::read(record);
    out.controller = reading.as_ref().map(as_document);
    let ringing = cause::ringing(record, found.as_ref());
    let damping = cause::moved_damping(estimate, reading.as_ref(), record);
    let otherwise = || cause::cause(found.as_ref(), ringing.as_ref(), damping);
    let beside = |e: &Estimate| cause::beside_sticking(e, reading.as_ref(), record, ringing.as_ref());
    (out.verdict, out.contributing) = judge(estimate, &opinion, otherwise, beside);
    // Where the periods are too few, or sampled too coarsely to show a slip, sticking is said only as surely as an
    // alarm would say it.
    let unsure = out.verdict.stiction() == Some(true) && !opinion.alarms();
    let thin = |gate: &&Gate| unsure && matches!(gate, Gate::TooCoarse | Gate::TooFewPeriods);
    let doubt = out.gates.iter().find(thin).map(|gate| gate.name());
    if doubt.is_some() {
        out.verdict = Verdict::Inconclusive;
        out.contributing.clear();
    }
    out.stiction = out.verdict.stiction();
    let p = opinion.p();
    out.p_stiction = Some(p);
    out.explanation = Some(opinion);
    out.confidence = out.stiction.map(|_| p.max(1.0 - p));
    out.reason = out.stiction.is_none().then_some(doubt.unwrap_or("not_fitted"));
}

/// Takes away the numbers of a model that no plant has. A verdict that stands without the model's say stays; one that
/// stands on the model alone, or on a record that shows no cycle of a valve, becomes an open question.
fn disbelieve(out: &mut Assessment, features: &Features) {
    let of_the_record = out.implausible.iter().find(|i| i.is_of_the_record());
    let mut without = features.clone();
    without.retain(|name, _| !rule::OF_THE_FIT.contains(&name.as_str()));
    let stands = of_the_record.is_none() && Rule::shipped().opinion(&without).sticks();
    if out.stiction == Some(true) && !stands {
        (out.verdict, out.stiction, out.confidence) = (Verdict::Inconclusive, None, None);
        out.contributing.clear();
        out.reason = Some(of_the_record.map_or(IMPLAUSIBLE_MODEL, |i| i.name()));
    } else if out.stiction == Some(true) {
        // Without bands a dead band is not told from stick and slip.
        out.verdict = Verdict::Stiction;
    }
    (out.fs, out.fd, out.s, out.j) = (None, None, None, None);
    (out.fs_interval, out.fd_interval, out.s_interval, out.j_interval) = (None, None, None, None);
    (out.s_over_span, out.region, out.strength_by_span, out.severity_by_range, out.j_identifiable) =
        (None, None, None, None, None);
    (out.process, out.valve_model) = (None, None);
}

/// Where no stiction is seen the bands may be anything from none up to where the record would contradict them, and up to
/// where they would have been found at least; `swing` is OP's, OP units.
fn bound(out: &mut Assessment, swing: f64) {
    let high = out.s_interval.map_or(0.0, |[_, high]| high).max(f64::MIN_POSITIVE);
    let found = out.s_detectable.map_or(0.0, |least| least / high);
    let times = BOUND_MARGIN.max(found);
    for interval in [&mut out.fs_interval, &mut out.fd_interval, &mut out.s_interval, &mut out.j_interval] {
        *interval = interval.map(|[_, high]| [0.0, (times * high).min(swing.max(high))]);
    }
}

/// Where the store held OP through most of a cycle, what the valve was sent between is not known, and a no is none. Where
/// no cycle shows, as many as a verdict wants are taken for granted.
fn hold_back(out: &mut Assessment, record: &Record, params: &AssessParams) {
    let raw = record.raw_samples as f64;
    let repeats = f64::from(record.facts.op_repeats);
    let periods = out.oscillation.periods.unwrap_or(params.min_periods);
    if repeats > OP_HELD * raw && raw >= DENSE * periods && raw - repeats < FEW_MOVES * periods {
        (out.verdict, out.stiction, out.confidence, out.reason) = (Verdict::Inconclusive, None, None, Some(OP_IS_HELD));
        out.contributing.clear();
    }
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
    stats::turns(op, band)
}

fn fill(out: &mut Assessment, e: &Estimate, record: &Record, params: &AssessParams) {
    let (fs, fd) = (0.5 * (e.s + e.j), 0.5 * (e.s - e.j));
    (out.fs, out.fd, out.s, out.j) = (Some(fs), Some(fd), Some(e.s), Some(e.j));
    out.stiction_index = Some(e.index);
    out.s_over_span = Some(e.s / e.span);
    out.region = Some(region(e.s, e.j, e.span));
    out.strength_by_span = Some(strength_by_span(e.s, e.span));
    out.severity_by_range = params.op_range.and_then(|range| severity_by_range(e.s, range));
    out.j_identifiable = Some(e.spread.j_identifiable);
    let limiting = out.gates.iter().filter(|g| !g.blocks() && !EXPLAINED.contains(g)).count();
    let settings = Settings::shipped();
    let times = (0..limiting).fold(1.0, |times, _| times * settings.gate);
    let told = e.spread.told(e.s, e.j, &settings.least(&e.spread, e.s), times).within(e.span, e.s, e.j);
    (out.s_interval, out.j_interval) = (Some(told.s), Some(told.j));
    (out.fs_interval, out.fd_interval) = (Some(told.fs), Some(told.fd));
    out.valve_model = Some(e.law);
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
    let solver = SolverName::Contour;
    out.search = Some(Search { solver, evaluations: e.evaluations, rounds: e.rounds, stopped: e.ended });
}

#[cfg(test)]
mod tests {
    use super::super::document::Implausible;
    use super::*;

    #[test]
    fn turns_are_counted_above_the_noise() {
        let op: Vec<f64> = (0..600).map(|k| libm::sin(k as f64 * 0.0628) + 0.001 * f64::from(k % 2)).collect();
        assert_eq!(reversals(&op), 12);
        assert_eq!(reversals(&[]), 0);
        assert_eq!(reversals(&[1.0; 50]), 0);
    }

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

    /// An assessment with the numbers of a fit.
    fn told(stiction: bool) -> Assessment {
        let record = Record::uniform(1.0, wave(500, 61.3), wave(500, 61.3));
        let mut out = Assessment::empty(Window::of(&record), describe(None, &record));
        out.verdict = if stiction { Verdict::Deadband } else { Verdict::NoStiction };
        (out.stiction, out.confidence) = (Some(stiction), Some(0.9));
        (out.s, out.s_interval, out.j_interval) = (Some(2.0), Some([1.5, 2.5]), Some([0.5, 0.7]));
        out
    }

    #[test]
    fn a_model_that_no_plant_has_takes_its_numbers_with_it() {
        let mut alone = told(true);
        alone.implausible = vec![Implausible::DeadTime];
        // Indicators that stand without a model: PV jumps.
        let jumps = Features::from([("jumps".to_owned(), 0.6), ("confirmed".to_owned(), 0.9)]);
        let mut backed = alone.clone();
        disbelieve(&mut backed, &jumps);
        assert_eq!((backed.verdict, backed.stiction, backed.s), (Verdict::Stiction, Some(true), None));
        let fit = Features::from([("jumps".to_owned(), 0.0), ("confirmed".to_owned(), 0.9)]);
        disbelieve(&mut alone, &fit);
        assert_eq!((alone.verdict, alone.reason), (Verdict::Inconclusive, Some(IMPLAUSIBLE_MODEL)));
        let mut daily = told(true);
        daily.implausible = vec![Implausible::DailyCycle];
        disbelieve(&mut daily, &jumps);
        assert_eq!((daily.stiction, daily.reason), (None, Some("daily_cycle")));
    }

    #[test]
    fn a_no_carries_a_bound_and_is_none_where_op_was_not_stored() {
        let mut no = told(false);
        let mut seen = no.clone();
        bound(&mut no, 4.0);
        let ends = |a: &Assessment| [a.s_interval, a.j_interval].map(|interval| interval.unwrap());
        assert_eq!((ends(&no), no.fs_interval), ([[0.0, 4.0], [0.0, 0.7 * BOUND_MARGIN]], None));
        // What would not have been found is not excluded; j goes along.
        seen.s_detectable = Some(10.0);
        bound(&mut seen, 50.0);
        assert_eq!(ends(&seen), [[0.0, 10.0], [0.0, 0.7 * 4.0]]);
        let moving = Record::uniform(1.0, wave(500, 61.3), wave(500, 61.3));
        hold_back(&mut no, &moving, &AssessParams::default());
        assert_eq!(no.stiction, Some(false));
        let steps = (0..500).map(|k| f64::from(k / 25 % 3)).collect();
        hold_back(&mut no, &Record::uniform(1.0, steps, wave(500, 61.3)), &AssessParams::default());
        assert_eq!((no.stiction, no.reason), (None, Some(OP_IS_HELD)));
    }
}
