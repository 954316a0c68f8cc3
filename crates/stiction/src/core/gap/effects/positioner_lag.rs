//! A lag before the friction: positioner or current-to-pressure converter. It moves the slips, and not only what follows them.

use super::effect::{Effect, Reach, lag, lags};
use crate::core::gap::types::Stage;

/// As the catalogue has it.
pub(crate) const EFFECT: Effect = Effect {
    params: &[lag::<40>(Reach::Path)],
    apply: |p, plan| plan.actuator.lag = libm::exp(p[0]),
    starts: |clues| lags(clues, &[0.003, 0.01, 0.02, 0.035, 0.05, 0.08, 0.11, 0.17, 0.25]),
    confused_with: &["extra_lag", "rate_limit"],
    separated_by: "the pressure on the actuator, or the valve position",
    noun: "a slow positioner",
    phrase: |sizes| Some(format!("a positioner lag of {} s", sizes.said("lag")?)),
    in_loop: |stated, parts| {
        parts.actuator.lag = stated.above_zero("lag")? / stated.ts_s;
        Ok(())
    },
    ..Effect::simulated("positioner_lag", Stage::Valve)
};

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::gap::plan::Plan;
    use crate::core::sim::slips::Law;

    #[test]
    fn the_lag_is_a_logarithm() {
        let mut plan = Plan::base(Some(Law::He));
        (EFFECT.apply)(&[libm::log(4.0)], &mut plan);
        assert!((plan.actuator.lag - 4.0).abs() < 1e-12 && plan.is_linear_in_fd());
    }
}
