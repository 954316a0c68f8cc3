//! PV first goes the wrong way: a zero in the right half plane beside a second lag.

use super::effect::{Effect, Reach, WIDE_MARGIN, lag, lags};
use crate::gap::types::Stage;

/// As the catalogue has it.
pub const EFFECT: Effect = Effect {
    params: &[lag::<60>(Reach::SecondLag)],
    apply: |p, plan| {
        plan.tau2 = libm::exp(p[0]);
        plan.zero = true;
    },
    starts: |clues| lags(clues, &[0.01, 0.05, 0.2]),
    margin: WIDE_MARGIN,
    confused_with: &["extra_lag"],
    separated_by: "one open-loop step of OP",
    noun: "an inverse response",
    bends: true,
    clashes: &["extra_lag"],
    phrase: |sizes| Some(format!("an inverse response with a lag of {} s", sizes.said("lag")?)),
    ..Effect::simulated("inverse_response", Stage::Process)
};

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gap::plan::Plan;
    use crate::sim::slips::Law;

    #[test]
    fn the_second_lag_has_a_share_of_its_own() {
        let mut plan = Plan::base(Some(Law::He));
        (EFFECT.apply)(&[0.0], &mut plan);
        assert!(plan.tau2 == 1.0 && plan.zero && plan.extras() == 1);
    }
}
