//! A gain that grows or falls with time: by the same amount in every hour (fouling), or by the same share (wear, decay).

use super::effect::{Effect, Param, Reach, Unit, WIDE_MARGIN, grows, kept};
use crate::core::gap::plan::Drift;
use crate::core::gap::types::Stage;

/// Change of the gain below which what was fitted is its level alone.
const LEAST_CHANGE: f64 = 0.1;

/// As the catalogue has it.
pub(crate) const EFFECT: Effect = Effect {
    params: &[
        Param {
            name: "gain_change_over_record",
            unit: Unit::One,
            reach: Reach::Process,
            limits: |_| [-1.9, 1.9],
            trade: kept,
        },
        Param { name: "by_factor", unit: Unit::Choice, reach: Reach::Jumps, limits: |_| [0.0, 1.0], trade: kept },
    ],
    apply: |p, plan| plan.drift = Some(Drift { change: p[0], by_factor: p[1] > 0.5 }),
    starts: |_| [-0.4, 0.4].into_iter().flat_map(|c| [[c, 0.0, 0.0], [c, 1.0, 0.0]]).collect(),
    // Its level is free, so it imitates a ramp: it must not be preferred to one, and a gain that hardly changed is none.
    is_meant: |plan, _| plan.drift.is_some_and(|drift| drift.change.abs() >= LEAST_CHANGE),
    margin: WIDE_MARGIN,
    confused_with: &["static_nonlinearity", "dead_time_change"],
    separated_by: "the same step of OP early and late",
    noun: "a drifting gain",
    phrase: |sizes| {
        let change = sizes.value("gain_change_over_record")?;
        Some(format!("a gain that {} by {} over the record", grows(change), sizes.percent(change)))
    },
    ..Effect::simulated("gain_drift", Stage::Process)
};

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::gap::plan::Plan;
    use crate::core::sim::slips::Law;

    #[test]
    fn the_gain_changes_by_so_much_of_its_middle_either_way() {
        for by_factor in [0.0, 1.0] {
            let mut plan = Plan::base(Some(Law::He));
            (EFFECT.apply)(&[0.6, by_factor], &mut plan);
            let drift = plan.drift.unwrap();
            let gain: Vec<f64> = drift.course(1000).map(|x| 1.0 + drift.change * x).collect();
            assert!((gain[999] - gain[0] - 0.6).abs() < 2e-3 && (gain[500] - 1.0).abs() < 2e-3);
            let [first, second] = [gain[500] / gain[100], gain[900] / gain[500]];
            assert_eq!((first - second).abs() < 1e-6, by_factor > 0.5);
            assert!(plan.extras() == 1 && plan.is_linear_in_fd());
        }
    }
}
