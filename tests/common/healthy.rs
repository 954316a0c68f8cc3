//! Healthy loops at a known distance from their stability limit.
#![allow(missing_docs, dead_code)]
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use core::f64::consts::PI;

use super::Draw;
use stictiond::record::Record;
use stictiond::sim::closed_loop::{ClosedLoop, LoopModel, ValveModel};
use stictiond::sim::controller::{Action, Pid, PidSettings};
use stictiond::sim::disturbance::Disturbance;
use stictiond::sim::process::{ProcessModel, ProcessState};

/// Ultimate gain and period (s) under PI control, by bisection of the open loop's phase.
pub fn ultimate(p: &ProcessModel, ti: f64) -> (f64, f64) {
    let own = |w: f64| if p.integrating { 0.5 * PI } else { (w * p.tau).atan() };
    let phase = |w: f64| -w * (p.dead_time + 0.5) - own(w) - (w * p.tau2).atan() - 0.5 * PI + (w * ti).atan();
    let (mut lo, mut hi) = (1e-4_f64, 3.0_f64);
    for _ in 0..100 {
        let w = (lo * hi).sqrt();
        if phase(w) > -PI { lo = w } else { hi = w }
    }
    let first = if p.integrating { lo } else { (1.0 + (lo * p.tau).powi(2)).sqrt() };
    let process = p.gain.abs() / first / (1.0 + (lo * p.tau2).powi(2)).sqrt();
    (1.0 / (process * (1.0 + (lo * ti).powi(-2)).sqrt()), 2.0 * PI / lo)
}

/// A healthy loop at one sample a second around OP 50, PV 80, without load.
pub fn plain(process: ProcessModel, kc: f64, ti_s: f64) -> LoopModel {
    let action = if process.gain > 0.0 { Action::Reverse } else { Action::Direct };
    let controller = PidSettings { kc, ti_s, td_s: 0.0, action, op_min: 0.0, op_max: 100.0, op_resolution: 0.01 };
    LoopModel {
        ts_s: 1.0,
        process,
        rest_op: 50.0,
        rest_pv: 80.0,
        controller,
        valve: ValveModel::HEALTHY,
        pv_noise_sd: 0.05,
        load: vec![],
        pv_disturbance: vec![],
    }
}

/// `n` samples of a loop that has run for 1500 before.
pub fn settled(model: LoopModel, seed: u64, sp: f64, n: usize) -> Record {
    let mut closed = ClosedLoop::new(model, -1500.0, sp, seed);
    closed.record(1500, sp);
    closed.record(n, sp)
}

/// A loop drawn at random, one in five integrating, under random load, at a share of its ultimate gain; and its
/// ultimate period, s.
pub fn drawn(seed: u64, share: [f64; 2], load: impl FnOnce(f64, f64) -> Vec<Disturbance>) -> (LoopModel, f64) {
    let mut d = Draw::new(seed * 131 + 5);
    let integrating = seed % 5 == 4;
    let tau = libm::exp(d.between(libm::log(8.0), libm::log(50.0)));
    let process = ProcessModel {
        gain: if integrating { d.between(0.02, 0.1) } else { d.between(0.4, 2.5) },
        tau: if integrating { 0.0 } else { tau },
        tau2: if seed.is_multiple_of(2) { 0.0 } else { tau * d.between(0.1, 0.5) },
        dead_time: d.between(2.0, 15.0).round(),
        integrating,
    };
    let ti_s = if integrating { process.dead_time * d.between(6.0, 12.0) } else { tau * d.between(0.7, 1.5) };
    let (gain, period) = ultimate(&process, ti_s);
    let mut load = load(d.between(1.0, 4.0), period * d.between(0.7, 3.0));
    load.push(Disturbance::Ar1 { sd: d.between(0.1, 0.6), time_constant_s: d.between(10.0, 60.0) });
    let kc = d.between(share[0], share[1]) * gain;
    (LoopModel { load, ..plain(process, kc, ti_s) }, period)
}

/// About twenty periods of what makes such a loop swing: its load, given an amplitude and a period, or itself.
pub fn healthy(seed: u64, share: [f64; 2], load: impl FnOnce(f64, f64) -> Vec<Disturbance>) -> Record {
    let (model, own) = drawn(seed, share, load);
    let swing = match model.load.first() {
        Some(Disturbance::Sine { period_s, .. } | Disturbance::Square { period_s, .. }) => *period_s,
        _ => own,
    };
    settled(model, seed, 80.0, ((20.0 * swing) as usize).clamp(600, 3000))
}

/// A sane loop that a cycle outside shakes whose periods vary by `jitter`: a square wave or a sine at the process
/// input, beside random load.
pub fn shaken(seed: u64, jitter: f64, square: bool) -> Record {
    let (model, own) = drawn(seed, [0.2, 0.5], |_, _| vec![]);
    let mut d = Draw::new(seed + 77);
    let (amplitude, period) = (d.between(1.0, 4.0), own * d.between(0.7, 3.0));
    let mut process = ProcessState::at_rest(model.process, 0.0);
    let mut pid = Pid::bumpless(model.controller, 50.0, 80.0, 80.0);
    let (mut op, mut load, mut phase, mut rate, mut random) = (50.0, 0.0, 0.0_f64, 1.0 / period, 0.0);
    let (mut ops, mut pvs) = (vec![], vec![]);
    for k in 0..((20.0 * period) as usize).clamp(600, 3000) + 500 {
        let pv = 80.0 + process.step(op - 50.0 + load, 0.0) + 0.05 * d.normal();
        op = pid.step(80.0, pv, 1.0);
        phase += rate;
        if phase >= 1.0 {
            phase -= 1.0;
            rate = 1.0 / (period * (1.0 + jitter * d.normal()).max(0.3));
        }
        random = 0.97 * random + 0.07 * d.normal();
        let wave = libm::sin(2.0 * PI * phase);
        load = random + amplitude * if square { wave.signum() } else { wave };
        if k >= 500 {
            ops.push(op);
            pvs.push(pv);
        }
    }
    Record::uniform(1.0, ops, pvs)
}
