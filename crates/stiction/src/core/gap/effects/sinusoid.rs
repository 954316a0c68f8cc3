//! A sinusoid from outside, at a period of its own.

use core::f64::consts::{PI, TAU};

use super::clues::Clues;
use super::effect::{Effect, Param, Reach, Rest, Start, Unit, WIDE_MARGIN, kept};
use crate::core::gap::candidate::Candidate;
use crate::core::gap::plan::{Part, Plan};
use crate::core::gap::problem::Problem;
use crate::core::gap::types::{Parameter, Stage};
use crate::core::sim::disturbance::Disturbance;

/// Overtones that are asked: a limit cycle has odd ones above all (Gelb and Vander Velde 1968), a load that comes and goes
/// even ones, too.
const OVERTONES: [f64; 2] = [2.0, 3.0];
/// Multiples of the frequency between these, where neither it nor they have anything: what stands there is left of others.
const BETWEEN: [f64; 6] = [1.37, 1.61, 2.41, 2.71, 3.37, 3.61];
/// Power of an overtone, that of white noise at the floor being 1, from which it is there: noise has as much once in
/// exp(15), three million times.
const IS_THERE: f64 = 15.0;
/// The same over the most that stands between: wrong slips leave something of every frequency.
const STANDS_OUT: f64 = 3.0;

/// As the catalogue has it.
pub(crate) const EFFECT: Effect = Effect {
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
    leaves_noise: |plan, rest| plan.omega.is_none_or(|omega| !has_overtone(omega, rest)),
    margin: WIDE_MARGIN,
    confused_with: &["coloured_noise"],
    separated_by: "the suspected source beside PV; OP held for some periods",
    noun: "an external sinusoid",
    bends: true,
    phrase: |sizes| {
        let (period, amplitude) = (sizes.said("period")?, sizes.said("amplitude")?);
        Some(format!("an external sinusoid, period {period} s and amplitude {amplitude} PV units"))
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

/// Whether what a sinusoid leaves has overtones of it: then the source is a cycle that is none.
fn has_overtone(omega: f64, rest: &Rest) -> bool {
    let most = |of: &[f64]| {
        let below_nyquist = of.iter().map(|times| times * omega).filter(|w| *w < PI);
        below_nyquist.map(|w| rest.power_at(w)).fold(0.0, f64::max)
    };
    let overtone = most(&OVERTONES);
    overtone > IS_THERE && overtone > STANDS_OUT * most(&BETWEEN)
}

/// Half of the way from trough to crest.
fn amplitude(_p: &[f64], plan: &Plan, of: &Candidate, problem: &Problem) -> Vec<Parameter> {
    let at = plan.column(Part::Waves);
    let [a, b] = [of.linear.others[at], of.linear.others[at + 1]];
    vec![Parameter { name: "amplitude", value: (a * a + b * b).sqrt() * problem.normalised.deviation, unit: "PV" }]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::sim::slips::Law;

    #[test]
    fn two_coefficients_are_its_amplitude_and_phase() {
        let mut plan = Plan::base(Some(Law::He));
        (EFFECT.apply)(&[0.2], &mut plan);
        assert!(plan.omega == Some(0.2) && plan.extras() == 2);
    }

    #[test]
    fn a_cycle_that_is_no_sinusoid_leaves_overtones_of_it() {
        use crate::core::sim::noise::Noise;
        let mut noise = Noise::new(5, 0);
        let mut rest = |left: fn(f64) -> f64| Rest {
            points: (0..900).map(|k| (f64::from(k), noise.gaussian() + left(0.1 * f64::from(k)))).collect(),
        };
        assert!(!has_overtone(0.1, &rest(|_| 0.0)), "noise alone");
        assert!(has_overtone(0.1, &rest(|at| 0.5 * libm::sin(3.0 * at + 1.0))), "a third of a square wave");
        assert!(!has_overtone(0.1, &rest(|at| 0.5 * libm::sin(2.4 * at))), "another's");
        assert!(!has_overtone(1.7, &rest(|at| libm::sin(51.0 * at))), "none below half of the sampling rate");
    }
}
