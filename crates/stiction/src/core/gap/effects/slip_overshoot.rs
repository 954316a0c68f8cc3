//! A stem that jumps beyond OP when it breaks away: fd below zero, so j above s. A heavy one carries on by a share of
//! what OP was ahead of the threshold.

use super::effect::{Effect, Param, Reach, Unit};
use crate::core::gap::candidate::Parameters;
use crate::core::gap::types::Stage;

/// As the catalogue has it.
pub(crate) const EFFECT: Effect = Effect {
    params: &[Param {
        name: "carried",
        unit: Unit::One,
        reach: Reach::Path,
        limits: |_| [0.0, 1.0],
        trade: for_threshold,
    }],
    apply: |p, plan| {
        plan.overshoot = true;
        plan.stroke.carried = p[0];
    },
    starts: |_| (0..10).map(|k| [0.1 * f64::from(k), 0.0, 0.0]).collect(),
    confused_with: &["sliding_valve", "static_nonlinearity", "asymmetric_stiction"],
    separated_by: "the valve position during one slow ramp of OP",
    noun: "a stem that jumps past its mark",
    bare: true,
    needs_friction: true,
    clashes: &["sliding_valve"],
    in_loop: |stated, parts| {
        parts.stroke.carried = stated.or_zero("carried");
        Ok(())
    },
    ..Effect::simulated("slip_overshoot", Stage::Valve)
};

/// OP is ahead by half of what it moves between two points when a slip comes.
fn for_threshold(theta: &mut Parameters, _at: usize, by: f64, op_rate: f64) {
    theta.s -= 0.5 * op_rate * by;
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::gap::plan::Plan;
    use crate::core::sim::slips::Law;

    #[test]
    fn only_fd_may_turn_negative() {
        let mut plan = Plan::base(Some(Law::He));
        (EFFECT.apply)(&[0.3], &mut plan);
        assert!(plan.overshoot && plan.is_linear_in_fd());
    }
}
