//! Which member of a group causes its oscillation, and the consequences for the others.

use super::calibration::Calibration;
use super::evidence::Evidence;
use crate::core::verdict::rule::logistic;

/// Indices of the figures that the source's rule uses directly.
const OWN: [usize; 16] = [0, 1, 2, 3, 5, 6, 7, 11, 13, 14, 8, 15, 9, 12, 16, 10];
/// Indices of the figures that it also compares with the largest of the other members.
const COMPARED: [usize; 12] = [0, 1, 2, 3, 7, 13, 14, 8, 15, 9, 12, 10];
/// Indices of the figures that the member's rule uses.
const OF_MEMBER: [usize; 13] = [0, 1, 2, 3, 4, 5, 6, 7, 11, 8, 15, 9, 12];

/// Name of each figure of the source's rule, and whether it is a comparison; for the reasons.
pub(super) fn names() -> impl Iterator<Item = (&'static str, bool)> {
    let own = OWN.iter().map(|k| (Evidence::NAMES[*k], false));
    own.chain(COMPARED.iter().map(|k| (Evidence::NAMES[*k], true)))
}

fn signed_root(x: f64) -> f64 {
    x.abs().sqrt().copysign(x)
}

/// Figures of the source's rule for each member: its own, and their excess over the largest of the others.
pub fn source_figures(group: &[[f64; Evidence::NAMES.len()]]) -> Vec<Vec<f64>> {
    let above_others = |member: usize, k: usize| {
        let others = group.iter().enumerate().filter(|(other, _)| *other != member);
        group[member][k] - others.map(|(_, figures)| figures[k]).fold(f64::MIN, f64::max)
    };
    let of = |member: usize| {
        let own = OWN.iter().map(|k| group[member][*k]);
        own.chain(COMPARED.iter().map(|k| above_others(member, *k))).map(signed_root).collect()
    };
    (0..group.len()).map(of).collect()
}

/// Figures of the member's rule: its own, its logit as the source, and the excess of the likeliest source's logit.
pub fn member_figures(figures: &[f64; Evidence::NAMES.len()], as_source: f64, best: f64) -> Vec<f64> {
    let own = OF_MEMBER.iter().map(|k| signed_root(figures[*k]));
    own.chain([as_source, best - as_source]).collect()
}

/// The decision on a group.
pub(super) struct Decision {
    /// Logit of each member as the source.
    pub logits: Vec<f64>,
    /// Probability that each member causes the oscillation.
    pub p_source: Vec<f64>,
    /// Probability that no member causes it.
    pub p_outside: f64,
    /// Contribution of each figure to the logit of the likeliest member.
    pub parts: Vec<f64>,
    /// Index of the likeliest member.
    pub best: usize,
    /// Probability by the member's rule that each valve sticks.
    p_member: Vec<f64>,
}

impl Decision {
    /// Weighs the evidence of a group; `eligible` marks the members that can cause an oscillation (a loop in manual cannot).
    pub fn of(evidence: &[Evidence], eligible: &[bool], rules: &Calibration) -> Self {
        let figures: Vec<_> = evidence.iter().map(|e| e.figures).collect();
        let standing = source_figures(&figures);
        let logit = |k: usize| if eligible[k] { rules.source.of(&standing[k]) } else { f64::NEG_INFINITY };
        let logits: Vec<f64> = (0..evidence.len()).map(logit).collect();
        let best = (0..logits.len()).max_by(|a, b| logits[*a].total_cmp(&logits[*b])).unwrap_or(0);
        // Exactly one member or none is the source, so the odds of each are relative to none.
        let odds: Vec<f64> = logits.iter().map(|logit| libm::exp(logit.min(50.0))).collect();
        let all = 1.0 + odds.iter().sum::<f64>();
        let p_member = (0..logits.len())
            .map(|k| {
                let as_source = logits[k].max(-50.0);
                logistic(rules.member.of(&member_figures(&figures[k], as_source, logits[best].max(-50.0))))
            })
            .collect();
        Self {
            p_source: odds.iter().map(|odds| odds / all).collect(),
            p_outside: 1.0 / all,
            parts: rules.source.parts(&standing[best]).collect(),
            logits,
            best,
            p_member,
        }
    }

    /// Number of members that are, each judged separately, more likely the source than not.
    pub fn likely(&self) -> usize {
        self.logits.iter().filter(|logit| **logit > 0.0).count()
    }

    /// Probability that the valve of member `k` sticks, given its own `p_alone`; and whether the group lowers it because the
    /// source explains the member's oscillation.
    pub fn p_stiction(&self, k: usize, p_alone: f64, rules: &Calibration) -> (f64, bool) {
        if k == self.best && self.logits[k] > 0.0 {
            return (p_alone.max(self.p_source[k]), false);
        }
        match self.p_member[k] < rules.capped_below {
            true => (p_alone.min(self.p_member[k]), true),
            false => (p_alone, false),
        }
    }
}
