//! A valve that sticks, against the base that follows OP.

use super::{Effect, MARGIN, Stage, Way, nothing, once};
use crate::sim::slips::Law;

/// As the catalogue has it.
pub const EFFECT: Effect = Effect {
    id: "stiction",
    stage: Stage::Valve,
    way: Way::AgainstLinear,
    params: &[],
    enter: |_, plan| plan.law = Some(Law::He),
    starts: once,
    linear: nothing,
    margin: MARGIN,
    predictable: true,
    confused_with: &["backlash", "sliding_valve"],
    separated_by: "the valve position",
};

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gap::structure::Plan;

    #[test]
    fn friction_is_added_to_a_valve_without() {
        let mut plan = Plan::base(None);
        (EFFECT.enter)(&[], &mut plan);
        assert_eq!(plan, Plan::base(Some(Law::He)));
    }
}
