//! From figures to a word.
//!
//! Provisional: one logistic rule over the fit's index and the model-free signs, its weights fitted once to some
//! thousand simulated loops and to published labelled recordings, every real valve counting once. Its output is not
//! yet a calibrated probability and is therefore not published as one.

use super::document::Verdict;
use crate::detect::Witness;
use crate::detect::oscillation::Oscillates;
use crate::ident::Estimate;
use crate::ident::region;

/// Weights of the rule: constant, stiction index, and the detectors by name.
const CONSTANT: f64 = -4.877;
const INDEX: f64 = 4.329;
const SIGNS: [(&str, f64); 4] = [("horch", 1.173), ("jumps", 5.389), ("curve_fit", 3.886), ("travel", 1.513)];
/// Logit from which the valve is said to stick: odds of 7 to 3, where one healthy simulated loop in twenty is accused.
const CUT: f64 = 0.847;
/// s over OP's span below which the index counts less: smaller bands are within what noise and rounding imitate.
const FULL_WEIGHT: f64 = 0.2;
/// Share of the free-run error that the valve law must remove to be believed without any other sign: loops that obey
/// the law reach it, healthy ones stay far below (a dead band in front of an integrator shows no jump in PV).
const PLAIN_INDEX: f64 = 0.75;
/// Turns of the stem that this takes: fewer can be an accident.
const PLAIN_REVERSALS: usize = 6;
/// Endurance (see [`Oscillates::endurance`]) above which an oscillation is driven from outside: what comes from there
/// keeps its phase, while a loop that rings by itself under random load loses it.
const DRIVEN: f64 = 0.8;
/// The same below which the loop rings by itself: a damping of 0.03 or more.
const RINGING: f64 = 0.65;

/// Logit of the rule; signs that the record does not show count 0.
#[must_use]
pub fn evidence(estimate: Option<&Estimate>, witnesses: &[Witness]) -> f64 {
    let index = estimate.map_or(0.0, |e| e.index * (e.s / (FULL_WEIGHT * e.span)).min(1.0));
    let of = |name: &str| witnesses.iter().find(|w| w.name == name).and_then(|w| w.score).unwrap_or(0.0);
    CONSTANT + INDEX * index + SIGNS.iter().map(|(name, weight)| weight * of(name)).sum::<f64>()
}

/// The verdict on a window without a blocking gate (`estimate` is `None` where nothing was fitted, which leaves a
/// sticking valve unproven).
#[must_use]
pub fn judge(estimate: Option<&Estimate>, witnesses: &[Witness], oscillation: Option<&Oscillates>) -> Verdict {
    let plain = |e: &Estimate| e.index >= PLAIN_INDEX && e.s > FULL_WEIGHT * e.span && e.reversals >= PLAIN_REVERSALS;
    if let Some(e) = estimate.filter(|e| plain(e) || evidence(estimate, witnesses) >= CUT) {
        return match region::region(e.s, e.j, e.span) {
            "deadband" => Verdict::Deadband,
            _ => Verdict::Stiction,
        };
    }
    match oscillation {
        Some(o) if o.oscillating && o.endurance.is_some_and(|e| e > DRIVEN) => Verdict::Disturbance,
        Some(o) if o.oscillating && o.endurance.is_some_and(|e| e < RINGING) => Verdict::Tuning,
        Some(o) if o.oscillating => Verdict::NoStiction,
        _ => Verdict::NoOscillation,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn witnesses(score: f64) -> Vec<Witness> {
        SIGNS.iter().map(|(name, _)| Witness { name, score: Some(score), vote: None }).collect()
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
        let all = witnesses(1.0);
        assert_eq!(judge(None, &all, Some(&wave(Some(0.9)))), Verdict::Disturbance);
        assert_eq!(judge(None, &all, Some(&wave(None))), Verdict::NoStiction);
        assert_eq!(judge(None, &all, Some(&wave(Some(0.3)))), Verdict::Tuning);
        assert_eq!(judge(None, &all, None), Verdict::NoOscillation);
    }

    #[test]
    fn every_sign_speaks_for_the_valve() {
        assert!(evidence(None, &witnesses(0.0)) < evidence(None, &witnesses(0.1)));
        let named: Vec<&str> = crate::detect::ALL.iter().map(|d| d.name()).collect();
        assert!(SIGNS.iter().all(|(name, _)| named.contains(name)));
    }
}
