//! From evidence to verdict and grade: the classifier's answer, and the cases in which it is not reported.

use super::cause::{self, Missing};
use super::document::{Assessment, CountedBy, Gate, Implausible, Oscillation, Verdict};
use super::evidence::Answer;
use super::features::Features;
use super::params::AssessParams;
use super::plausible::implausible;
use super::rule::Rule;
use crate::core::ident::region;
use crate::core::record::Record;
use crate::core::signal::stats;

/// Reasons for no answer in addition to the gates and the implausible properties of a record.
const NOT_FITTED: &str = "not_fitted";
const IMPLAUSIBLE_MODEL: &str = "implausible_model";
const OP_IS_HELD: &str = "op_held";
/// OP counts as held if more than this share of its samples equal the one before, the record has at least this many samples per
/// period, and OP moves less often than this per period: then the historian, not the valve's signal, shapes the cycle.
const OP_HELD: f64 = 0.8;
const DENSE: f64 = 50.0;
const FEW_MOVES: f64 = 12.0;

/// The judgement on a record.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Judgement {
    pub verdict: Verdict,
    pub contributing: Vec<Verdict>,
    /// What is missing to name a cause.
    pub missing: Vec<Missing>,
    /// Why the record gets no answer.
    pub reason: Option<&'static str>,
    /// Why the model is not believed; empty if it is.
    pub implausible: Vec<Implausible>,
    /// Reversals of the stem, and the rule by which the record holds enough evidence.
    pub reversals: usize,
    pub counted_by: Option<CountedBy>,
    /// The classifier finds no stiction, even if this is not reported: bands are bounded, not measured.
    pub not_found: bool,
}

impl Judgement {
    /// Judges a record; `whole` holds its oscillation and checks.
    pub(super) fn of(answer: &Answer<'_>, whole: &Assessment, params: &AssessParams) -> Self {
        let Answer { features, opinion, sized, .. } = answer;
        let implausible = implausible(sized.record, &whole.oscillation, sized.process().as_ref(), params.kind);
        let (called, contributing, missing) = call(answer);
        let of_the_stem = sized.estimate.as_ref().filter(|_| opinion.sticks()).map(|e| e.reversals);
        let reversals = of_the_stem.unwrap_or_else(|| reversals_of_op(sized.record));
        let counted_by = counted_by(&whole.oscillation, reversals, params);
        let objection = match called.stiction() {
            None => Some(NOT_FITTED),
            Some(true) => unsupported(&implausible, counted_by, features),
            Some(false) => {
                // Without a cycle, assume as many periods as a verdict needs.
                let periods = whole.oscillation.periods.unwrap_or(params.min_periods);
                is_op_held(sized.record, periods).then_some(OP_IS_HELD).or_else(|| too_thin(counted_by))
            }
        };
        let (verdict, contributing, missing) = match called {
            _ if objection.is_some() => (Verdict::Inconclusive, Vec::new(), Vec::new()),
            // Without bands, dead band and stick-slip cannot be distinguished.
            Verdict::Deadband if !implausible.is_empty() => (Verdict::Stiction, contributing, missing),
            _ => (called, contributing, missing),
        };
        let not_found = called.stiction() == Some(false);
        Self { verdict, contributing, missing, reason: objection, implausible, reversals, counted_by, not_found }
    }

    /// Probability of the reported answer; `None` if there is no answer.
    pub(super) fn confidence(&self, p_calibrated: f64) -> Option<f64> {
        self.verdict.stiction().map(|_| p_calibrated.max(1.0 - p_calibrated))
    }
}

/// The verdict of the classifier alone, contributing causes, and the data missing to name one. Without a fit, a valve that
/// appears to stick stays inconclusive.
fn call(answer: &Answer<'_>) -> (Verdict, Vec<Verdict>, Vec<Missing>) {
    let Answer { opinion, sized, controller, .. } = answer;
    let (record, estimate, found) = (sized.record, sized.estimate.as_ref(), sized.first.oscillation());
    let ringing = cause::ringing(record, found.as_ref());
    match (opinion.sticks(), estimate) {
        (true, Some(e)) => {
            let verdict = match region::region(e.s, e.j, e.span) {
                region::Region::Deadband => Verdict::Deadband,
                _ => Verdict::Stiction,
            };
            (verdict, cause::beside_sticking(e, controller.as_ref(), record, ringing.as_ref()), Vec::new())
        }
        (true, None) => (Verdict::Inconclusive, Vec::new(), Vec::new()),
        (false, _) => {
            let following = cause::following(record, found.as_ref());
            if following.is_some_and(|f| cause::follows_badly(record, found.as_ref(), &f, estimate)) {
                return (Verdict::Tuning, Vec::new(), Vec::new());
            }
            let damping = cause::moved_damping(estimate, controller.as_ref(), record);
            let (verdict, beside) = cause::cause(found.as_ref(), ringing.as_ref(), damping);
            (verdict, beside, cause::missing(record, verdict, ringing.as_ref()))
        }
    }
}

/// The rule by which a record with this many reversals of the stem holds enough evidence for a verdict and an alarm.
#[must_use]
pub(super) fn counted_by(found: &Oscillation, reversals: usize, params: &AssessParams) -> Option<CountedBy> {
    let reaches = |value: Option<f64>, least: f64| value.is_some_and(|v| v >= least);
    let periods = found.oscillating
        && reaches(found.periods, params.min_periods)
        && reaches(found.samples_per_period, params.min_samples_per_period);
    match periods {
        true => Some(CountedBy::Periods),
        false => (reversals >= params.min_reversals).then_some(CountedBy::Reversals),
    }
}

