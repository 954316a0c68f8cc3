//! Healthy and sticking loops for the verdict: all kinds of excitation, and all effects of recording.

use super::TruthLoop;
use super::accuracy::{bands, cycling, law_name, physical, shows_stiction};
use super::draw::{Draw, scaled, span, std_dev};
use super::rig::{Drive, Rig, Run, tune};
use super::storage;
use stiction::core::sim::closed_loop::{ValveLaw, ValveModel};
use stiction::core::sim::disturbance::Disturbance;
use stiction::core::sim::process::ProcessModel;

/// Excitations, except the limit cycle of a sticking valve.
pub const KINDS: [&str; 20] = [
    "triangle",
    "square",
    "sine",
    "two sines",
    "wandering sine",
    "bursts",
    "upstream limit cycle",
    "load steps",
    "coloured",
    "random walk",
    "slow drift",
    "noise only",
    "sp sine",
    "sp steps",
    "sp random",
    "sp ramps",
    "op saturation",
    "nonlinear gain",
    "tight tuning",
    "too much integral",
];

/// Kind of a sticking loop without any other excitation.
pub const LIMIT_CYCLE: &str = "limit cycle";

/// Processes of the verdict's loops.
pub const PROCESS_KINDS: [&str; 4] = ["fast flow", "first order", "second order", "integrating"];

/// Effects of recording on the verdict's loops.
pub const RECORD_KINDS: [&str; 6] =
    ["raw", "exception hold", "swinging door", "op quantised", "pv quantised", "decimated"];

/// Cause of a healthy loop's oscillation, by its kind.
fn cause(kind: &str) -> &'static str {
    match kind {
        "triangle" | "square" | "sine" | "two sines" | "wandering sine" | "bursts" | "upstream limit cycle" => {
            "disturbance"
        }
        "tight tuning" | "too much integral" => "tuning",
        _ => "none",
    }
}

/// Length, period and thinning of a record, in recorded samples.
pub(super) struct Plan {
    pub record_kind: &'static str,
    pub n: usize,
    pub period: f64,
    pub every: usize,
    /// Scans before the first recorded one.
    pub from: usize,
}

impl Plan {
    pub fn new(draw: &mut Draw) -> Self {
        let record_kind = if draw.chance(0.25) { "raw" } else { draw.pick(&RECORD_KINDS, "raw") };
        let n = draw.log_between(300.0, 2_000.0);
        let (period, every) = if record_kind == "decimated" {
            let period = draw.log_between(6.0, 30.0).max(n / 60.0);
            (period, 2 + (draw.between(0.0, 6.99)) as usize)
        } else {
            (n / draw.log_between(3.0, (n / 10.0).min(30.0)), 1)
        };
        let from = if draw.chance(0.5) { period * every as f64 * draw.between(1.0, 4.0) } else { 0.0 };
        Self { record_kind, n: n as usize, period, every, from: from as usize }
    }

    pub fn scans(&self) -> usize {
        self.n * self.every + self.from
    }

    /// Period in scans.
    pub fn scan_period(&self) -> f64 {
        self.period * self.every as f64
    }

    /// Stores a run, with bands relative to each signal's spread.
    pub fn store(&self, draw: &mut Draw, run: &Run) -> Run {
        let mut run = run.thinned(self.from, self.every);
        run.op.truncate(self.n);
        run.pv.truncate(self.n);
        run.sp.truncate(self.n);
        run.mv.truncate(self.n);
        let (op_sd, pv_sd) = (std_dev(&run.op), std_dev(&run.pv));
        let (fine, coarse) = (draw.log_between(0.02, 0.2), draw.log_between(0.05, 0.4));
        match self.record_kind {
            "exception hold" => {
                storage::exception_hold(&mut run.op, fine * op_sd);
                storage::exception_hold(&mut run.pv, coarse * pv_sd);
            }
            "swinging door" => {
                storage::swinging_door(&mut run.op, fine * op_sd);
                storage::swinging_door(&mut run.pv, coarse * pv_sd);
            }
            "op quantised" => storage::rounded(&mut run.op, (2.0 * coarse * op_sd).max(0.01)),
            "pv quantised" => storage::rounded(&mut run.pv, 1.5 * coarse * pv_sd),
            _ => {}
        }
        run
    }
}

