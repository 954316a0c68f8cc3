//! A valve that slides once it has broken away, until OP turns (Kano 2004, Choudhury 2005), instead of sticking again at each scan.

use super::{Effect, MARGIN, Stage, Way, nothing, once};
use crate::sim::slips::Law;

/// As the catalogue has it.
pub const EFFECT: Effect = Effect {
    id: "sliding_valve",
    stage: Stage::Valve,
    way: Way::Simulated,
    params: &[],
    enter: |_, plan| plan.law = Some(Law::Tracking),
    starts: once,
    linear: nothing,
    margin: MARGIN,
    predictable: true,
    confused_with: &["extra_lag", "slip_overshoot"],
    separated_by: "the valve position during one slow ramp of OP",
};

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gap::plan::Plan;

    #[test]
    fn the_law_is_switched() {
        let mut plan = Plan::base(Some(Law::He));
        (EFFECT.enter)(&[], &mut plan);
        assert_eq!(plan, Plan::base(Some(Law::Tracking)));
    }
}
