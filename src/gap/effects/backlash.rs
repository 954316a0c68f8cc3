//! Play between stem and plug or in the linkage: what follows stands still until the stem has crossed it.

use super::{Effect, MARGIN, Param, Reach, Stage, Unit, Way, nothing};

/// As the catalogue has it.
pub const EFFECT: Effect = Effect {
    id: "backlash",
    stage: Stage::Valve,
    way: Way::Simulated,
    params: &[Param { name: "width", unit: Unit::Op, reach: Reach::Stem, limits: |_| [0.0, 0.8] }],
    enter: |p, plan| plan.play = p[0].max(0.0),
    starts: |_| [0.04, 0.12, 0.3, 0.55].map(|w| [w, 0.0, 0.0]).to_vec(),
    linear: nothing,
    margin: MARGIN,
    predictable: true,
    confused_with: &["extra_lag", "static_nonlinearity"],
    separated_by: "positions on both sides of the linkage, or small steps of OP both ways",
};

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gap::structure::Plan;
    use crate::sim::slips::Law;

    #[test]
    fn width_is_play_behind_the_stem_and_zero_is_the_base() {
        let mut plan = Plan::base(Some(Law::He));
        (EFFECT.enter)(&[0.3], &mut plan);
        assert!(plan.play == 0.3 && !plan.is_linear_in_fd());
        (EFFECT.enter)(&[0.0], &mut plan);
        assert_eq!(plan, Plan::base(Some(Law::He)));
    }
}
