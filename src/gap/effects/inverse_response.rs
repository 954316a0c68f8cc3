//! PV first goes the wrong way: a zero in the right half plane beside a second lag.

use super::{Effect, Reach, Stage, WIDE_MARGIN, Way, lag, lags, nothing};

/// As the catalogue has it.
pub const EFFECT: Effect = Effect {
    id: "inverse_response",
    stage: Stage::Process,
    way: Way::Simulated,
    params: &[lag::<60>(Reach::SecondLag)],
    enter: |p, plan| {
        plan.tau2 = libm::exp(p[0]);
        plan.zero = true;
    },
    starts: |clues| lags(clues, &[0.01, 0.05, 0.2]),
    linear: nothing,
    margin: WIDE_MARGIN,
    predictable: true,
    confused_with: &["extra_lag"],
    separated_by: "one open-loop step of OP",
};

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gap::structure::Plan;
    use crate::sim::slips::Law;

    #[test]
    fn the_second_lag_has_a_share_of_its_own() {
        let mut plan = Plan::base(Some(Law::He));
        (EFFECT.enter)(&[0.0], &mut plan);
        assert!(plan.tau2 == 1.0 && plan.zero && plan.extras() == 1);
    }
}
