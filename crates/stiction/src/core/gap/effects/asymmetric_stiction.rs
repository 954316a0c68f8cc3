//! Bands that differ with the direction: fs and fd times `1 + alpha` upwards, `1 - alpha` downwards.

use super::effect::{Effect, Param, Reach, Unit, kept};
use crate::core::gap::types::Stage;

/// As the catalogue has it.
pub(crate) const EFFECT: Effect = Effect {
    params: &[Param { name: "alpha", unit: Unit::One, reach: Reach::Jumps, limits: |_| [-0.7, 0.7], trade: kept }],
    apply: |p, plan| plan.stroke.uneven = p[0],
    // Slips are right within a hundredth of the bands only, so that the step between starts is small.
    starts: |_| (-9..=9).map(|k| [0.07 * f64::from(k), 0.0, 0.0]).collect(),
    confused_with: &["slip_overshoot", "static_nonlinearity"],
    separated_by: "the valve position, or OP stepped up and down by the same amount",
    noun: "uneven friction",
    needs_friction: true,
    phrase: |sizes| {
        let alpha = sizes.value("alpha")?;
        let side = if alpha > 0.0 { "upwards" } else { "downwards" };
        Some(format!("friction that is {} larger {side} than its mean", sizes.percent(alpha)))
    },
    in_loop: |stated, parts| {
        parts.stroke.uneven = stated.number("alpha")?;
        Ok(())
    },
    ..Effect::simulated("asymmetric_stiction", Stage::Valve)
};

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::gap::plan::Plan;
    use crate::core::sim::slips::Law;

    #[test]
    fn alpha_makes_the_bands_uneven_and_zero_is_the_base() {
        let mut plan = Plan::base(Some(Law::He));
        (EFFECT.apply)(&[0.3], &mut plan);
        assert_eq!(plan.stroke.uneven, 0.3);
        (EFFECT.apply)(&[0.0], &mut plan);
        assert_eq!(plan, Plan::base(Some(Law::He)));
    }
}
