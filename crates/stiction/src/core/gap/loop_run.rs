//! The whole loop with the models: does it oscillate as the plant does?
//!
//! Free run takes OP as recorded. Where the controller can be read from the record, the loop can be closed over the
//! model, and the cycle that comes out compared with the recorded one: period and size.

use serde::{Deserialize, Serialize};

use super::effects;
use super::forward::FirstPart;
use super::in_loop::{NoPlace, Parts, Stated};
use super::judged::Diagnosis;
use super::model::{Model, Valve};
use super::types::FromSp;
use crate::core::detect::oscillation;
use crate::core::ident::controller::{self, Reading};
use crate::core::record::Record;
use crate::core::signal::detrend::moving_average;
use crate::core::signal::stats;
use crate::core::sim::actuator::Actuator;
use crate::core::sim::closed_loop::{ClosedLoop, LoopModel, ValveLaw, ValveModel};
use crate::core::sim::controller::{Action, PidSettings};
use crate::core::sim::process::ProcessModel;
use crate::core::sim::slips::Stroke;

/// Scans simulated at most.
const MAX_SCANS: usize = 60_000;
/// Deviations of PV by which SP must move to show the process.
const LEAST_SP_MOVES: f64 = 0.1;
/// Room for OP on both sides of what was recorded, spans.
const WIDE: f64 = 10.0;
/// A start off the resting place, bands.
const START_BANDS: f64 = 1.5;

/// A loop's cycle.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Cycle {
    /// Whether it oscillates regularly.
    pub oscillating: bool,
    /// Its period, s; `None` where nothing repeats.
    pub period_s: Option<f64>,
    /// Half of PV's span, PV units.
    pub amplitude_pv: f64,
    /// Half of OP's span, OP units.
    pub amplitude_op: f64,
}

/// The controller that closes the loop.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ControllerNote {
    /// Proportional gain, OP units per PV unit of SP - PV.
    pub kc: f64,
    /// Integral time, s; `None` without integral action.
    pub ti_s: Option<f64>,
    /// Derivative time, s.
    pub td_s: f64,
    /// Share of OP's moves that the controller model explains.
    pub r2: f64,
}

/// Cycles as recorded and as simulated.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Cycles {
    /// As read from the record.
    pub controller: ControllerNote,
    /// In the record.
    pub measured: Cycle,
    /// With the base.
    pub before: Option<Cycle>,
    /// With the cause added; `None` where it has no place in a closed loop's simulation, or nothing was added.
    pub after: Option<Cycle>,
}

/// Closes the loop over base and model after; `None` where the controller cannot be read.
#[must_use]
pub fn cycles(record: &Record, diagnosis: &Diagnosis) -> Option<Cycles> {
    let reading = controller::read(record)?;
    let noise_sd = diagnosis.findings.floor.noise_sd.unwrap_or(0.0);
    let after = &diagnosis.model_after;
    Some(Cycles {
        controller: ControllerNote {
            kc: reading.kc,
            ti_s: reading.ti_s.is_finite().then_some(reading.ti_s),
            td_s: reading.td_s,
            r2: reading.r2,
        },
        measured: cycle(&record.op(), &record.pv, record.point_s()),
        before: run(&diagnosis.findings.base.model, &reading, record, noise_sd),
        after: if after.effects.is_empty() { None } else { run(after, &reading, record, noise_sd) },
    })
}

/// The cycle of two signals whose points stand `point_s` apart.
fn cycle(op: &[f64], pv: &[f64], point_s: f64) -> Cycle {
    let found = oscillation::detect(op, pv);
    Cycle {
        oscillating: found.is_some_and(|o| o.oscillating),
        period_s: found.map(|o| o.period_points * point_s),
        amplitude_pv: 0.5 * stats::span(pv),
        amplitude_op: 0.5 * stats::span(op),
    }
}

