//! A stem that jumps beyond OP when it breaks away: fd below zero, so j above s.

use super::{Effect, MARGIN, Stage, Way, nothing, once};

/// As the catalogue has it.
pub const EFFECT: Effect = Effect {
    id: "slip_overshoot",
    stage: Stage::Valve,
    way: Way::Simulated,
    params: &[],
    enter: |_, plan| plan.overshoot = true,
    starts: once,
    linear: nothing,
    margin: MARGIN,
    predictable: true,
    confused_with: &["sliding_valve", "static_nonlinearity", "asymmetric_stiction"],
    separated_by: "the valve position during one slow ramp of OP",
};

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gap::plan::Plan;
    use crate::sim::slips::Law;

    #[test]
    fn only_fd_may_turn_negative() {
        let mut plan = Plan::base(Some(Law::He));
        (EFFECT.enter)(&[], &mut plan);
        assert!(plan.overshoot && plan.is_linear_in_fd());
    }
}
