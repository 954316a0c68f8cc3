//! A gain that grows or falls evenly with time.

use super::{Effect, MARGIN, Stage, Way, once};
use crate::gap::kernel::Scored;
use crate::gap::scene::Scene;
use crate::gap::types::Parameter;

/// As the catalogue has it.
pub const EFFECT: Effect = Effect {
    id: "gain_drift",
    stage: Stage::Process,
    way: Way::Simulated,
    params: &[],
    enter: |_, plan| plan.drifts = true,
    starts: once,
    linear: slope,
    margin: MARGIN,
    predictable: true,
    confused_with: &["static_nonlinearity", "dead_time_change"],
    separated_by: "the same step of OP early and late",
};

/// Change of the gain from start to end of the record, over its middle.
fn slope(_p: &[f64], of: &Scored, _scene: &Scene) -> Vec<Parameter> {
    let at = of.linear.count.saturating_sub(1);
    vec![Parameter { name: "gain_change_over_record", value: of.linear.others[at] / of.linear.gain, unit: "1" }]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gap::plan::Plan;
    use crate::sim::slips::Law;

    #[test]
    fn time_times_the_valve_signal_is_added() {
        let mut plan = Plan::base(Some(Law::He));
        (EFFECT.enter)(&[], &mut plan);
        assert!(plan.drifts && plan.extras() == 2);
    }
}