/// The parts of a model for a simulation in scans of `ts_s`.
///
/// # Errors
/// [`NoPlace`] of the first effect that cannot be simulated.
pub fn parts(model: &Model, ts_s: f64) -> Result<Parts, NoPlace> {
    let mut parts = Parts { stroke: Stroke::FREE, actuator: Actuator::NONE, load: vec![], on_pv: vec![] };
    for added in &model.effects {
        let Some(effect) = effects::by_id(&added.id) else { return Err(NoPlace::Inside(added.id.clone())) };
        (effect.in_loop)(&Stated { model, added, ts_s }, &mut parts)?;
    }
    let clash = parts.actuator.lag > 0.0 && parts.stroke != Stroke::FREE;
    if clash { Err(NoPlace::Clash) } else { Ok(parts) }
}

/// The loop as the simulator takes it, off its resting place by a band and a half.
fn loop_model(model: &Model, reading: &Reading, sp: f64, limits: [f64; 2], noise_sd: f64) -> Option<LoopModel> {
    let Model { ts_s, valve, process, .. } = model;
    let law = match valve.law.as_str() {
        "he" => ValveLaw::He,
        "tracking" => ValveLaw::Tracking,
        "none" => ValveLaw::None,
        _ => return None,
    };
    let Parts { stroke, actuator, load, on_pv } = parts(model, *ts_s).ok()?;
    let (op, pv) = (process.op, process.pv);
    let rest = if process.integrating { op } else { op + (sp - pv) / process.gain };
    let off = START_BANDS * (valve.fs + valve.fd.abs());
    let rest_pv = if process.integrating { sp + off / reading.kc.abs() } else { sp + process.gain * off };
    let whole = [*ts_s, process.gain, rest, rest_pv, reading.kc];
    let usable = *ts_s > 0.0 && process.gain != 0.0 && reading.kc != 0.0 && whole.iter().all(|x| x.is_finite());
    usable.then(|| LoopModel {
        ts_s: *ts_s,
        process: ProcessModel {
            dead_time: process.dead_time_s / ts_s + reading.lag_samples.max(0.0),
            ..process.in_points(*ts_s)
        },
        rest_op: if process.integrating { rest } else { rest + off },
        rest_pv,
        controller: PidSettings {
            kc: reading.kc.abs(),
            ti_s: reading.ti_s,
            td_s: reading.td_s,
            action: if reading.kc > 0.0 { Action::Reverse } else { Action::Direct },
            op_min: limits[0],
            op_max: limits[1],
            op_resolution: 0.0,
        },
        valve: ValveModel {
            law,
            fs: valve.fs,
            fd: valve.fd,
            travel_min: limits[0],
            travel_max: limits[1],
            stroke,
            actuator,
            ..ValveModel::HEALTHY
        },
        pv_noise_sd: noise_sd,
        load,
        pv_disturbance: on_pv,
    })
}

/// The cycle of the loop under its set point.
fn run(model: &Model, reading: &Reading, record: &Record, noise_sd: f64) -> Option<Cycle> {
    let [op, pv] = simulated(model, reading, record, noise_sd)?;
    let found = cycle(&op, &pv, model.ts_s);
    (found.amplitude_pv.is_finite() && found.amplitude_op.is_finite()).then_some(found)
}

/// Ratio of the simulated to the recorded cycle, of period and of size, within which it is the recorded one.
const SAME_CYCLE: f64 = 1.5;

/// Share of PV's variance that goes with the friction where the loop's cycle ends without it: simulated with the valve as
/// fitted and with one that follows OP. `None` where the simulation does not cycle as the record does, or goes on without.
#[must_use]
pub(crate) fn share_of_friction(record: &Record, model: &Model, noise_sd: f64) -> Option<f64> {
    if model.valve.law == "none" {
        return None;
    }
    let reading = controller::read(record)?;
    let measured = cycle(&record.op(), &record.pv, record.point_s());
    let freed =
        Model { valve: Valve { law: "none".to_owned(), fs: 0.0, fd: 0.0, ..model.valve.clone() }, ..model.clone() };
    let run = |model: &Model| {
        let [op, pv] = simulated(model, &reading, record, noise_sd)?;
        Some((cycle(&op, &pv, model.ts_s), stats::variance(&pv)))
    };
    let ((with, pv), (without, pv_freed)) = (run(model)?, run(&freed)?);
    let near = |x: f64, y: f64| (1.0 / SAME_CYCLE..=SAME_CYCLE).contains(&(x / y));
    let periods = measured.period_s.zip(with.period_s);
    let cycles = measured.oscillating && with.oscillating && near(with.amplitude_pv, measured.amplitude_pv);
    let is_the_same = cycles && periods.is_some_and(|(x, y)| near(y, x));
    let ends = !without.oscillating || without.amplitude_pv < with.amplitude_pv / SAME_CYCLE;
    Some((1.0 - pv_freed / pv).clamp(0.0, 1.0)).filter(|share| is_the_same && ends && share.is_finite())
}

