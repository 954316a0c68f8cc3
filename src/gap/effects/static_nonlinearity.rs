//! A gain that goes with the level: the valve's characteristic, or the process' own. OP and PV cannot tell which.

use super::{Effect, MARGIN, Stage, Way, once};
use crate::gap::kernel::Linear;
use crate::gap::scene::Scene;
use crate::gap::types::Parameter;

/// As the catalogue has it.
pub const EFFECT: Effect = Effect {
    id: "static_nonlinearity",
    stage: Stage::Process,
    way: Way::Simulated,
    params: &[],
    enter: |_, plan| plan.curved = true,
    starts: once,
    linear: curvature,
    margin: MARGIN,
    predictable: true,
    confused_with: &["travel_limit", "gain_drift", "asymmetric_stiction"],
    separated_by: "the flow, or steps of OP at two levels",
};

/// Change of the gain over a span of OP, over the gain.
fn curvature(linear: &Linear, _scene: &Scene) -> Vec<Parameter> {
    let at = linear.count.saturating_sub(1);
    vec![Parameter { name: "gain_change_over_span", value: 2.0 * linear.others[at] / linear.gain, unit: "1" }]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gap::plan::Plan;
    use crate::sim::slips::Law;

    #[test]
    fn a_square_is_added_with_a_coefficient_of_its_own() {
        let mut plan = Plan::base(Some(Law::He));
        (EFFECT.enter)(&[], &mut plan);
        assert!(plan.curved && plan.extras() == 1);
    }
}
