//! From figures to a word.
//!
//! Provisional: one logistic rule over the fit's index and the model-free signs, its weights fitted once to some
//! thousand simulated loops and to published labelled recordings, every real valve counting once. Its output is not
//! yet a calibrated probability and is therefore not published as one.

use super::document::Verdict;
use crate::detect::Witness;
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
/// Logit of the rule; signs that the record does not show count 0.
#[must_use]
pub fn evidence(estimate: Option<&Estimate>, witnesses: &[Witness]) -> f64 {
    let index = estimate.map_or(0.0, |e| e.index * (e.s / (FULL_WEIGHT * e.span)).min(1.0));
    let of = |name: &str| witnesses.iter().find(|w| w.name == name).and_then(|w| w.score).unwrap_or(0.0);
    CONSTANT + INDEX * index + SIGNS.iter().map(|(name, weight)| weight * of(name)).sum::<f64>()
}

/// The verdict on a window without a blocking gate (`estimate` is `None` where nothing was fitted, which leaves a
/// sticking valve unproven), and what contributes; `otherwise` is asked where the valve does not stick, `beside` where
/// it does.
#[must_use]
pub fn judge(
    estimate: Option<&Estimate>,
    witnesses: &[Witness],
    otherwise: impl FnOnce() -> (Verdict, Vec<Verdict>),
    beside: impl FnOnce(&Estimate) -> Vec<Verdict>,
) -> (Verdict, Vec<Verdict>) {
    let plain = |e: &Estimate| e.index >= PLAIN_INDEX && e.s > FULL_WEIGHT * e.span && e.reversals >= PLAIN_REVERSALS;
    if let Some(e) = estimate.filter(|e| plain(e) || evidence(estimate, witnesses) >= CUT) {
        let word = match region::region(e.s, e.j, e.span) {
            "deadband" => Verdict::Deadband,
            _ => Verdict::Stiction,
        };
        return (word, beside(e));
    }
    otherwise()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn witnesses(score: f64) -> Vec<Witness> {
        SIGNS.iter().map(|(name, _)| Witness { name, score: Some(score), vote: None }).collect()
    }

    #[test]
    fn without_a_fit_nothing_sticks() {
        let other = || (Verdict::Disturbance, vec![]);
        assert_eq!(judge(None, &witnesses(1.0), other, |_| vec![Verdict::Tuning]).0, Verdict::Disturbance);
    }

    #[test]
    fn every_sign_speaks_for_the_valve() {
        assert!(evidence(None, &witnesses(0.0)) < evidence(None, &witnesses(0.1)));
        let named: Vec<&str> = crate::detect::ALL.iter().map(|d| d.name()).collect();
        assert!(SIGNS.iter().all(|(name, _)| named.contains(name)));
    }
}
