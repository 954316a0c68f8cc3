//! From a probability to a word and a grade.

use super::document::Verdict;
use super::rule::Opinion;
use crate::detect::oscillation::Oscillates;
use crate::ident::Estimate;
use crate::ident::region;

/// Endurance (see [`Oscillates::endurance`]) above which an oscillation is driven from outside: what comes from there
/// keeps its phase, while a loop that rings by itself under random load loses it.
const DRIVEN: f64 = 0.8;
/// The same below which the loop rings by itself: a damping of 0.03 or more.
const RINGING: f64 = 0.65;

/// The verdict on a window without a blocking gate. Without a fit (`estimate` is `None`) a valve that looks sticking
/// stays open.
#[must_use]
pub fn judge(estimate: Option<&Estimate>, opinion: &Opinion, oscillation: Option<&Oscillates>) -> Verdict {
    match (opinion.sticks(), estimate) {
        (Some(true), Some(e)) => match region::region(e.s, e.j, e.span) {
            "deadband" => Verdict::Deadband,
            _ => Verdict::Stiction,
        },
        (None, _) | (Some(true), None) => Verdict::Inconclusive,
        (Some(false), _) => healthy(oscillation),
    }
}

/// What else it is.
fn healthy(oscillation: Option<&Oscillates>) -> Verdict {
    match oscillation {
        Some(o) if o.oscillating && o.endurance.is_some_and(|e| e > DRIVEN) => Verdict::Disturbance,
        Some(o) if o.oscillating && o.endurance.is_some_and(|e| e < RINGING) => Verdict::Tuning,
        Some(o) if o.oscillating => Verdict::NoStiction,
        _ => Verdict::NoOscillation,
    }
}

/// How far to trust an answer: A without gates, from a confidence of 0.95 on and with s known to 15 %; B from 0.85 on and
/// with s known to 30 %; C for any other answer, D for none. `width` is that of the interval of s over s.
#[must_use]
pub fn grade(confidence: Option<f64>, gated: bool, width: Option<f64>) -> char {
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
    use super::*;

    fn opinion(logit: f64) -> Opinion {
        Opinion { base: 0.0, logit, undecided: [0.4, 0.6] }
    }

    #[test]
    fn without_a_fit_nothing_sticks_and_the_course_decides() {
        let wave = |endurance| Oscillates {
            period_points: 50.0,
            periods: 10.0,
            regularity: 5.0,
            persistence: 0.9,
            endurance,
            oscillating: true,
        };
        let healthy = opinion(-3.0);
        assert_eq!(judge(None, &healthy, Some(&wave(Some(0.9)))), Verdict::Disturbance);
        assert_eq!(judge(None, &healthy, Some(&wave(None))), Verdict::NoStiction);
        assert_eq!(judge(None, &healthy, Some(&wave(Some(0.3)))), Verdict::Tuning);
        assert_eq!(judge(None, &healthy, None), Verdict::NoOscillation);
        assert_eq!(judge(None, &opinion(3.0), None), Verdict::Inconclusive);
        assert_eq!(judge(None, &opinion(0.0), None), Verdict::Inconclusive);
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