/// A process of this kind whose loop, if it rings, has a period of `ratio` times the planned one.
pub(super) fn process(draw: &mut Draw, kind: usize, period: f64, ratio: f64) -> Option<ProcessModel> {
    if kind == 0 {
        let gain = draw.sign() * draw.log_between(0.4, 3.0) * draw.pick(&[0.1, 1.0, 4.0, 15.0], 1.0);
        let (tau, dead_time) = (draw.log_between(0.3, 4.0), draw.between(0.0, 2.0));
        return Some(ProcessModel { gain, tau, tau2: 0.0, dead_time, integrating: false });
    }
    let (base, _) = super::accuracy::process(draw, kind - 1);
    let (_, _, _, ringing) = tune(draw, &base, 0.5)?;
    let c = (ratio * period / ringing).max(4.0 / ringing);
    let gain = if base.integrating { base.gain / c } else { base.gain };
    Some(ProcessModel { gain, tau: base.tau * c, tau2: base.tau2 * c, dead_time: base.dead_time * c, ..base })
}

/// Sets the controller so that the response to a step decays to about the share `left` within ten periods.
pub(super) fn tighten(rig: &mut Rig, period: f64, left: f64) -> bool {
    let n = (20.0 * period).clamp(60.0, 6_000.0) as usize;
    let (mut low, mut high) = (0.3 * rig.kc, 1.5 * rig.kc);
    for _ in 0..14 {
        rig.kc = 0.5 * (low + high);
        if rig.ringing(n) < left { low = rig.kc } else { high = rig.kc }
    }
    rig.kc = low;
    (0.3 * left..=left * 1.001).contains(&rig.ringing(n))
}

/// Another loop's PV in its limit cycle, with half span 1: the effect of a sticking valve upstream.
fn upstream(draw: &mut Draw, period: f64, n: usize) -> Option<Vec<f64>> {
    let kind = draw.pick(&[0, 1], 0);
    let (process, _) = super::accuracy::process(draw, kind);
    let tight = draw.log_between(0.15, 0.5);
    let (kc, ti, td, _) = tune(draw, &process, tight)?;
    let law = if draw.chance(0.5) { ValveLaw::He } else { ValveLaw::Tracking };
    let valve = ValveModel { law, fs: 3.0, fd: draw.between(0.2, 2.4), ..ValveModel::HEALTHY };
    let rig = Rig { process, kc, ti, td, valve, ..Rig::AT_REST };
    let (rig, _, start) = cycling(rig, draw, period)?;
    let before = (4.0 * period) as usize;
    let mut drive = Drive::none(n + before);
    drive.sp.fill(start * rig.pv_per_op(period));
    let run = rig.run(&drive, 0.0, 0);
    let middle = run.pv[before..].iter().sum::<f64>() / n.max(1) as f64;
    let around: Vec<f64> = run.pv[before..].iter().map(|v| v - middle).collect();
    Some(scaled(&around, 1.0))
}

/// A sine whose period wanders, or one that starts and stops.
fn uneven_sine(draw: &mut Draw, kind: &str, period: f64, n: usize) -> Vec<f64> {
    let wander = if kind == "bursts" { 0.0 } else { draw.between(0.05, 0.4) };
    let mut turns = draw.between(0.0, 1.0);
    let pulse = period * draw.between(3.0, 8.0);
    let start = draw.between(0.0, 1.0);
    (0..n)
        .map(|k| {
            turns += (1.0 + wander * draw.gaussian() * period.sqrt() * 0.3) / period;
            let place = k as f64 / pulse + start;
            let on = if kind == "bursts" && place - place.floor() > 0.55 { 0.0 } else { 1.0 };
            on * libm::sin(2.0 * core::f64::consts::PI * (turns - turns.floor()))
        })
        .collect()
}

