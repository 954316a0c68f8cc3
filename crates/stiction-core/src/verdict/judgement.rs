//! From evidence to a verdict and a grade: what the classifier says, and why that is sometimes not reported.

use super::cause;
use super::document::{Assessment, Gate, Implausible, Verdict};
use super::evidence::Answer;
use super::features::Features;
use super::params::AssessParams;
use super::plausible::implausible;
use super::rule::{Opinion, Rule};
use crate::ident::region;
use crate::record::Record;

/// Reasons for no answer beside the gates and what is implausible in a record.
const NOT_FITTED: &str = "not_fitted";
const IMPLAUSIBLE_MODEL: &str = "implausible_model";
const OP_IS_HELD: &str = "op_held";
/// Share of OP samples equal to the one before from which its store is asked about, the samples a period that make that a
/// matter of the store, and the moves a period below which a cycle of the valve's signal is not seen.
const OP_HELD: f64 = 0.8;
const DENSE: f64 = 50.0;
const FEW_MOVES: f64 = 12.0;

/// What is said of a record.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Judgement {
    pub verdict: Verdict,
    pub contributing: Vec<Verdict>,
    /// Why the record has no answer.
    pub reason: Option<&'static str>,
    /// Why the model is not believed; empty where it is.
    pub implausible: Vec<Implausible>,
    /// The classifier finds no stiction, whether or not that is said: bands are bounded, not measured.
    pub not_found: bool,
}

impl Judgement {
    /// The judgement on a record of which `whole` holds oscillation and checks.
    pub(super) fn of(answer: &Answer<'_>, whole: &Assessment, params: &AssessParams) -> Self {
        let Answer { features, opinion, sized, .. } = answer;
        let implausible = implausible(sized.record, &whole.oscillation, sized.process().as_ref(), params.kind);
        let (called, contributing) = call(answer);
        let objection = match called.stiction() {
            None => Some(NOT_FITTED),
            Some(true) => too_thin(opinion, &whole.gates).or_else(|| unsupported(&implausible, features)),
            Some(false) => {
                // Where no cycle shows, as many as a verdict wants are taken for granted.
                let periods = whole.oscillation.periods.unwrap_or(params.min_periods);
                is_op_held(sized.record, periods).then_some(OP_IS_HELD)
            }
        };
        let (verdict, contributing) = match called {
            _ if objection.is_some() => (Verdict::Inconclusive, Vec::new()),
            // Without bands a dead band is not told from stick and slip.
            Verdict::Deadband if !implausible.is_empty() => (Verdict::Stiction, contributing),
            _ => (called, contributing),
        };
        Self { verdict, contributing, reason: objection, implausible, not_found: called.stiction() == Some(false) }
    }

    /// Probability of the answer that is given; `None` where none is.
    pub(super) fn confidence(&self, p_stiction: f64) -> Option<f64> {
        self.verdict.stiction().map(|_| p_stiction.max(1.0 - p_stiction))
    }
}

/// The verdict by the classifier alone, and contributing causes. Without a fit, a valve that appears to stick stays
/// inconclusive.
fn call(answer: &Answer<'_>) -> (Verdict, Vec<Verdict>) {
    let Answer { opinion, sized, controller, .. } = answer;
    let (record, estimate, found) = (sized.record, sized.estimate.as_ref(), sized.first.oscillation());
    let ringing = cause::ringing(record, found.as_ref());
    match (opinion.sticks(), estimate) {
        (true, Some(e)) => {
            let verdict = match region::region(e.s, e.j, e.span) {
                region::Region::Deadband => Verdict::Deadband,
                _ => Verdict::Stiction,
            };
            (verdict, cause::beside_sticking(e, controller.as_ref(), record, ringing.as_ref()))
        }
        (true, None) => (Verdict::Inconclusive, Vec::new()),
        (false, _) => {
            let damping = cause::moved_damping(estimate, controller.as_ref(), record);
            cause::cause(found.as_ref(), ringing.as_ref(), damping)
        }
    }
}

/// The check behind which sticking is said only as surely as an alarm would say it: the periods are too few, or sampled
/// too coarsely to show a slip.
fn too_thin(opinion: &Opinion, gates: &[Gate]) -> Option<&'static str> {
    let thin = |gate: &&Gate| matches!(gate, Gate::TooCoarse | Gate::TooFewPeriods);
    gates.iter().find(thin).filter(|_| !opinion.alarms()).map(|gate| gate.name())
}

/// Why sticking is not said of a record whose model no plant has: the record shows no cycle of a valve, or the classifier
/// finds no stiction without the model's say.
fn unsupported(implausible: &[Implausible], features: &Features) -> Option<&'static str> {
    let of_the_record = implausible.iter().find(|i| i.is_of_the_record()).map(|i| i.name());
    let stands = || implausible.is_empty() || Rule::shipped().opinion(&features.without_fit()).sticks();
    of_the_record.or_else(|| (!stands()).then_some(IMPLAUSIBLE_MODEL))
}

/// Whether the store held OP through most of a cycle, so that what the valve was sent between is not known.
fn is_op_held(record: &Record, periods: f64) -> bool {
    let raw = record.raw_samples as f64;
    let repeats = f64::from(record.facts.op_repeats);
    repeats > OP_HELD * raw && raw >= DENSE * periods && raw - repeats < FEW_MOVES * periods
}

/// Grade of a finding: A without checks, with a confidence of at least 0.95 and s known to 15 %; B with at least 0.85 and s
/// known to 30 %; C for any other, none where the valve is not said to stick. `width` is that of the interval of s relative to s.
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
    use crate::verdict::rule::Cuts;

    #[test]
    fn sticking_behind_a_thin_record_needs_the_surety_of_an_alarm() {
        let opinion = |logit: f64| Opinion { base: 0.0, logit, cuts: Cuts { called: 0.5, alarm: 0.7 } };
        let gates = [Gate::TooCoarse, Gate::Irregular];
        assert_eq!(too_thin(&opinion(0.1), &gates), Some("too_coarse"));
        assert_eq!(too_thin(&opinion(3.0), &gates), None);
        assert_eq!(too_thin(&opinion(0.1), &[Gate::Irregular]), None);
    }

    #[test]
    fn sticking_stands_without_its_model_only_where_indicators_carry_it() {
        let jumps = Features::of_scores(&[("jumps", 0.6), ("confirmed", 0.9)]);
        assert_eq!(unsupported(&[Implausible::DeadTime], &jumps), None);
        assert_eq!(unsupported(&[Implausible::DailyCycle], &jumps), Some("daily_cycle"));
        let fit = Features::of_scores(&[("jumps", 0.0), ("confirmed", 0.9)]);
        assert_eq!(unsupported(&[Implausible::DeadTime], &fit), Some(IMPLAUSIBLE_MODEL));
        assert_eq!(unsupported(&[], &fit), None);
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
