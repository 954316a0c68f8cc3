//! A stop, low or high, that the stem meets inside the range of OP.

use super::{Clues, Effect, MARGIN, Param, Reach, Stage, Unit, Way, nothing};

/// As the catalogue has it.
pub const EFFECT: Effect = Effect {
    id: "travel_limit",
    stage: Stage::Valve,
    way: Way::Simulated,
    params: &[
        Param { name: "stop", unit: Unit::OpLevel, reach: Reach::Stem, limits: |_| [-2.0, 2.0] },
        Param { name: "upper", unit: Unit::Choice, reach: Reach::Jumps, limits: |_| [0.0, 1.0] },
    ],
    enter: |p, plan| {
        // The second says which end.
        if p[1] < 0.5 { plan.stops[0] = p[0] } else { plan.stops[1] = p[0] }
    },
    starts,
    linear: nothing,
    margin: MARGIN,
    predictable: true,
    confused_with: &["static_nonlinearity", "clipping"],
    separated_by: "the valve position, or OP moved slowly to the suspected stop and back",
};

fn starts(clues: &Clues<'_>) -> Vec<[f64; 2]> {
    let [low, high] = clues.stem;
    let at = |share: f64| low + share * (high - low);
    vec![[at(0.12), 0.0], [at(0.35), 0.0], [at(0.88), 1.0], [at(0.65), 1.0]]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gap::plan::Plan;
    use crate::sim::slips::Law;

    #[test]
    fn either_end_can_be_the_stop_and_far_away_it_is_none() {
        let mut plan = Plan::base(Some(Law::He));
        (EFFECT.enter)(&[0.3, 1.0], &mut plan);
        assert_eq!(plan.stops, [f64::NEG_INFINITY, 0.3]);
        (EFFECT.enter)(&[-0.3, 0.0], &mut plan);
        assert_eq!(plan.stops, [-0.3, 0.3]);
    }
}