/// Inputs of a loop of this kind. `size` is in OP units, at the process input.
pub(super) fn drive(draw: &mut Draw, kind: &str, rig: &Rig, size: f64, period: f64, n: usize) -> Option<Drive> {
    let mut drive = Drive::none(n);
    let unit = rig.pv_per_op(period);
    let time = |draw: &mut Draw, low: f64, high: f64| period * draw.log_between(low, high);
    let load = match kind {
        "triangle" => draw.triangle(period, n),
        "square" => draw.square(period, n),
        "sine" => draw.sine(period, n),
        "two sines" => {
            let other = time(draw, 0.25, 0.8);
            let (share, one, two) = (draw.between(0.3, 1.0), draw.sine(period, n), draw.sine(other, n));
            one.iter().zip(two).map(|(a, b)| (a + share * b) / (1.0 + share)).collect()
        }
        "wandering sine" | "bursts" => uneven_sine(draw, kind, period, n),
        "upstream limit cycle" => upstream(draw, period, n)?,
        "load steps" => draw.steps(period, n),
        "coloured" | "tight tuning" | "too much integral" => {
            let time_constant_s = time(draw, 0.05, 0.6);
            scaled(&draw.series(Disturbance::Ar1 { sd: 1.0, time_constant_s }, n), 1.0)
        }
        "random walk" => scaled(&draw.series(Disturbance::RandomWalk { sd_per_root_s: 1.0 }, n), 1.5),
        "slow drift" => {
            let walk = scaled(&draw.series(Disturbance::RandomWalk { sd_per_root_s: 1.0 }, n), 1.0);
            let (slope, from) = (draw.between(-2.0, 2.0), draw.between(-0.2, 0.5));
            let ramp = |k: usize| slope * (k as f64 / n as f64 - from).max(0.0);
            walk.iter().enumerate().map(|(k, w)| w + ramp(k)).collect()
        }
        "sp sine" | "sp steps" | "sp random" | "sp ramps" => {
            let series = match kind {
                "sp sine" => draw.sine(period, n),
                "sp steps" => draw.steps(period, n),
                "sp ramps" => draw.ramps(period, n),
                _ => {
                    let time_constant_s = time(draw, 0.1, 1.0);
                    scaled(&draw.series(Disturbance::Ar1 { sd: 1.0, time_constant_s }, n), 1.0)
                }
            };
            drive.sp = series.iter().map(|x| x * size * unit).collect();
            return Some(drive);
        }
        "op saturation" | "nonlinear gain" => {
            let series = match draw.pick(&[0, 1, 2], 0) {
                0 => draw.sine(period, n),
                1 => draw.steps(period, n),
                _ => {
                    let time_constant_s = time(draw, 0.1, 1.0);
                    scaled(&draw.series(Disturbance::Ar1 { sd: 1.0, time_constant_s }, n), 1.0)
                }
            };
            if draw.chance(0.5) {
                drive.sp = series.iter().map(|x| x * size * unit).collect();
                return Some(drive);
            }
            series
        }
        _ => return Some(drive),
    };
    let load: Vec<f64> = load.iter().map(|x| x * size).collect();
    // Of the disturbances that are not loads by name, 40 % act on PV directly.
    if !kind.starts_with("load") && draw.chance(0.4) {
        drive.pv = load.iter().map(|x| x * unit).collect();
    } else {
        drive.load = load;
    }
    Some(drive)
}

/// Sets limits of OP or the valve that a run without them would exceed: the middle `share` of the travel remains.
fn saturate(draw: &mut Draw, rig: &mut Rig, drive: &Drive) {
    let run = rig.run(drive, 0.0, 0);
    let (most, least) =
        (run.op.iter().copied().fold(f64::MIN, f64::max), run.op.iter().copied().fold(f64::MAX, f64::min));
    let (up, down) = (draw.between(0.2, 0.8), draw.between(0.2, 0.8));
    let high = rig.rest_op + up * (most - rig.rest_op).max(0.5);
    let low = if draw.chance(0.5) { rig.rest_op + down * (least - rig.rest_op).min(-0.5) } else { 0.0 };
    if draw.chance(0.6) {
        (rig.op_min, rig.op_max) = (low, high);
    } else {
        (rig.valve.travel_min, rig.valve.travel_max) = (low, high);
    }
}

