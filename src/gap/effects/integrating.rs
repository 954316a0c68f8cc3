//! PV integrates the valve signal instead of settling.

use super::{Effect, MARGIN, Stage, Way, nothing, once};

/// As the catalogue has it.
pub const EFFECT: Effect = Effect {
    id: "integrating",
    stage: Stage::Process,
    way: Way::Simulated,
    params: &[],
    enter: |_, plan| plan.integrating = true,
    starts: once,
    linear: nothing,
    margin: MARGIN,
    predictable: true,
    confused_with: &["extra_lag", "ramp"],
    separated_by: "one open-loop step of OP, watched until PV settles or runs away",
};

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gap::structure::Plan;
    use crate::sim::slips::Law;

    #[test]
    fn the_process_is_switched() {
        let mut plan = Plan::base(Some(Law::He));
        (EFFECT.enter)(&[], &mut plan);
        assert!(plan.integrating && plan.is_linear_in_fd());
    }
}
