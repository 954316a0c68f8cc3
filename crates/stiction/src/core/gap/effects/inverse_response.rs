//! PV first goes the wrong way: a zero in the right half plane beside a second lag.

use super::effect::{Effect, Reach, WIDE_MARGIN, lag, lags};
use crate::core::gap::types::Stage;

/// As the catalogue has it.
pub(crate) const EFFECT: Effect = Effect {
    params: &[lag::<60>(Reach::SecondLag)],
    apply: |p, plan| {
        plan.tau2 = libm::exp(p[0]);
        plan.zero = true;
    },
    starts: |clues| lags(clues, &[0.01, 0.05, 0.2]),
    is_meant: |plan, of| {
        let second = of.linear.others[of.linear.count - 1];
        turns_back(plan.time_constants(of.theta.log_tau), [of.linear.gain, second])
    },
    holds: Some(super::extra_lag::EFFECT.id),
    margin: WIDE_MARGIN,
    confused_with: &["extra_lag"],
    separated_by: "one open-loop step of OP",
    noun: "an inverse response",
    bends: true,
    clashes: &["extra_lag", "dead_time_change"],
    phrase: |sizes| Some(format!("an inverse response with a lag of {} s", sizes.said("lag")?)),
    ..Effect::simulated("inverse_response", Stage::Process)
};

/// Lead of the zero that counts as one in the right half plane, as a share of the shorter lag: nearer to none, what was fitted
/// is a second lag.
const LEAST_ZERO: f64 = -0.1;

/// Whether two lags side by side make PV go the wrong way first.
fn turns_back(tau: [f64; 2], gain: [f64; 2]) -> bool {
    let zero = (gain[0] * tau[1] + gain[1] * tau[0]) / (gain[0] + gain[1]);
    zero < LEAST_ZERO * tau[0].min(tau[1])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::gap::plan::Plan;
    use crate::core::sim::slips::Law;

    #[test]
    fn the_second_lag_has_a_share_of_its_own() {
        let mut plan = Plan::base(Some(Law::He));
        (EFFECT.apply)(&[0.0], &mut plan);
        assert!(plan.tau2 == 1.0 && plan.zero && plan.extras() == 1);
    }

    #[test]
    fn pv_goes_the_wrong_way_where_the_quicker_lag_outweighs_the_slower() {
        // Against 1 / 20 a point at first, 0.4 / 5 the other way.
        assert!(turns_back([20.0, 5.0], [1.4, -0.4]));
        // Lags one behind the other: their gains side by side.
        let series = [20.0 / 15.0, -5.0 / 15.0];
        assert!(!turns_back([20.0, 5.0], series) && !turns_back([20.0, 5.0], [0.8, 0.2]));
    }
}
