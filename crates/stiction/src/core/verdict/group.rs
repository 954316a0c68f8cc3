//! Applies the result of a group of loops with a common oscillation to one member's estimate.

use super::document::{Assessment, MemberJudgement, Verdict};
use super::prevalence::for_prevalence;

/// Reason of an estimate without a verdict: the loop follows its group's oscillation, which hides the state of its valve.
const MASKED: &str = "masked";

impl MemberJudgement {
    /// Probability of stiction if half of the valves stick. Documents from before the prevalence store it as `p_stiction`.
    #[must_use]
    pub fn calibrated(&self) -> Option<f64> {
        self.p_calibrated.or(self.p_stiction)
    }

    /// Updates the estimate of the member's window with the group's answer.
    pub fn apply(&self, a: &mut Assessment) {
        let Some(p) = self.calibrated().filter(|_| a.stiction.is_some()) else { return };
        let called = p >= a.called_at();
        a.p_calibrated = Some(p);
        a.p_stiction = Some(for_prevalence(p, a.prevalence));
        match a.stiction {
            Some(true) if !called => {
                (a.verdict, a.stiction, a.reason) = (Verdict::Inconclusive, None, Some(MASKED));
            }
            Some(false) if called => {
                (a.verdict, a.stiction, a.missing) = (Verdict::Stiction, Some(true), Vec::new());
            }
            _ => {}
        }
        // A finding that comes from the group alone has no measured size, so its grade is C.
        a.grade = a.stiction.filter(|sticks| *sticks).map(|_| a.grade.unwrap_or('C'));
        a.confidence = a.stiction.map(|_| p.max(1.0 - p));
    }
}

impl Assessment {
    /// Probability from which a valve is called sticking.
    pub(crate) fn called_at(&self) -> f64 {
        self.explanation.map_or(0.5, |opinion| opinion.cuts.called)
    }
}
