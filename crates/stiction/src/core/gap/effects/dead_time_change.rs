//! From some instant on, another dead time.

use super::clues::Clues;
use super::effect::{Effect, Param, Reach, Start, Unit, WIDE_MARGIN, kept};
use crate::core::gap::candidate::Candidate;
use crate::core::gap::plan::Plan;
use crate::core::gap::problem::Problem;
use crate::core::gap::types::{Parameter, Stage};

/// As the catalogue has it.
pub(crate) const EFFECT: Effect = Effect {
    params: &[
        Param {
            name: "at",
            unit: Unit::OwnInstant,
            reach: Reach::Jumps,
            limits: |s| [s.blocks.from as f64, s.n() as f64 - 2.0],
            trade: kept,
        },
        Param {
            name: "added",
            unit: Unit::Time,
            reach: Reach::Process,
            limits: |s| [-s.longest_lag(), s.longest_lag()],
            trade: |theta, _, by, _| theta.lag -= 0.5 * by,
        },
    ],
    apply: |p, plan| plan.switch = Some([p[0], p[1]]),
    starts,
    linear: at,
    margin: WIDE_MARGIN,
    confused_with: &["gain_drift", "time_skew"],
    separated_by: "flow or speed that sets the transport time",
    noun: "a changed dead time",
    from_model: |p, theta| p[0] -= theta.lag.floor(),
    bends: true,
    local: true,
    clashes: &["inverse_response"],
    phrase: |sizes| {
        let (added, at) = (sizes.said("added")?, sizes.said("at")?);
        Some(format!("a dead time that changes by {added} s, {at} s after the start"))
    },
    ..Effect::simulated("dead_time_change", Stage::Process)
};

fn starts(clues: &Clues<'_>) -> Vec<Start> {
    let (n, lag) = (clues.problem.n() as f64, clues.lag);
    let mut out = Vec::new();
    for at in [0.3, 0.45, 0.6, 0.75] {
        for added in [-0.6 * lag, 0.5 * lag, 1.5 * lag] {
            out.push([at * n, added, 0.0]);
        }
    }
    out
}

/// The change is found at the valve; PV shows it the dead time later.
fn at(p: &[f64], _plan: &Plan, of: &Candidate, problem: &Problem) -> Vec<Parameter> {
    vec![Parameter { name: "at", value: (p[0] + of.theta.lag.floor()) * problem.point_s, unit: "s" }]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::sim::slips::Law;

    #[test]
    fn nothing_added_is_the_base() {
        let mut plan = Plan::base(Some(Law::He));
        (EFFECT.apply)(&[100.0, 3.0], &mut plan);
        assert_eq!(plan.switch, Some([100.0, 3.0]));
        assert!(plan.is_linear_in_fd());
    }
}