/// Whether the record's set point moves enough to show the process.
#[must_use]
pub(crate) fn sp_moves(record: &Record) -> bool {
    record.sp.as_ref().is_some_and(|sp| stats::std_dev(sp) > LEAST_SP_MOVES * stats::std_dev(&record.pv))
}

/// How much of PV the closed loop predicts from SP alone after the part that its models were fitted to, its controller read
/// from that part, too.
#[must_use]
pub(crate) fn from_sp(record: &Record, first: &FirstPart) -> Option<FromSp> {
    let rest = record.part(first.rest, record.len());
    let reading = controller::read(&record.part(0, first.rest)).filter(|_| sp_moves(&rest))?;
    let swing = oscillation::detect(&rest.op(), &rest.pv).filter(|o| o.oscillating).map(|o| o.period_points);
    let averaged = |pv: &[f64]| moving_average(pv, swing.map_or(1, |points| points.round() as usize));
    let measured = averaged(&rest.pv);
    let mean = stats::mean(&measured);
    let spread: f64 = measured.iter().map(|y| (y - mean) * (y - mean)).sum();
    let explained = |pv: &[f64]| {
        let left: f64 = measured.iter().zip(averaged(pv)).map(|(y, x)| (y - x) * (y - x)).sum();
        Some(100.0 * (1.0 - left / spread)).filter(|pct| pct.is_finite())
    };
    let predicted = |model: &Model| {
        let [_, pv] = simulated(model, &reading, record, 0.0)?;
        // Points of the record may be means of scans, and no others were simulated than fit in.
        let points: Vec<f64> = (first.rest..record.len())
            .map(|k| [k, k + 1].map(|at| at * pv.len() / record.len()))
            .map(|[from, to]| stats::mean(&pv[from..to.max(from + 1).min(pv.len())]))
            .collect();
        explained(&points)
    };
    let mut all = first.fits.iter().map(|fit| predicted(&fit.model));
    Some(FromSp {
        base_pct: all.next()??,
        after_pct: all.next().flatten(),
        sp_pct: explained(rest.sp.as_deref()?)?,
        averaged_s: swing.map(|points| points * record.point_s()),
    })
}

