//! A load that grows evenly from some instant on.

use super::clues::Clues;
use super::effect::{Effect, Param, Reach, Start, Unit, WIDE_MARGIN, kept};
use crate::core::gap::candidate::Candidate;
use crate::core::gap::plan::{Part, Plan};
use crate::core::gap::problem::Problem;
use crate::core::gap::types::{Parameter, Stage};
use crate::core::sim::disturbance::Disturbance;

/// Duration of a ramp that does not end, s.
const FOR_GOOD_S: f64 = 1e9;

/// As the catalogue has it.
pub(crate) const EFFECT: Effect = Effect {
    params: &[Param {
        name: "from",
        unit: Unit::Instant,
        reach: Reach::Process,
        limits: |s| [0.0, 0.8 * s.n() as f64],
        trade: kept,
    }],
    apply: |p, plan| plan.ramp = Some(p[0]),
    starts,
    linear: rate,
    margin: WIDE_MARGIN,
    confused_with: &["step_load", "coloured_noise", "integrating"],
    separated_by: "the load itself, or PV with OP held",
    noun: "an external ramp",
    bends: true,
    local: true,
    phrase: |sizes| {
        let (slope, from) = (sizes.said("slope")?, sizes.said("from")?);
        Some(format!("an external ramp of {slope} PV units a second from {from} s after the start"))
    },
    in_loop: |stated, parts| {
        let (size, from_s) = (stated.number("slope")? * FOR_GOOD_S, stated.number("from")?);
        parts.on_pv.push(Disturbance::Ramp { size, from_s, over_s: FOR_GOOD_S });
        Ok(())
    },
    ..Effect::simulated("ramp", Stage::Disturbance)
};

fn starts(clues: &Clues<'_>) -> Vec<Start> {
    let mut out = vec![[0.0; 3]];
    out.extend(clues.bends(3).into_iter().map(|t| [t, 0.0, 0.0]));
    out
}

fn rate(_p: &[f64], plan: &Plan, of: &Candidate, problem: &Problem) -> Vec<Parameter> {
    let (rise, whole) = (of.linear.others[plan.column(Part::Ramp)], problem.n() as f64 * problem.point_s);
    vec![Parameter { name: "slope", value: rise * problem.normalised.deviation / whole, unit: "PV/s" }]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::sim::slips::Law;

    #[test]
    fn one_coefficient_is_its_slope() {
        let mut plan = Plan::base(Some(Law::He));
        (EFFECT.apply)(&[50.0], &mut plan);
        assert!(plan.ramp == Some(50.0) && plan.extras() == 1);
    }
}
