//! Loops for the cause of an oscillation: tuning, a disturbance, the valve, or none of these.
//!
//! Half of the loops follow a moving set point. A healthy valve is either ideal or a force-balance valve whose band is 1 to 3 %
//! of OP's travel, because no real valve is without friction. A ringing loop has a damping of 0.01 to 0.12, a sluggish one
//! takes five to fifteen times as long as its process. A well-tuned loop has a maximum sensitivity of at most 2.2 and takes at
//! most four times as long as its process if that is self-regulating. Loops between these limits have no clear cause and are
//! not drawn.

use super::TruthLoop;
use super::accuracy::{bands, cycling, law_name, physical, shows_stiction};
use super::draw::{Draw, scaled, span, std_dev};
use super::rig::{Drive, Rig, max_sensitivity, tune, ultimate};
use super::verdict::{self, LIMIT_CYCLE, PROCESS_KINDS, Plan};
use stiction::core::sim::closed_loop::{ValveLaw, ValveModel};
use stiction::core::sim::process::ProcessModel;

/// Excitations of the loops of each cause. `sluggish` needs a moving set point to be visible.
const TUNING: [&str; 3] = ["tight gain", "too much integral", "sluggish"];
const DISTURBANCE: [&str; 8] =
    ["sine", "two sines", "square", "triangle", "wandering sine", "bursts", "upstream limit cycle", "noisy cycle"];
const VALVE: [&str; 4] = [LIMIT_CYCLE, LIMIT_CYCLE, "sine", "coloured"];
const NONE: [&str; 4] = ["coloured", "random walk", "load steps", "noise only"];

/// Causes, in turn by the seed.
pub const CAUSES: [&str; 4] = ["tuning", "disturbance", "valve", "none"];
/// Largest maximum sensitivity of a well-tuned loop.
const WELL_TUNED: f64 = 2.2;
/// Largest ratio of a well-tuned loop's time to that of its process.
const NOT_SLUGGISH: f64 = 4.0;
/// Damping of a loop that rings.
const RINGING: [f64; 2] = [0.01, 0.12];

