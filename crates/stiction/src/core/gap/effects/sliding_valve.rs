//! A valve that slides once it has broken away, until OP turns (Kano 2004, Choudhury 2005) or it gets slow, with a drag,
//! instead of sticking again at each scan.

use super::effect::{Effect, Param, Reach, Unit, for_dead_time, kept};
use crate::core::gap::problem::Problem;
use crate::core::gap::types::Stage;
use crate::core::sim::slips::Law;

/// Drag of none to speak of, and the most, raw samples.
const LEAST_DRAG: f64 = 0.02;
const MOST_DRAG: f64 = 5.0;
/// Speed at which it sticks again, spans a point.
const SLOWEST: [f64; 2] = [1e-6, 0.1];

fn drag(problem: &Problem) -> [f64; 2] {
    [LEAST_DRAG, MOST_DRAG].map(|samples| libm::log(samples / problem.box_samples))
}

/// As the catalogue has it.
pub(crate) const EFFECT: Effect = Effect {
    params: &[
        Param { name: "drag", unit: Unit::LogTime, reach: Reach::Path, limits: drag, trade: for_dead_time },
        Param {
            name: "slowest",
            unit: Unit::LogRate,
            reach: Reach::Path,
            limits: |_| SLOWEST.map(libm::log),
            trade: kept,
        },
    ],
    apply: |p, plan| {
        plan.law = Some(Law::Tracking);
        (plan.stroke.drag, plan.stroke.slowest) = (libm::exp(p[0]), libm::exp(p[1]));
    },
    starts: |clues| {
        let at = |samples: f64| libm::log(samples / clues.problem.box_samples);
        let slow = libm::log(SLOWEST[0]);
        vec![[at(LEAST_DRAG), slow, 0.0], [at(0.4), slow, 0.0]]
    },
    confused_with: &["extra_lag", "slip_overshoot"],
    separated_by: "the valve position during one slow ramp of OP",
    noun: "a stem that slides on after a slip",
    bare: true,
    needs_friction: true,
    clashes: &["slip_overshoot"],
    in_loop: |stated, parts| {
        parts.stroke.drag = stated.or_zero("drag").max(0.0) / stated.ts_s;
        parts.stroke.slowest = stated.or_zero("slowest").max(0.0) * stated.ts_s;
        Ok(())
    },
    ..Effect::simulated("sliding_valve", Stage::Valve)
};

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::gap::plan::Plan;

    #[test]
    fn the_law_is_switched_and_the_stem_dragged() {
        let mut plan = Plan::base(Some(Law::He));
        (EFFECT.apply)(&[libm::log(0.3), libm::log(0.01)], &mut plan);
        assert!((plan.stroke.drag - 0.3).abs() < 1e-12 && (plan.stroke.slowest - 0.01).abs() < 1e-12);
        (plan.stroke.drag, plan.stroke.slowest) = (0.0, 0.0);
        assert_eq!(plan, Plan::base(Some(Law::Tracking)));
    }
}
