//! A load that steps at some instant, before the process or straight into PV.

use super::{Clues, Effect, Param, Reach, Stage, Start, Unit, WIDE_MARGIN, Way};
use crate::gap::evaluator::Candidate;
use crate::gap::problem::Problem;
use crate::gap::structure::{Part, Plan};
use crate::gap::types::Parameter;

/// As the catalogue has it.
pub const EFFECT: Effect = Effect {
    id: "step_load",
    stage: Stage::Disturbance,
    way: Way::Simulated,
    params: &[
        Param {
            name: "at",
            unit: Unit::Instant,
            reach: Reach::Process,
            limits: |s| [s.blocks.from as f64, s.n() as f64 - 3.0],
        },
        Param { name: "straight", unit: Unit::Choice, reach: Reach::Jumps, limits: |_| [0.0, 1.0] },
    ],
    enter: |p, plan| plan.step = Some((p[0], p[1] > 0.5)),
    starts,
    linear: size,
    margin: WIDE_MARGIN,
    predictable: true,
    confused_with: &["ramp", "coloured_noise"],
    separated_by: "the load itself",
};

fn starts(clues: &Clues<'_>) -> Vec<Start> {
    clues.steps(4).into_iter().flat_map(|t| [[t, 0.0, 0.0], [t, 1.0, 0.0]]).collect()
}

fn size(_p: &[f64], plan: &Plan, of: &Candidate, problem: &Problem) -> Vec<Parameter> {
    let size = of.linear.others[plan.column(Part::Step)];
    vec![Parameter { name: "size", value: size * problem.deviation, unit: "PV" }]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::slips::Law;

    #[test]
    fn one_coefficient_is_its_size() {
        let mut plan = Plan::base(Some(Law::He));
        (EFFECT.enter)(&[50.0, 1.0], &mut plan);
        assert!(plan.step == Some((50.0, true)) && plan.extras() == 1);
    }
}
