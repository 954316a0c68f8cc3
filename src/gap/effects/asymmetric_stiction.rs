//! Bands that differ with the direction: fs and fd times `1 + alpha` upwards, `1 - alpha` downwards.

use super::{Effect, MARGIN, Param, Reach, Stage, Unit, Way, nothing};

/// As the catalogue has it.
pub const EFFECT: Effect = Effect {
    id: "asymmetric_stiction",
    stage: Stage::Valve,
    way: Way::Simulated,
    params: &[Param { name: "alpha", unit: Unit::One, reach: Reach::Jumps, limits: |_| [-0.7, 0.7] }],
    enter: |p, plan| plan.stroke.uneven = p[0],
    starts: |_| [0.1, 0.2, 0.3, 0.4, 0.5, 0.6].into_iter().flat_map(|a| [[a, 0.0, 0.0], [-a, 0.0, 0.0]]).collect(),
    linear: nothing,
    margin: MARGIN,
    predictable: true,
    confused_with: &["slip_overshoot", "static_nonlinearity"],
    separated_by: "the valve position, or OP stepped up and down by the same amount",
};

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gap::structure::Plan;
    use crate::sim::slips::Law;

    #[test]
    fn alpha_makes_the_bands_uneven_and_zero_is_the_base() {
        let mut plan = Plan::base(Some(Law::He));
        (EFFECT.enter)(&[0.3], &mut plan);
        assert_eq!(plan.stroke.uneven, 0.3);
        (EFFECT.enter)(&[0.0], &mut plan);
        assert_eq!(plan, Plan::base(Some(Law::He)));
    }
}
