//! A sinusoid from outside, at a period of its own.

use core::f64::consts::TAU;

use super::{Clues, Effect, Param, Reach, Stage, Start, Unit, WIDE_MARGIN, Way};
use crate::gap::evaluator::Candidate;
use crate::gap::problem::Problem;
use crate::gap::structure::{Part, Plan};
use crate::gap::types::Parameter;

/// As the catalogue has it.
pub const EFFECT: Effect = Effect {
    id: "sinusoid",
    stage: Stage::Disturbance,
    way: Way::Simulated,
    params: &[Param {
        name: "period",
        unit: Unit::Period,
        reach: Reach::Process,
        // A whole period at least: less of one is a drift.
        limits: |s| [TAU / s.n() as f64, 1.5],
    }],
    enter: |p, plan| plan.omega = Some(p[0]),
    starts,
    linear: amplitude,
    margin: WIDE_MARGIN,
    predictable: true,
    confused_with: &["coloured_noise"],
    separated_by: "the suspected source beside PV; OP held for some periods",
};

fn starts(clues: &Clues<'_>) -> Vec<Start> {
    clues.frequencies(5).into_iter().map(|w| [w, 0.0, 0.0]).collect()
}

/// Half of the way from trough to crest.
fn amplitude(_p: &[f64], plan: &Plan, of: &Candidate, problem: &Problem) -> Vec<Parameter> {
    let at = plan.column(Part::Waves);
    let [a, b] = [of.linear.others[at], of.linear.others[at + 1]];
    vec![Parameter { name: "amplitude", value: (a * a + b * b).sqrt() * problem.deviation, unit: "PV" }]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::slips::Law;

    #[test]
    fn two_coefficients_are_its_amplitude_and_phase() {
        let mut plan = Plan::base(Some(Law::He));
        (EFFECT.enter)(&[0.2], &mut plan);
        assert!(plan.omega == Some(0.2) && plan.extras() == 2);
    }
}
