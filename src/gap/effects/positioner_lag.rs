//! A lag before the friction: positioner or current-to-pressure converter. It moves the slips, and not only what follows them.

use super::{Effect, MARGIN, Reach, Stage, Way, lag, lags, nothing};

/// As the catalogue has it.
pub const EFFECT: Effect = Effect {
    id: "positioner_lag",
    stage: Stage::Valve,
    way: Way::Simulated,
    params: &[lag::<40>(Reach::Path)],
    enter: |p, plan| plan.positioner = libm::exp(p[0]),
    starts: |clues| lags(clues, &[0.015, 0.04, 0.1, 0.25]),
    linear: nothing,
    margin: MARGIN,
    predictable: true,
    confused_with: &["extra_lag", "rate_limit"],
    separated_by: "the pressure on the actuator, or the valve position",
};

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gap::structure::Plan;
    use crate::sim::slips::Law;

    #[test]
    fn the_lag_is_a_logarithm() {
        let mut plan = Plan::base(Some(Law::He));
        (EFFECT.enter)(&[libm::log(4.0)], &mut plan);
        assert!((plan.positioner - 4.0).abs() < 1e-12 && plan.is_linear_in_fd());
    }
}
