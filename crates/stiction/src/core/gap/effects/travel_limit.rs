//! A stop, low or high, that the stem meets inside the range of OP, or an end of what flows behind a free stem.

use super::clues::Clues;
use super::effect::{Effect, Param, Reach, Start, Unit, kept};
use crate::core::gap::candidate::Candidate;
use crate::core::gap::plan::Plan;
use crate::core::gap::problem::Problem;
use crate::core::gap::types::{Parameter, Stage};

/// As the catalogue has it.
pub(crate) const EFFECT: Effect = Effect {
    params: &[
        Param { name: "stop", unit: Unit::StemEnd, reach: Reach::Path, limits: |_| [-2.0, 2.0], trade: kept },
        Param { name: "upper", unit: Unit::Choice, reach: Reach::Jumps, limits: |_| [0.0, 1.0], trade: kept },
        Param { name: "of_stem", unit: Unit::Choice, reach: Reach::Jumps, limits: |_| [0.0, 1.0], trade: kept },
    ],
    apply: |p, plan| {
        let ends = if p[2] > 0.5 { &mut plan.stroke.ends } else { &mut plan.actuator.stops };
        ends[usize::from(p[1] > 0.5)] = p[0];
    },
    starts,
    linear: stop,
    confused_with: &["static_nonlinearity", "clipping"],
    separated_by: "the valve position, or OP moved slowly to the suspected stop and back",
    noun: "a stop of the stem",
    behind_stem: true,
    from_model: |p, theta| p[0] += above_stop(p, theta.fd),
    phrase: |sizes| {
        let what = if sizes.value("of_stem") == Some(0.0) { "an end of the flow" } else { "a stop of the stem" };
        Some(format!("{what} at OP {}", sizes.said("stop")?))
    },
    in_loop: |stated, parts| {
        let stop = stated.number("stop")?;
        let ends = if stated.is("of_stem") { &mut parts.stroke.ends } else { &mut parts.actuator.stops };
        let above = above_stop(&[stop, stated.or_zero("upper"), stated.or_zero("of_stem")], stated.model.valve.fd);
        ends[usize::from(stated.is("upper"))] = stop + above;
        if ends[0] > ends[1] { Err(stated.wrong("stop", " that leaves the stem room")) } else { Ok(()) }
    },
    ..Effect::simulated("travel_limit", Stage::Valve)
};

fn starts(clues: &Clues<'_>) -> Vec<Start> {
    let [low, high] = clues.stem;
    let at = |share: f64| low + share * (high - low);
    let places = [(at(0.12), 0.0), (at(0.35), 0.0), (at(0.88), 1.0), (at(0.65), 1.0)];
    places.into_iter().flat_map(|(stop, upper)| [[stop, upper, 0.0], [stop, upper, 1.0]]).collect()
}

/// What an end of the stem stands above its stop: the first parameter is the OP value of a slip that ends there.
#[must_use]
fn above_stop(p: &[f64], fd: f64) -> f64 {
    match p {
        [_, upper, of_stem, ..] if *of_stem > 0.5 => {
            if *upper > 0.5 {
                fd
            } else {
                -fd
            }
        }
        _ => 0.0,
    }
}

fn stop(p: &[f64], _plan: &Plan, of: &Candidate, problem: &Problem) -> Vec<Parameter> {
    let place = p[0] - above_stop(p, of.theta.fd);
    vec![Parameter { name: "stop", value: problem.op_of(place), unit: "OP" }]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::sim::slips::Law;

    #[test]
    fn either_end_can_be_the_stop_of_stem_or_flow_and_far_away_it_is_none() {
        let mut plan = Plan::base(Some(Law::He));
        (EFFECT.apply)(&[0.3, 1.0, 0.0], &mut plan);
        assert_eq!(plan.actuator.stops, [f64::NEG_INFINITY, 0.3]);
        (EFFECT.apply)(&[-0.3, 0.0, 0.0], &mut plan);
        assert_eq!(plan.actuator.stops, [-0.3, 0.3]);
        let mut plan = Plan::base(Some(Law::He));
        (EFFECT.apply)(&[0.3, 1.0, 1.0], &mut plan);
        assert!(plan.stroke.ends == [f64::NEG_INFINITY, 0.3] && plan.is_linear_in_fd());
        assert_eq!([above_stop(&[0.3, 1.0, 1.0], 0.1), above_stop(&[0.3, 0.0, 1.0], 0.1)], [0.1, -0.1]);
        assert_eq!(above_stop(&[0.3, 1.0, 0.0], 0.1), 0.0);
    }
}
