//! From a probability to a verdict and a grade.

use super::document::Verdict;
use super::rule::Opinion;
use crate::ident::Estimate;
use crate::ident::region;

/// The verdict on a window without a blocking check, and contributing causes; `otherwise` is called if the valve does not
/// stick, `beside` if it does. Without a fit (`estimate` is `None`), a valve that appears to stick stays inconclusive.
#[must_use]
pub(crate) fn judge(
    estimate: Option<&Estimate>,
    opinion: &Opinion,
    otherwise: impl FnOnce() -> (Verdict, Vec<Verdict>),
    beside: impl FnOnce(&Estimate) -> Vec<Verdict>,
) -> (Verdict, Vec<Verdict>) {
    match (opinion.sticks(), estimate) {
        (true, Some(e)) => {
            let word = match region::region(e.s, e.j, e.span) {
                region::Region::Deadband => Verdict::Deadband,
                _ => Verdict::Stiction,
            };
            (word, beside(e))
        }
        (true, None) => (Verdict::Inconclusive, Vec::new()),
        (false, _) => otherwise(),
    }
}

/// Grade of an answer: A without checks, with a confidence of at least 0.95 and s known to 15 %; B with at least 0.85 and s
/// known to 30 %; C for any other answer, D for none. `width` is that of the interval of s relative to s.
#[must_use]
pub(crate) fn grade(confidence: Option<f64>, gated: bool, width: Option<f64>) -> char {
    let within = |least: f64, widest: f64| confidence.is_some_and(|c| c >= least) && width.is_some_and(|w| w <= widest);
    match confidence {
        None => 'D',
        Some(_) if !gated && within(0.95, 0.15) => 'A',
        Some(_) if within(0.85, 0.30) => 'B',
        Some(_) => 'C',
    }
}

#[cfg(test)]
mod tests {
    use super::super::rule::Cuts;
    use super::*;

    fn opinion(logit: f64) -> Opinion {
        Opinion { base: 0.0, logit, cuts: Cuts { called: 0.5, alarm: 0.7 } }
    }

    #[test]
    fn without_a_fit_nothing_sticks() {
        let of = |logit| judge(None, &opinion(logit), || (Verdict::Disturbance, vec![]), |_| vec![Verdict::Tuning]).0;
        assert_eq!(of(-3.0), Verdict::Disturbance);
        assert_eq!(of(3.0), Verdict::Inconclusive);
        assert_eq!(of(0.1), Verdict::Inconclusive);
    }

    #[test]
    fn grades_ask_for_confidence_and_a_known_size() {
        assert_eq!(grade(Some(0.97), false, Some(0.1)), 'A');
        assert_eq!(grade(Some(0.97), true, Some(0.1)), 'B');
        assert_eq!(grade(Some(0.9), false, Some(0.2)), 'B');
        assert_eq!(grade(Some(0.99), false, None), 'C');
        assert_eq!(grade(Some(0.6), false, Some(0.01)), 'C');
        assert_eq!(grade(None, false, Some(0.01)), 'D');
    }
}
