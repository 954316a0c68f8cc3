//! A gain that goes with the level: the valve's characteristic, or the process' own. OP and PV hardly tell which.
//!
//! A characteristic whose slope grows by the same share with each OP unit (equal percentage) bends the valve signal in
//! front of the process. Where the process' own gain goes with PV, `tau dy/dt = -y + (1 + c y) v`, gain and time constant
//! grow together; from whatever level y and v are counted, the form stays the same. One or the other is fitted: both at
//! once would also imitate a time constant that changes alone.

use super::effect::{Effect, Param, Reach, Unit, grows, kept};
use crate::core::gap::in_loop::NoPlace;
use crate::core::gap::types::Stage;

/// As the catalogue has it.
pub(crate) const EFFECT: Effect = Effect {
    params: &[
        Param {
            name: "gain_change_per_op",
            unit: Unit::PerOp,
            reach: Reach::Process,
            limits: |_| [-6.0, 6.0],
            trade: kept,
        },
        Param { name: "by_level", unit: Unit::Choice, reach: Reach::Jumps, limits: |_| [0.0, 1.0], trade: kept },
    ],
    // At OP's middle the slope of `v / (1 - c v)`, where a process comes to rest, grows by 2 c with each span.
    apply: |p, plan| {
        *(if p[1] > 0.5 { &mut plan.level } else { &mut plan.actuator.bend }) = p[0] / (1.0 + p[1].round())
    },
    starts: |_| [-2.0, 2.0].into_iter().flat_map(|c| [[c, 0.0, 0.0], [c, 1.0, 0.0]]).collect(),
    confused_with: &["travel_limit", "gain_drift", "asymmetric_stiction"],
    separated_by: "the flow, or steps of OP at two levels",
    noun: "a gain that changes with level",
    twin: Some("a valve characteristic"),
    phrase: |sizes| {
        let change = sizes.value("gain_change_per_op")?;
        Some(format!("a gain that {} by {} with each OP unit", grows(change), sizes.percent(change)))
    },
    in_loop: |stated, parts| {
        if stated.is("by_level") {
            return Err(NoPlace::Inside(stated.id().to_owned()));
        }
        (parts.actuator.bend, parts.actuator.middle) = (stated.number("gain_change_per_op")?, stated.model.process.op);
        Ok(())
    },
    ..Effect::simulated("static_nonlinearity", Stage::Process)
};

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::gap::plan::Plan;
    use crate::core::sim::slips::Law;

    #[test]
    fn the_bend_is_the_valves_or_the_process_and_none_is_the_base() {
        let base = Plan::base(Some(Law::He));
        let entered = |p: [f64; 2]| {
            let mut plan = base;
            (EFFECT.apply)(&p, &mut plan);
            plan
        };
        assert_eq!([entered([0.4, 0.0]).actuator.bend, entered([0.4, 0.0]).level], [0.4, 0.0]);
        assert_eq!([entered([0.4, 1.0]).actuator.bend, entered([0.4, 1.0]).level], [0.0, 0.2]);
        assert!(entered([0.0, 0.0]) == base && !entered([0.4, 1.0]).is_linear_in_fd());
    }
}
