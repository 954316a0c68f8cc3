//! With the valve position recorded the gap falls in two: OP to MV, which only the valve makes, and MV to PV, which
//! everything behind it makes.

use super::express::{fit, rms};
use super::noise;
use super::problem::Problem;
use super::schedule::{self, Work, is_calm, residual_of};
use super::traces::Traces;
use super::types::{Stage, Stages};
use crate::core::record::Record;
use crate::core::signal::stats;
use crate::core::sim::slips::Law;

/// Training error over the floor up to which MV explains PV.
const EXPLAINS: f64 = 1.08;
/// Share of the base's logarithm of that up to which MV explains what OP does not, and from which it does not help. A
/// position that is sampled once a scan leaves a little even where the valve is all that is wrong.
const MOSTLY: [f64; 2] = [0.2, 0.6];

/// The record with MV in the place of OP.
fn driven_by(record: &Record, mv: &[f64]) -> Record {
    let m = record.path_per_point();
    let op_path = mv.iter().flat_map(|v| core::iter::repeat_n(*v, m)).collect();
    Record { op_path, mv: None, ..record.clone() }
}

/// Looks at MV, where it is recorded and moves; `from_op` is the base's training error, PV units, beside PV's floor.
pub(crate) fn look(
    record: &Record,
    problem: &Problem,
    traces: &Traces,
    (from_op, floor): (f64, Option<f64>),
    work: &mut Work<'_>,
) -> Option<Stages> {
    if work.stopped {
        return None;
    }
    let mv = record.mv.as_ref().filter(|mv| mv.len() == record.len() && stats::span(mv).is_normal())?;
    let behind = driven_by(record, mv);
    let masked = problem.blocks.masked.clone();
    // A transmitter may be reversed, and the controller answers PV by OP, not by MV: both signs are tried.
    let mut from_mv =
        Problem::new(&behind, Some(problem.period), work.seed, masked.clone()).fitted_where(&traces.measured);
    from_mv.sign = None;
    let (search, _) = schedule::base(&from_mv, None, floor, work)?;
    let base = fit(&from_mv, &search, floor, &|_| {})?;
    let calm = is_calm(&from_mv, &search, floor);
    let stage =
        if calm { Stage::Valve } else { floor.map_or(Stage::Process, |f| pointed(base.rmse_train / f, from_op / f)) };
    let before = Record { pv: mv.clone(), mv: None, ..record.clone() };
    let mut to_mv = Problem::new(&before, Some(problem.period), work.seed, masked);
    to_mv.sign = None;
    let mv_floor = noise::floor(mv, &vec![true; mv.len()], false).noise_floor;
    let valve =
        schedule::base(&to_mv, Some(Law::He), mv_floor, work).and_then(|(search, _)| residual_of(&to_mv, &search));
    let op_to_mv = valve.map_or(1.0, |left| rms(&left, &to_mv.test));
    Some(Stages { op_to_mv: 100.0 * op_to_mv * op_to_mv, mv_to_pv: base.gap, stage })
}

/// The stage that errors over the floor point to, from MV and from OP.
fn pointed(from_mv: f64, from_op: f64) -> Stage {
    let above = |error: f64| libm::log(error.max(1.0));
    match above(from_mv) {
        left if from_mv <= EXPLAINS || left <= MOSTLY[0] * above(from_op) => Stage::Valve,
        left if left >= MOSTLY[1] * above(from_op) => Stage::Process,
        _ => Stage::CannotTell,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_mv_leaves_is_held_against_what_op_leaves() {
        assert_eq!(pointed(1.05, 1.2), Stage::Valve);
        assert_eq!(pointed(1.2, 15.0), Stage::Valve);
        assert_eq!(pointed(7.6, 7.4), Stage::Process);
        assert_eq!(pointed(1.3, 1.4), Stage::Process);
        assert_eq!(pointed(2.0, 4.5), Stage::CannotTell);
    }
}
