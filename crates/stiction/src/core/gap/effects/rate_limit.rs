//! An actuator that moves no faster than so much a second.

use super::clues::Clues;
use super::effect::{Effect, Param, Reach, Start, Unit, kept};
use crate::core::gap::types::Stage;

/// As the catalogue has it.
pub(crate) const EFFECT: Effect = Effect {
    params: &[
        Param {
            name: "rate",
            unit: Unit::LogRate,
            reach: Reach::Path,
            limits: |_| [libm::log(0.002), libm::log(2.0)],
            trade: kept,
        },
        Param { name: "of_stem", unit: Unit::Choice, reach: Reach::Jumps, limits: |_| [0.0, 1.0], trade: kept },
    ],
    apply: |p, plan| *(if p[1] > 0.5 { &mut plan.stroke.rate } else { &mut plan.actuator.rate }) = libm::exp(p[0]),
    starts,
    confused_with: &["extra_lag", "positioner_lag"],
    separated_by: "the valve position after a large step of OP",
    noun: "a slow stem",
    behind_stem: true,
    phrase: |sizes| {
        let what = if sizes.value("of_stem") == Some(1.0) { "a stem" } else { "a valve behind its stem" };
        Some(format!("{what} that moves no faster than {} OP units a second", sizes.said("rate")?))
    },
    in_loop: |stated, parts| {
        let rate = stated.above_zero("rate")? * stated.ts_s;
        *(if stated.is("of_stem") { &mut parts.stroke.rate } else { &mut parts.actuator.rate }) = rate;
        Ok(())
    },
    ..Effect::simulated("rate_limit", Stage::Valve)
};

fn starts(clues: &Clues<'_>) -> Vec<Start> {
    let travel = (clues.stem[1] - clues.stem[0]).max(0.05);
    let rate = |r: f64| libm::log(r * travel / clues.problem.period);
    [3.0, 8.0, 25.0, 80.0].into_iter().flat_map(|r| [[rate(r), 0.0, 0.0], [rate(r), 1.0, 0.0]]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::gap::plan::Plan;
    use crate::core::sim::slips::Law;

    #[test]
    fn the_rate_is_a_logarithm_of_the_stem_or_of_what_follows_it() {
        let mut plan = Plan::base(Some(Law::He));
        (EFFECT.apply)(&[libm::log(0.05), 0.0], &mut plan);
        assert!((plan.actuator.rate - 0.05).abs() < 1e-12 && !plan.is_linear_in_fd());
        let mut plan = Plan::base(Some(Law::He));
        (EFFECT.apply)(&[libm::log(0.05), 1.0], &mut plan);
        assert!((plan.stroke.rate - 0.05).abs() < 1e-12 && plan.is_linear_in_fd());
    }
}
