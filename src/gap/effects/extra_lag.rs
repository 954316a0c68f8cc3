//! A second lag behind the friction: in the process, or in the sensor and its filter. OP and PV cannot tell which.

use super::{Clues, Effect, MARGIN, Param, Reach, Stage, Unit, Way, nothing};

/// As the catalogue has it.
pub const EFFECT: Effect = Effect {
    id: "extra_lag",
    stage: Stage::Process,
    way: Way::Simulated,
    params: &[Param {
        name: "lag",
        unit: Unit::LogTime,
        reach: Reach::Process,
        limits: |s| [libm::log(0.3 / s.box_samples), libm::log(60.0 / s.box_samples)],
    }],
    enter: |p, plan| plan.tau2 = libm::exp(p[0]),
    starts,
    linear: nothing,
    margin: MARGIN,
    predictable: true,
    confused_with: &["positioner_lag", "inverse_response"],
    separated_by: "a second sensor, or the filter setting of the transmitter",
};

fn starts(clues: &Clues<'_>) -> Vec<[f64; 2]> {
    [0.01, 0.04, 0.12, 0.3].map(|t| [libm::log(t * clues.scene.period), 0.0]).to_vec()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gap::plan::Plan;
    use crate::sim::slips::Law;

    #[test]
    fn the_lag_is_a_logarithm() {
        let mut plan = Plan::base(Some(Law::He));
        (EFFECT.enter)(&[libm::log(4.0)], &mut plan);
        assert!((plan.tau2 - 4.0).abs() < 1e-12 && plan.is_linear_in_fd() && plan.extras() == 0);
    }
}
