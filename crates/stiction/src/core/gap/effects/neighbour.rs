//! Another loop's PV or OP that acts on PV through a first-order lag and a dead time.

use super::effect::{Effect, Param, Reach, Unit, WIDE_MARGIN, kept};
use crate::core::gap::candidate::{Candidate, Parameters};
use crate::core::gap::plan::{Part, Plan};
use crate::core::gap::problem::Problem;
use crate::core::gap::types::{Parameter, Stage};

/// Longest lag and longest dead time, periods: beyond half a period a cycle looks the same upside down.
pub(crate) const LONGEST: f64 = 0.5;

/// As the catalogue has it.
pub(crate) const EFFECT: Effect = Effect {
    way: super::effect::Way::Neighbour,
    params: &[
        Param {
            name: "lag",
            unit: Unit::LogTime,
            reach: Reach::Process,
            limits: |p| [libm::log(shortest(p)), libm::log(LONGEST * p.period)],
            trade: for_own_dead_time,
        },
        Param {
            name: "dead_time",
            unit: Unit::Time,
            reach: Reach::Process,
            limits: |p| [1.0 / p.box_samples, LONGEST * p.period],
            trade: kept,
        },
    ],
    apply: |p, plan| plan.neighbour = Some([libm::exp(p[0]), p[1]]),
    linear: sizes,
    margin: WIDE_MARGIN,
    confused_with: &["sinusoid"],
    separated_by: "the neighbour in manual for some periods",
    noun: "another loop's load",
    phrase: |sizes| {
        let (lag, dead_time) = (sizes.said("lag")?, sizes.said("dead_time")?);
        let signal = if sizes.value("from_op")? > 0.5 { "OP" } else { "PV" };
        Some(format!("the neighbour's {signal} behind a lag of {lag} s and a dead time of {dead_time} s"))
    },
    ..Effect::simulated("neighbour", Stage::Disturbance)
};

/// The id of the load of a loop of this name.
#[must_use]
pub fn id_of(name: &str) -> String {
    EFFECT.id_of(name)
}

/// Shortest lag, points: a third of a raw sample.
fn shortest(problem: &Problem) -> f64 {
    0.3 / problem.box_samples
}

/// For the lag by its logarithm: the dead time beside it gives way.
fn for_own_dead_time(theta: &mut Parameters, at: usize, by: f64, _op_rate: f64) {
    let longer = libm::exp(theta.p[at]) - libm::exp(theta.p[at] - by);
    if let Some(dead_time) = theta.p.get_mut(at + 1) {
        *dead_time -= longer;
    }
}

/// Its gain, which signal it is, and how rarely a shifted neighbour explains as much.
fn sizes(_p: &[f64], plan: &Plan, of: &Candidate, problem: &Problem) -> Vec<Parameter> {
    let Some(load) = &problem.neighbour else { return Vec::new() };
    let gain = of.linear.others[plan.column(Part::Neighbour)] * problem.normalised.deviation / load.deviation;
    vec![
        Parameter { name: "gain", value: gain, unit: if load.from_op { "PV/OP" } else { "PV/PV" } },
        Parameter { name: "from_op", value: if load.from_op { 1.0 } else { 0.0 }, unit: "1" },
        Parameter { name: "p_value", value: load.p_value, unit: "1" },
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::sim::slips::Law;

    #[test]
    fn one_coefficient_is_its_gain() {
        let mut plan = Plan::base(Some(Law::He));
        (EFFECT.apply)(&[libm::log(5.0), 3.0], &mut plan);
        let [lag, delay] = plan.neighbour.unwrap();
        assert!((lag - 5.0).abs() < 1e-9 && delay == 3.0 && plan.extras() == 1);
        plan.step = Some((9.0, true));
        assert_eq!(plan.column(Part::Neighbour), plan.column(Part::Step) + 1);
    }
}
