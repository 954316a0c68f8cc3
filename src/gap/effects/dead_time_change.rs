//! From some instant on, another dead time.

use super::{Clues, Effect, Param, Reach, Stage, Start, Unit, WIDE_MARGIN, Way, nothing};

/// As the catalogue has it.
pub const EFFECT: Effect = Effect {
    id: "dead_time_change",
    stage: Stage::Process,
    way: Way::Simulated,
    params: &[
        Param {
            name: "at",
            unit: Unit::Instant,
            reach: Reach::Jumps,
            limits: |s| [s.blocks.from as f64, s.n() as f64 - 2.0],
        },
        Param {
            name: "added",
            unit: Unit::Time,
            reach: Reach::Process,
            limits: |s| [-s.longest_lag(), s.longest_lag()],
        },
    ],
    enter: |p, plan| plan.switch = Some([p[0], p[1]]),
    starts,
    linear: nothing,
    margin: WIDE_MARGIN,
    predictable: true,
    confused_with: &["gain_drift", "time_skew"],
    separated_by: "flow or speed that sets the transport time",
};

fn starts(clues: &Clues<'_>) -> Vec<Start> {
    let (n, lag) = (clues.problem.n() as f64, clues.lag);
    let mut out = Vec::new();
    for at in [0.3, 0.45, 0.6, 0.75] {
        for added in [-0.6 * lag, 0.5 * lag, 1.5 * lag] {
            out.push([at * n, added, 0.0]);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gap::structure::Plan;
    use crate::sim::slips::Law;

    #[test]
    fn nothing_added_is_the_base() {
        let mut plan = Plan::base(Some(Law::He));
        (EFFECT.enter)(&[100.0, 3.0], &mut plan);
        assert_eq!(plan.switch, Some([100.0, 3.0]));
        assert!(plan.is_linear_in_fd());
    }
}
