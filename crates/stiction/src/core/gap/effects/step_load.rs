//! A load that steps at some instant, before the process or straight into PV.

use super::clues::Clues;
use super::effect::{Effect, Param, Reach, Start, Unit, WIDE_MARGIN, kept};
use crate::core::gap::candidate::Candidate;
use crate::core::gap::plan::{Part, Plan};
use crate::core::gap::problem::Problem;
use crate::core::gap::types::{Parameter, Stage};
use crate::core::sim::disturbance::Disturbance;

/// As the catalogue has it.
pub(crate) const EFFECT: Effect = Effect {
    params: &[
        Param {
            name: "at",
            unit: Unit::Instant,
            reach: Reach::Process,
            limits: |s| [s.blocks.from as f64, s.n() as f64 - 3.0],
            trade: kept,
        },
        Param { name: "straight", unit: Unit::Choice, reach: Reach::Jumps, limits: |_| [0.0, 1.0], trade: kept },
    ],
    apply: |p, plan| plan.step = Some((p[0], p[1] > 0.5)),
    starts,
    linear: size,
    margin: WIDE_MARGIN,
    confused_with: &["ramp", "coloured_noise"],
    separated_by: "the load itself",
    noun: "a step of load",
    bends: true,
    local: true,
    phrase: |sizes| {
        let (size, at) = (sizes.said("size")?, sizes.said("at")?);
        // The budget knows loads that go away again.
        Some(match sizes.said("length") {
            Some(length) => format!("a load of {size} PV units for {length} s, {at} s after the start"),
            None => format!("a load step of {size} PV units {at} s after the start"),
        })
    },
    in_loop: |stated, parts| {
        let (process, size, at_s) = (&stated.model.process, stated.number("size")?, stated.number("at")?);
        if stated.is("straight") || process.integrating {
            parts.on_pv.push(Disturbance::Step { size, at_s });
        } else {
            let (size, at_s) = (size / process.gain, at_s - process.dead_time_s);
            parts.load.push(Disturbance::Step { size, at_s });
        }
        Ok(())
    },
    ..Effect::simulated("step_load", Stage::Disturbance)
};

fn starts(clues: &Clues<'_>) -> Vec<Start> {
    clues.steps(4).into_iter().flat_map(|t| [[t, 0.0, 0.0], [t, 1.0, 0.0]]).collect()
}

fn size(_p: &[f64], plan: &Plan, of: &Candidate, problem: &Problem) -> Vec<Parameter> {
    let size = of.linear.others[plan.column(Part::Step)];
    vec![Parameter { name: "size", value: size * problem.normalised.deviation, unit: "PV" }]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::sim::slips::Law;

    #[test]
    fn one_coefficient_is_its_size() {
        let mut plan = Plan::base(Some(Law::He));
        (EFFECT.apply)(&[50.0, 1.0], &mut plan);
        assert!(plan.step == Some((50.0, true)) && plan.extras() == 1);
    }
}
