//! A sinusoid from outside, at a period of its own.

use core::f64::consts::TAU;

use super::clues::Clues;
use super::effect::{Effect, Param, Reach, Start, Unit, WIDE_MARGIN, kept};
use crate::gap::candidate::Candidate;
use crate::gap::plan::{Part, Plan};
use crate::gap::problem::Problem;
use crate::gap::types::{Parameter, Stage};
use crate::sim::disturbance::Disturbance;

/// As the catalogue has it.
pub const EFFECT: Effect = Effect {
    params: &[Param {
        name: "period",
        unit: Unit::Period,
        reach: Reach::Process,
        // A whole period at least: less of one is a drift.
        limits: |s| [TAU / s.n() as f64, 1.5],
        trade: kept,
    }],
    apply: |p, plan| plan.omega = Some(p[0]),
    starts,
    linear: amplitude,
    margin: WIDE_MARGIN,
    confused_with: &["coloured_noise"],
    separated_by: "the suspected source beside PV; OP held for some periods",
    noun: "a sinusoid from outside",
    bends: true,
    phrase: |sizes| {
        let (period, amplitude) = (sizes.said("period")?, sizes.said("amplitude")?);
        Some(format!("a sinusoid from outside, period {period} s and amplitude {amplitude} PV units"))
    },
    in_loop: |stated, parts| {
        let (amplitude, period_s) = (stated.number("amplitude")?, stated.above_zero("period")?);
        parts.on_pv.push(Disturbance::Sine { amplitude, period_s, phase_deg: 0.0 });
        Ok(())
    },
    ..Effect::simulated("sinusoid", Stage::Disturbance)
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
        (EFFECT.apply)(&[0.2], &mut plan);
        assert!(plan.omega == Some(0.2) && plan.extras() == 2);
    }
}