/// The valve of a sticking loop, and its law for a pilot run.
pub(super) fn sticking_valve(draw: &mut Draw, law: ValveLaw, dead_band: bool, period: f64) -> (ValveModel, ValveModel) {
    let fs = draw.log_between(0.6, 6.0);
    let fd = if dead_band { fs } else { fs * draw.between(0.05, 0.95) };
    let as_law = if law == ValveLaw::Physical { ValveLaw::Tracking } else { law };
    let valve = ValveModel { law: as_law, fs, fd, ..ValveModel::HEALTHY };
    (ValveModel { law, friction: physical(draw, fs, fd, period), ..valve }, valve)
}

/// One loop, recorded for `windows` times the length of one window; `number` cycles through the kinds. `None` if the draw is
/// not a valid case.
pub(super) fn attempt(draw: &mut Draw, sticks: bool, number: u64, windows: usize) -> Option<TruthLoop> {
    let mut plan = Plan::new(draw);
    plan.n *= windows;
    let period = plan.scan_period();
    let mut kind = KINDS[(number % KINDS.len() as u64) as usize];
    let alone = matches!(kind, "tight tuning" | "too much integral" | "noise only");
    if sticks && (alone || draw.chance(0.25)) {
        kind = LIMIT_CYCLE;
    }
    let rings = cause(kind) == "tuning";
    let dead_band = sticks && draw.chance(0.15);
    let process_kind = match () {
        // A dead band causes a cycle only with two integrations in the loop.
        () if dead_band && (kind == LIMIT_CYCLE || draw.chance(0.4)) => 3,
        () if rings => draw.pick(&[1, 2, 3], 1),
        () => draw.pick(&[0, 1, 2, 3], 1),
    };
    let ratio = if rings { 1.0 } else { draw.log_between(0.1, 1.0) };
    let process = process(draw, process_kind, period, ratio)?;
    let tight = draw.log_between(0.08, 0.55);
    let (kc, mut ti, td, mut ringing) = tune(draw, &process, if rings { 1.0 } else { tight })?;
    let mut rig = Rig { process, kc, ti, td, valve: ValveModel::HEALTHY, ..Rig::AT_REST };
    rig.rest_op = draw.between(25.0, 75.0);
    rig.rest_pv = rig.pv_per_op(period) * draw.between(20.0, 200.0);
    if kind == "too much integral" {
        ti *= draw.between(0.15, 0.4);
        (rig.ti, rig.td) = (ti, 0.0);
        (rig.kc, ringing) = super::rig::ultimate(&process, ti, 0.0)?;
    }
    if rings && !tighten(&mut rig, ringing, draw.log_between(0.08, 0.9)) {
        return None;
    }
    let settling = (10.0 * ringing + 5.0 * rig.ti).clamp(100.0, 5_000.0) as usize;
    if !rings && rig.ringing(settling) > 0.5 {
        return None;
    }

    // The valve, and the size of the disturbance.
    let (mut start, mut size) = (0.0, draw.log_between(1.0, 10.0));
    let mut disturbance = size;
    if sticks {
        let law = draw.pick(
            &[ValveLaw::He, ValveLaw::He, ValveLaw::Tracking, ValveLaw::Tracking, ValveLaw::Physical],
            ValveLaw::He,
        );
        let (valve, as_law) = sticking_valve(draw, law, dead_band, period);
        rig.valve = as_law;
        match cycling(rig, draw, period) {
            Some((found, _, from)) => (rig, start) = (found, from),
            None if kind == LIMIT_CYCLE => return None,
            None => {}
        }
        rig.valve = valve;
        let set_point = kind.starts_with("sp ") || matches!(kind, "op saturation" | "nonlinear gain");
        disturbance = if set_point { draw.between(0.5, 4.0) } else { draw.between(0.05, 1.8) };
        size = disturbance * valve.fs;
    }
    if matches!(kind, LIMIT_CYCLE | "noise only") {
        (disturbance, size) = (0.0, 0.0);
    }
    let mut drive = drive(draw, kind, &rig, size, period, plan.scans())?;
    let offset = start * rig.pv_per_op(period);
    drive.sp.iter_mut().for_each(|sp| *sp += offset);
    if kind == "nonlinear gain" {
        rig.curvature = draw.between(0.3, 1.0) / size.max(1.0);
    }
    if kind == "op saturation" {
        saturate(draw, &mut rig, &drive);
    }

    // The noise is relative to PV's spread without it; without a disturbance, it is set by its effect on OP.
    let calm = rig.run(&drive, 0.0, 0).thinned(plan.from, 1);
    let share = if kind == "noise only" { 1.0 } else { draw.log_between(0.01, 0.4) };
    let noise_sd = if kind == "noise only" { draw.log_between(0.1, 2.0) / rig.kc } else { share * std_dev(&calm.pv) };
    let run = rig.run(&drive, noise_sd, draw.seed());
    let seen = run.thinned(plan.from, 1);
    let travel = span(&seen.op);
    if !run.is_finite() || !(0.05..=80.0).contains(&travel) || noise_sd <= 0.0 {
        return None;
    }
    let (s, j) = if sticks { bands(&rig.valve) } else { (0.0, 0.0) };
    if sticks && !shows_stiction(&rig.valve, &seen) {
        return None;
    }
    let stored = plan.store(draw, &run);
    let straight = drive.load.iter().chain(&drive.pv).all(|x| *x == 0.0) && rig.curvature == 0.0;
    let known = plan.record_kind == "raw" && straight && rig.valve.law != ValveLaw::Physical;
    let ts_s = draw.pick(&[0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 30.0, 60.0], 1.0);
    let recorded = rig.stretched(1.0 / plan.every as f64);
    Some(TruthLoop {
        op: stored.op,
        pv: stored.pv,
        sp: stored.sp,
        mv: stored.mv,
        ts_s,
        noise_sd,
        floor_sd: known.then_some(noise_sd),
        sticks,
        law: law_name(rig.valve.law),
        s: sticks.then_some(s),
        j: sticks.then_some(j),
        process: recorded.process,
        controller: recorded.settings(ts_s),
        travel: [rig.valve.travel_min, rig.valve.travel_max],
        seed: 0,
        kind,
        process_kind: PROCESS_KINDS[process_kind],
        record_kind: plan.record_kind,
        cause: if sticks { "valve" } else { cause(kind) },
        regime: "verdict",
        noise_share: share,
        period: if rings { ringing / plan.every as f64 } else { plan.period },
        disturbance,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::truth::{Half, verdict_case};
    use std::collections::BTreeMap;

    #[test]
    fn every_kind_process_and_record_is_reached_and_half_the_loops_stick() {
        let mut seen: BTreeMap<(&str, &str), usize> = BTreeMap::new();
        let mut sticking = 0;
        for seed in 0..240 {
            let found = verdict_case(Half::Report, seed);
            let healthy = if found.sticks { "sticking" } else { "healthy" };
            *seen.entry((healthy, found.kind)).or_default() += 1;
            *seen.entry(("process", found.process_kind)).or_default() += 1;
            *seen.entry(("record", found.record_kind)).or_default() += 1;
            *seen.entry(("law", found.law)).or_default() += 1;
            *seen.entry(("cause", found.cause)).or_default() += 1;
            sticking += usize::from(found.sticks);
            assert!((299..=2_000).contains(&found.pv.len()), "{}", found.pv.len());
            assert_eq!(
                (found.op.len(), found.sp.len(), found.mv.len()),
                (found.pv.len(), found.pv.len(), found.pv.len())
            );
            assert_eq!(found.sticks, found.s.is_some());
        }
        assert_eq!(sticking, 120);
        assert!(KINDS.iter().all(|kind| seen.contains_key(&("healthy", *kind))));
        assert!(seen.contains_key(&("sticking", LIMIT_CYCLE)));
        assert!(PROCESS_KINDS.iter().all(|kind| seen.contains_key(&("process", *kind))));
        assert!(RECORD_KINDS.iter().all(|kind| seen.contains_key(&("record", *kind))));
        assert!(["none", "he", "tracking", "physical"].iter().all(|law| seen.contains_key(&("law", *law))));
    }

    #[test]
    fn a_healthy_valve_stands_where_op_does() {
        let mut checked = 0;
        for seed in (0..200).step_by(2) {
            let found = verdict_case(Half::Calibration, seed);
            if found.record_kind != "raw" && found.record_kind != "decimated" {
                continue;
            }
            let [low, high] = found.travel;
            assert!(found.op.iter().zip(&found.mv).all(|(op, mv)| op.clamp(low, high) == *mv), "{}", found.kind);
            checked += 1;
        }
        assert!(checked > 15);
    }
}
