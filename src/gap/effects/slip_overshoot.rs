//! A stem that jumps beyond OP when it breaks away: fd below zero, so j above s. A heavy one carries on by a share of
//! what OP was ahead of the threshold.

use super::{Effect, MARGIN, Param, Reach, Stage, Unit, Way, nothing};

/// As the catalogue has it.
pub const EFFECT: Effect = Effect {
    id: "slip_overshoot",
    stage: Stage::Valve,
    way: Way::Simulated,
    params: &[Param { name: "carried", unit: Unit::One, reach: Reach::Path, limits: |_| [0.0, 1.0] }],
    enter: |p, plan| {
        plan.overshoot = true;
        plan.stroke.carried = p[0];
    },
    starts: |_| vec![[0.0; 3], [0.3, 0.0, 0.0], [0.5, 0.0, 0.0], [0.7, 0.0, 0.0]],
    linear: nothing,
    margin: MARGIN,
    predictable: true,
    confused_with: &["sliding_valve", "static_nonlinearity", "asymmetric_stiction"],
    separated_by: "the valve position during one slow ramp of OP",
};

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gap::structure::Plan;
    use crate::sim::slips::Law;

    #[test]
    fn only_fd_may_turn_negative() {
        let mut plan = Plan::base(Some(Law::He));
        (EFFECT.enter)(&[0.3], &mut plan);
        assert!(plan.overshoot && plan.is_linear_in_fd());
    }
}
