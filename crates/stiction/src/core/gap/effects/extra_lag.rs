//! A second lag behind the friction: in the process, or in the sensor before its noise comes in. OP and PV cannot tell which.

use super::effect::{Effect, Reach, lag, lags, said_already};
use crate::core::gap::types::Stage;

/// As the catalogue has it.
pub(crate) const EFFECT: Effect = Effect {
    params: &[lag::<60>(Reach::SecondLag)],
    apply: |p, plan| plan.tau2 = libm::exp(p[0]),
    starts: |clues| lags(clues, &[0.01, 0.04, 0.12, 0.3]),
    confused_with: &["positioner_lag", "inverse_response"],
    separated_by: "a second sensor",
    noun: "a lag behind the valve",
    bare: true,
    clashes: &["inverse_response"],
    twin: Some("a slow sensor"),
    phrase: |sizes| Some(format!("an extra lag of {} s", sizes.said("lag")?)),
    in_loop: said_already,
    ..Effect::simulated("extra_lag", Stage::Process)
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
        assert!((plan.tau2 - 4.0).abs() < 1e-12 && plan.is_linear_in_fd() && plan.extras() == 0);
    }
}