/// The loop of a seed: the seed cycles through causes, constant and moving set points, and excitations.
pub(super) fn attempt(draw: &mut Draw, seed: u64) -> Option<TruthLoop> {
    let cause = CAUSES[(seed % 4) as usize];
    let moves = seed / 4 % 2 == 1;
    let turn = |kinds: &[&'static str]| kinds[(seed / 8) as usize % kinds.len()];
    let kind = match cause {
        "tuning" => turn(if moves { &TUNING } else { &TUNING[..2] }),
        "disturbance" => turn(&DISTURBANCE),
        "valve" => turn(&VALVE),
        // A moving set point may be the only excitation.
        _ => turn(&NONE),
    };
    let plan =
        Plan { record_kind: if draw.chance(0.5) { "raw" } else { Plan::new(draw).record_kind }, ..lengths(draw) };
    let (process_kind, mut rig) = rig(draw, kind, plan.scan_period())?;
    let period = plan.scan_period();
    let mut start = 0.0;
    let mut size = draw.log_between(1.0, 10.0);
    if cause == "valve" {
        (rig, start) = sticking(draw, rig, kind, period)?;
        size = rig.valve.fs * draw.between(0.05, 1.0);
    }
    let mut drive = drive(draw, kind, &rig, size, period, plan.scans())?;
    let offset = start * rig.pv_per_op(period);
    drive.sp.iter_mut().for_each(|sp| *sp += offset);
    let unmoved = rig.run(&drive, 0.0, 0).thinned(plan.from, 1);
    if moves {
        let swing =
            if kind == "noise only" || cause == "tuning" { size * rig.pv_per_op(period) } else { span(&unmoved.pv) };
        let moved = set_point(draw, kind, period, plan.scans());
        let by = swing * draw.log_between(0.25, 1.5);
        drive.sp.iter_mut().zip(moved).for_each(|(sp, more)| *sp += by * more);
        // The set point must move within the record.
        if span(&drive.sp[plan.from..]) <= 0.0 {
            return None;
        }
    }
    record(draw, Case { plan, rig, drive, cause, kind, process_kind, period, size })
}

/// A record of 5 to 40 periods with at least 12 samples each.
fn lengths(draw: &mut Draw) -> Plan {
    let n = draw.log_between(400.0, 2_500.0);
    let period = n / draw.log_between(5.0, (n / 12.0).min(40.0));
    Plan { record_kind: "raw", n: n as usize, period, every: 1, from: (period * draw.between(1.0, 4.0)) as usize }
}

/// A loop with a healthy valve for this kind of excitation, and its kind of process.
fn rig(draw: &mut Draw, kind: &str, period: f64) -> Option<(usize, Rig)> {
    let (process_kind, ratio) = match kind {
        "sluggish" => (draw.pick(&[1, 2], 1), draw.log_between(0.05, 0.3)),
        _ if TUNING.contains(&kind) => (draw.pick(&[1, 2, 3], 1), 1.0),
        _ => (draw.pick(&[0, 1, 2, 3], 1), draw.log_between(0.1, 1.0)),
    };
    let process = verdict::process(draw, process_kind, period, ratio)?;
    let tight = draw.log_between(0.08, 0.5);
    let (kc, ti, td, _) = tune(draw, &process, if TUNING.contains(&kind) { 1.0 } else { tight })?;
    let mut rig = Rig { process, kc, ti, td, ..Rig::AT_REST };
    let damping = draw.log_between(RINGING[0], RINGING[1]);
    match kind {
        "sluggish" => {
            // The closed loop takes five to fifteen times as long as its process.
            (rig.ti, rig.td) = (draw.between(0.8, 1.6) * (process.tau + process.tau2), 0.0);
            rig.kc = rig.ti / (process.gain.abs() * time(&process) * draw.log_between(5.0, 15.0));
        }
        "too much integral" if process.integrating => {
            // Characteristic equation s^2 + K Kc s + K Kc / Ti; the dead time is short compared with the period.
            (rig.ti, rig.td) = (period * damping / core::f64::consts::PI, 0.0);
            rig.kc = 4.0 * damping * damping / (process.gain.abs() * rig.ti);
            rig.process.dead_time = process.dead_time.min(0.01 * period);
        }
        _ if TUNING.contains(&kind) => {
            if kind == "too much integral" {
                (rig.ti, rig.td) = (ti * draw.between(0.15, 0.4), 0.0);
            }
            let (most, ringing) = ultimate(&process, rig.ti, rig.td)?;
            rig.kc = most;
            rig = rig.stretched(period / ringing);
            // The response to a step is measured over twenty periods.
            let left = libm::exp(-20.0 * core::f64::consts::PI * damping);
            if !verdict::tighten(&mut rig, period, left) {
                return None;
            }
        }
        _ if max_sensitivity(&rig.process, rig.kc, rig.ti, rig.td) > WELL_TUNED => return None,
        _ if !process.integrating && rig.ti > NOT_SLUGGISH * rig.kc * process.gain.abs() * time(&process) => {
            return None;
        }
        _ => {}
    }
    rig.rest_op = draw.between(25.0, 75.0);
    rig.rest_pv = rig.pv_per_op(period) * draw.between(20.0, 200.0);
    Some((process_kind, rig))
}

/// Time of a process, scans: its lags, its dead time, and half a scan for the hold.
fn time(process: &ProcessModel) -> f64 {
    process.tau + process.tau2 + process.dead_time + 0.5
}

/// The same loop with a sticking valve; also OP at the start of the cycle.
fn sticking(draw: &mut Draw, rig: Rig, kind: &str, period: f64) -> Option<(Rig, f64)> {
    let law = draw.pick(&[ValveLaw::He, ValveLaw::Tracking, ValveLaw::Physical], ValveLaw::He);
    let (valve, as_law) = verdict::sticking_valve(draw, law, false, period);
    let rig = Rig { valve: as_law, ..rig };
    match cycling(rig, draw, period) {
        Some((found, _, start)) => Some((Rig { valve, ..found }, start)),
        None if kind == LIMIT_CYCLE => None,
        None => Some((Rig { valve, ..rig }, 0.0)),
    }
}

/// Inputs of the loop in addition to its set point. `size` is in OP units, at the process input.
fn drive(draw: &mut Draw, kind: &str, rig: &Rig, size: f64, period: f64, n: usize) -> Option<Drive> {
    let [broad, beside] = [[0.1, 1.0], [0.02, 0.3]].map(|[least, most]| size * draw.log_between(least, most));
    let mut drive = match kind {
        LIMIT_CYCLE | "noise only" => return Some(Drive::none(n)),
        // The load that excites a ringing loop is broadband; it may be small, because the set point can excite the loop, too.
        _ if TUNING.contains(&kind) => verdict::drive(draw, "coloured", rig, broad, period, n),
        "noisy cycle" => {
            let cycle = noisy_cycle(draw, period, n);
            let mut drive = Drive::none(n);
            drive.load = scaled(&cycle, size);
            Some(drive)
        }
        _ => verdict::drive(draw, kind, rig, size, period, n),
    }?;
    if DISTURBANCE.contains(&kind) {
        // Other loads act in addition to the dominant one.
        let beside = verdict::drive(draw, "coloured", rig, beside, period, n)?;
        drive.load.iter_mut().zip(beside.load).for_each(|(x, more)| *x += more);
        drive.pv.iter_mut().zip(beside.pv).for_each(|(x, more)| *x += more);
    }
    Some(drive)
}

/// A damped rotation driven by noise (Harvey 1989): it forgets its phase within a few periods.
fn noisy_cycle(draw: &mut Draw, period: f64, n: usize) -> Vec<f64> {
    let turn = 2.0 * core::f64::consts::PI / period;
    let r = libm::exp(-1.0 / (draw.log_between(1.0, 6.0) * period));
    let (sin, cos) = (r * libm::sin(turn), r * libm::cos(turn));
    let (mut s, mut c) = (draw.gaussian(), draw.gaussian());
    let driven = (1.0 - r * r).sqrt();
    (0..n)
        .map(|_| {
            (s, c) = (s * cos + c * sin + driven * draw.gaussian(), c * cos - s * sin + driven * draw.gaussian());
            c
        })
        .collect()
}

/// A set point that moves between about -1/2 and 1/2: steps, ramps, or the output of another controller.
fn set_point(draw: &mut Draw, kind: &str, period: f64, n: usize) -> Vec<f64> {
    let hold = period * if kind == "sluggish" { draw.log_between(1.0, 4.0) } else { draw.log_between(2.0, 8.0) };
    let series = match draw.pick(&["steps", "steps", "ramps", "cascade"], "steps") {
        "steps" => draw.steps(hold, n),
        "ramps" => draw.ramps(hold, n),
        _ => {
            let shape = stiction::core::sim::disturbance::Disturbance::Ar1 { sd: 1.0, time_constant_s: hold };
            draw.series(shape, n)
        }
    };
    scaled(&series, 0.5)
}

/// A loop before its run.
struct Case {
    plan: Plan,
    rig: Rig,
    drive: Drive,
    cause: &'static str,
    kind: &'static str,
    process_kind: usize,
    period: f64,
    size: f64,
}

/// Runs and stores the loop. `None` if the result is not a valid case.
fn record(draw: &mut Draw, case: Case) -> Option<TruthLoop> {
    let Case { plan, mut rig, drive, cause, kind, process_kind, period, size } = case;
    let calm = rig.run(&drive, 0.0, 0).thinned(plan.from, 1);
    let sticks = cause == "valve";
    if !sticks && draw.chance(0.5) {
        let fs = 0.5 * span(&calm.op) * draw.log_between(0.01, 0.03);
        let friction = physical(draw, fs, 0.5 * fs, period);
        rig.valve = ValveModel { law: ValveLaw::Physical, fs, fd: 0.5 * fs, friction, ..ValveModel::HEALTHY };
    }
    let share = draw.log_between(0.01, 0.3);
    let noise_sd = if span(&calm.pv) > 0.0 { share * std_dev(&calm.pv) } else { draw.log_between(0.1, 2.0) / rig.kc };
    let run = rig.run(&drive, noise_sd, draw.seed());
    let seen = run.thinned(plan.from, 1);
    let travel = span(&seen.op);
    if !run.is_finite() || !(0.05..=70.0).contains(&travel) || noise_sd <= 0.0 {
        return None;
    }
    let (s, j) = if sticks { bands(&rig.valve) } else { (0.0, 0.0) };
    if sticks && !shows_stiction(&rig.valve, &seen) {
        return None;
    }
    let stored = plan.store(draw, &run);
    let ts_s = draw.pick(&[0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 30.0, 60.0], 1.0);
    Some(TruthLoop {
        op: stored.op,
        pv: stored.pv,
        sp: stored.sp,
        mv: stored.mv,
        ts_s,
        noise_sd,
        floor_sd: None,
        sticks,
        law: law_name(rig.valve.law),
        s: sticks.then_some(s),
        j: sticks.then_some(j),
        process: rig.process,
        controller: rig.settings(ts_s),
        travel: [rig.valve.travel_min, rig.valve.travel_max],
        seed: 0,
        kind,
        process_kind: PROCESS_KINDS[process_kind],
        record_kind: plan.record_kind,
        cause,
        regime: "cause",
        noise_share: share,
        period,
        disturbance: size,
    })
}

#[cfg(test)]
mod tests {
    use crate::truth::{Half, cause_case};
    use std::collections::BTreeSet;

    #[test]
    fn every_cause_has_every_physics_with_and_without_moves_of_the_set_point() {
        let mut seen = BTreeSet::new();
        for seed in 0..160 {
            let found = cause_case(Half::Calibration, seed);
            let moves = found.sp.windows(2).any(|w| w[0] != w[1]);
            assert_eq!(moves, seed / 4 % 2 == 1, "{seed}");
            assert_eq!(found.sticks, found.cause == "valve");
            seen.extend([(found.cause, found.kind), (found.cause, found.process_kind), (found.cause, found.law)]);
        }
        for cause in super::CAUSES {
            let laws: &[&str] = if cause == "valve" { &["he", "tracking", "physical"] } else { &["none", "physical"] };
            assert!(
                laws.iter().chain(&["second order"]).all(|what| seen.contains(&(cause, *what))),
                "{cause}: {seen:?}"
            );
            assert!(seen.contains(&(cause, "integrating")) && seen.contains(&(cause, "first order")), "{cause}");
        }
    }
}
