//! A valve that sticks, against the base that follows OP.

use super::effect::{Effect, Way, said_already};
use crate::core::gap::types::Stage;
use crate::core::sim::slips::Law;

/// As the catalogue has it.
pub(crate) const EFFECT: Effect = Effect {
    way: Way::AgainstLinear,
    apply: |_, plan| plan.law = Some(Law::He),
    confused_with: &["backlash", "sliding_valve"],
    separated_by: "the valve position",
    noun: "stiction",
    in_loop: said_already,
    ..Effect::simulated("stiction", Stage::Valve)
};

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::gap::plan::Plan;

    #[test]
    fn friction_is_added_to_a_valve_without() {
        let mut plan = Plan::base(None);
        (EFFECT.apply)(&[], &mut plan);
        assert_eq!(plan, Plan::base(Some(Law::He)));
    }
}
