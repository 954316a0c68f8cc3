//! PV integrates the valve signal instead of settling.

use super::effect::{Effect, said_already};
use crate::core::gap::types::Stage;

/// As the catalogue has it.
pub(crate) const EFFECT: Effect = Effect {
    apply: |_, plan| plan.integrating = true,
    confused_with: &["extra_lag", "ramp"],
    separated_by: "one open-loop step of OP, watched until PV settles or runs away",
    noun: "an integrating process",
    in_loop: said_already,
    ..Effect::simulated("integrating", Stage::Process)
};

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::gap::plan::Plan;
    use crate::core::sim::slips::Law;

    #[test]
    fn the_process_is_switched() {
        let mut plan = Plan::base(Some(Law::He));
        (EFFECT.apply)(&[], &mut plan);
        assert!(plan.integrating && plan.is_linear_in_fd());
    }
}
