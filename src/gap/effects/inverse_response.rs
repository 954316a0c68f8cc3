//! PV first goes the wrong way: a zero in the right half plane beside a second lag.

use super::{Clues, Effect, Param, Reach, Stage, Unit, WIDE_MARGIN, Way, nothing};

/// As the catalogue has it.
pub const EFFECT: Effect = Effect {
    id: "inverse_response",
    stage: Stage::Process,
    way: Way::Simulated,
    params: &[Param {
        name: "lag",
        unit: Unit::LogTime,
        reach: Reach::Process,
        limits: |s| [libm::log(0.3 / s.box_samples), libm::log(60.0 / s.box_samples)],
    }],
    enter: |p, plan| {
        plan.tau2 = libm::exp(p[0]);
        plan.zero = true;
    },
    starts,
    linear: nothing,
    margin: WIDE_MARGIN,
    predictable: true,
    confused_with: &["extra_lag"],
    separated_by: "one open-loop step of OP",
};

fn starts(clues: &Clues<'_>) -> Vec<[f64; 2]> {
    [0.01, 0.05, 0.2].map(|t| [libm::log(t * clues.scene.period), 0.0]).to_vec()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gap::plan::Plan;
    use crate::sim::slips::Law;

    #[test]
    fn the_second_lag_has_a_share_of_its_own() {
        let mut plan = Plan::base(Some(Law::He));
        (EFFECT.enter)(&[0.0], &mut plan);
        assert!(plan.tau2 == 1.0 && plan.zero && plan.extras() == 1);
    }
}