/// OP and PV of the loop, run for twice the record under its set point (its mean where none is recorded): the second half.
fn simulated(model: &Model, reading: &Reading, record: &Record, noise_sd: f64) -> Option<[Vec<f64>; 2]> {
    let sp = record.sp.as_ref().filter(|sp| !sp.is_empty() && sp.iter().all(|v| v.is_finite()));
    let first = sp.map_or_else(|| stats::mean(&record.pv), |sp| sp[0]);
    // The controller's limits are not recorded: wide ones leave the cycle alone.
    let op = stats::sorted(&record.op());
    let (low, high) = (*op.first()?, *op.last()?);
    let room = WIDE * (high - low);
    let loop_model = loop_model(model, reading, first, [low - room, high + room], noise_sd)?;
    let scans = (record.end_ns - record.start_ns) as f64 / 1e9 / loop_model.ts_s;
    let scans = (scans.max(0.0) as usize + 1).min(MAX_SCANS / 2);
    // It swings in for as long as the record, before its start.
    let mut closed = ClosedLoop::new(loop_model, -(scans as f64) * model.ts_s, first, 1);
    for _ in 0..scans {
        closed.step(first);
    }
    let set_point = |k: usize| sp.map_or(first, |sp| sp[(k * sp.len() / scans.max(1)).min(sp.len() - 1)]);
    let (mut op, mut pv) = (Vec::with_capacity(scans), Vec::with_capacity(scans));
    for k in 0..scans {
        let scan = closed.step(set_point(k));
        op.push(scan.op);
        pv.push(scan.pv);
    }
    Some([op, pv])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::sim::disturbance::Disturbance;

    #[test]
    fn what_moves_the_stem_is_taken_over_in_scans_and_anything_else_named() {
        let with = |id: &str, numbers: &[(&str, f64)]| {
            let model = Model { ts_s: 7.0, ..Model::example(Some((id, numbers))) };
            // The scans that count are those of the simulation, not of the record that the model was fitted to.
            parts(&model, 2.0).map(|p| p.stroke)
        };
        assert_eq!(with("extra_lag", &[("lag", 3.0)]), Ok(Stroke::FREE));
        assert_eq!(with("slip_overshoot", &[("carried", 0.4)]), Ok(Stroke { carried: 0.4, ..Stroke::FREE }));
        let slides = Stroke { drag: 0.5, slowest: 0.2, ..Stroke::FREE };
        assert_eq!(with("sliding_valve", &[("drag", 1.0), ("slowest", 0.1)]), Ok(slides));
        let slow = Stroke { rate: 0.6, ..Stroke::FREE };
        assert_eq!(with("rate_limit", &[("rate", 0.3), ("of_stem", 1.0)]), Ok(slow));
        // A stem at its upper stop was pushed there by an OP that stands fd above it.
        let stopped = Stroke { ends: [f64::NEG_INFINITY, 61.0], ..Stroke::FREE };
        assert_eq!(with("travel_limit", &[("stop", 60.0), ("upper", 1.0), ("of_stem", 1.0)]), Ok(stopped));
        for inside in ["gain_drift", "dead_time_change", "inverse_response"] {
            assert_eq!(with(inside, &[("at", 3.0)]), Err(NoPlace::Inside(inside.to_owned())));
        }
    }

    #[test]
    fn what_stands_around_the_stem_and_loads_have_their_place() {
        let with = |id: &str, numbers: &[(&str, f64)]| {
            let model = Model { ts_s: 7.0, ..Model::example(Some((id, numbers))) };
            (parts(&model, 2.0).unwrap(), model.process)
        };
        let actuator = |id: &str, numbers: &[(&str, f64)]| with(id, numbers).0.actuator;
        assert_eq!(actuator("rate_limit", &[("rate", 0.3)]), Actuator { rate: 0.6, ..Actuator::NONE });
        let stops = [f64::NEG_INFINITY, 60.0];
        assert_eq!(actuator("travel_limit", &[("stop", 60.0), ("upper", 1.0)]), Actuator { stops, ..Actuator::NONE });
        assert_eq!(actuator("backlash", &[("width", 1.5)]), Actuator { play: 1.5, ..Actuator::NONE });
        assert_eq!(actuator("positioner_lag", &[("lag", 5.0)]), Actuator { lag: 2.5, ..Actuator::NONE });
        let (bent, process) = with("static_nonlinearity", &[("gain_change_per_op", 0.02)]);
        assert_eq!(bent.actuator, Actuator { bend: 0.02, middle: process.op, ..Actuator::NONE });
        let (step, process) = with("step_load", &[("size", 3.0), ("at", 100.0)]);
        let at_input = Disturbance::Step { size: 3.0 / process.gain, at_s: 100.0 - process.dead_time_s };
        assert_eq!((step.load, step.on_pv), (vec![at_input], vec![]));
        let refused = |id: &str, numbers: &[(&str, f64)]| parts(&Model::example(Some((id, numbers))), 2.0).is_err();
        assert!(refused("rate_limit", &[("rate", -0.5)]) && refused("sinusoid", &[("amplitude", 1.0)]));
        assert!(refused("step_load", &[("at", 5.0)]) && refused("backlash", &[("play", 1.0)]));
        let (ramp, _) = with("ramp", &[("slope", 1e-3), ("from", 50.0)]);
        assert_eq!(ramp.on_pv, [Disturbance::Ramp { size: 1e6, from_s: 50.0, over_s: 1e9 }]);
    }
}
