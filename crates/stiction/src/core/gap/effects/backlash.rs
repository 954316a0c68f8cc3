//! Play between stem and plug or in the linkage: what follows stands still until the stem has crossed it.

use super::effect::{Effect, Param, Reach, Unit};
use crate::core::gap::candidate::Parameters;
use crate::core::gap::types::Stage;

/// As the catalogue has it.
pub(crate) const EFFECT: Effect = Effect {
    params: &[Param { name: "width", unit: Unit::Op, reach: Reach::Stem, limits: |_| [0.0, 0.8], trade: for_band }],
    apply: |p, plan| plan.actuator.play = p[0].max(0.0),
    starts: |_| [0.02, 0.04, 0.07, 0.12, 0.2, 0.3, 0.42, 0.55, 0.7].map(|w| [w, 0.0, 0.0]).to_vec(),
    confused_with: &["extra_lag", "static_nonlinearity"],
    separated_by: "positions on both sides of the linkage, or small steps of OP both ways",
    noun: "backlash",
    behind_stem: true,
    phrase: |sizes| Some(format!("backlash of {} OP units behind the stem", sizes.said("width")?)),
    in_loop: |stated, parts| {
        parts.actuator.play = stated.number("width")?.max(0.0);
        Ok(())
    },
    ..Effect::simulated("backlash", Stage::Valve)
};

/// Play looks like dead band: bands and fd give way.
fn for_band(theta: &mut Parameters, _at: usize, by: f64, _op_rate: f64) {
    theta.s -= by;
    theta.fd -= 0.5 * by;
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::gap::plan::Plan;
    use crate::core::sim::slips::Law;

    #[test]
    fn width_is_play_behind_the_stem_and_zero_is_the_base() {
        let mut plan = Plan::base(Some(Law::He));
        (EFFECT.apply)(&[0.3], &mut plan);
        assert!(plan.actuator.play == 0.3 && !plan.is_linear_in_fd());
        (EFFECT.apply)(&[0.0], &mut plan);
        assert_eq!(plan, Plan::base(Some(Law::He)));
    }
}