/// Reversals of a stem that follows OP exactly.
#[must_use]
pub(super) fn reversals_of_op(record: &Record) -> usize {
    stats::turns(&record.op_path, 0.0)
}

/// The reason for no answer if the record does not hold enough evidence.
fn too_thin(counted_by: Option<CountedBy>) -> Option<&'static str> {
    counted_by.is_none().then_some(Gate::TooFewReversals.name())
}

/// Why stiction is not reported: the record shows no cycle of a valve, or too little of it, or the model is implausible and the
/// classifier finds no stiction without the fit's features.
fn unsupported(
    implausible: &[Implausible],
    counted_by: Option<CountedBy>,
    features: &Features,
) -> Option<&'static str> {
    let of_the_record = implausible.iter().find(|i| i.is_of_the_record()).map(|i| i.name());
    let stands = || implausible.is_empty() || Rule::shipped().opinion(&features.without_fit()).sticks();
    of_the_record.or_else(|| too_thin(counted_by)).or_else(|| (!stands()).then_some(IMPLAUSIBLE_MODEL))
}

/// Whether the historian held OP through most of a cycle, so that the valve's input between stored values is unknown.
fn is_op_held(record: &Record, periods: f64) -> bool {
    let raw = record.raw_samples as f64;
    let repeats = f64::from(record.facts.op_repeats);
    repeats > OP_HELD * raw && raw >= DENSE * periods && raw - repeats < FEW_MOVES * periods
}

/// Grade of a finding: A without checks, with a confidence of at least 0.95 and s known to 15 %; B with at least 0.85 and s
/// known to 30 %; C for any other; `None` if no stiction is reported. `width` is that of the interval of s relative to s.
#[must_use]
pub(super) fn grade(sticks: bool, confidence: Option<f64>, gated: bool, width: Option<f64>) -> Option<char> {
    let within = |least: f64, widest: f64| confidence.is_some_and(|c| c >= least) && width.is_some_and(|w| w <= widest);
    sticks.then(|| match gated {
        false if within(0.95, 0.15) => 'A',
        _ if within(0.85, 0.30) => 'B',
        _ => 'C',
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_record_counts_by_its_periods_or_by_the_reversals_of_its_stem() {
        let params = AssessParams { min_reversals: 6, ..AssessParams::default() };
        let found = |oscillating, periods, density| Oscillation {
            oscillating,
            period_s: Some(60.0),
            periods: Some(periods),
            samples_per_period: Some(density),
            regularity: None,
        };
        let cycles = found(true, 5.0, 50.0);
        assert_eq!(counted_by(&cycles, 0, &params), Some(CountedBy::Periods));
        for short in [found(true, 4.9, 50.0), found(true, 5.0, 49.0), found(false, 5.0, 50.0)] {
            assert_eq!(counted_by(&short, 6, &params), Some(CountedBy::Reversals));
            assert_eq!(counted_by(&short, 5, &params), None);
        }
    }

    #[test]
    fn sticking_stands_without_its_model_only_where_indicators_carry_it() {
        let why = |implausible: &[Implausible], features| unsupported(implausible, Some(CountedBy::Periods), features);
        let jumps = Features::of_scores(&[("jumps", 0.6), ("confirmed", 0.9)]);
        assert_eq!(why(&[Implausible::DeadTime], &jumps), None);
        let fit = Features::of_scores(&[("jumps", 0.0), ("confirmed", 0.9)]);
        assert_eq!(why(&[Implausible::DeadTime], &fit), Some(IMPLAUSIBLE_MODEL));
        assert_eq!(why(&[], &fit), None);
    }

    #[test]
    fn a_cycle_of_a_day_is_the_reason_whatever_else_is_missing() {
        let jumps = Features::of_scores(&[("jumps", 0.6)]);
        for counted_by in [None, Some(CountedBy::Reversals)] {
            assert_eq!(unsupported(&[Implausible::DailyCycle], counted_by, &jumps), Some("daily_cycle"));
        }
        assert_eq!(unsupported(&[], None, &jumps), Some("too_few_reversals"));
    }

    #[test]
    fn op_that_was_not_stored_allows_no_answer() {
        let wave = || (0..500).map(|k| libm::sin(f64::from(k) * 0.1)).collect::<Vec<_>>();
        assert!(!is_op_held(&Record::uniform(1.0, wave(), wave()), 5.0));
        let steps = (0..500).map(|k| f64::from(k / 25 % 3)).collect();
        assert!(is_op_held(&Record::uniform(1.0, steps, wave()), 5.0));
    }

    #[test]
    fn grades_ask_for_confidence_and_a_known_size() {
        let sticking = |confidence, gated, width| grade(true, Some(confidence), gated, width);
        assert_eq!(sticking(0.97, false, Some(0.1)), Some('A'));
        assert_eq!(sticking(0.97, true, Some(0.1)), Some('B'));
        assert_eq!(sticking(0.9, false, Some(0.2)), Some('B'));
        assert_eq!(sticking(0.99, false, None), Some('C'));
        assert_eq!(sticking(0.6, false, Some(0.01)), Some('C'));
        assert_eq!(grade(false, Some(0.97), false, None), None);
    }
}
