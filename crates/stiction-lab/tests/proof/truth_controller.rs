//! Identification of the controller from records of loops with a known controller.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use stiction::core::ident::controller::{Reading, read};
use stiction::core::record::Record;
use stiction::core::signal::stats;
use stiction::core::sim::closed_loop::{ClosedLoop, LoopModel, ValveLaw, ValveModel};
use stiction::core::sim::controller::{Action, PidSettings};
use stiction::core::sim::disturbance::Disturbance;
use stiction::core::sim::process::ProcessModel;
use stiction_lab::truth::fixture::{Draw, boxed};

/// A random well-tuned loop: every second one with derivative action, and with a sticking valve and coarse output in turn.
fn drawn(seed: u64) -> LoopModel {
    let mut d = Draw::new(seed.wrapping_mul(7919));
    let ts_s = [0.5, 1.0, 5.0][seed as usize % 3];
    let tau = libm::exp(d.between(libm::log(5.0), libm::log(40.0)));
    let dead_time = d.between(1.0, 8.0).round();
    let gain = d.between(0.4, 2.5) * if d.uniform() < 0.5 { 1.0 } else { -1.0 };
    let process = ProcessModel { gain, tau, tau2: tau * d.between(0.0, 0.4), dead_time, integrating: false };
    let derivative = seed % 2 == 1;
    let controller = PidSettings {
        kc: d.between(0.3, 0.6) * tau / (dead_time + 1.0 + process.tau2) / gain.abs(),
        ti_s: tau * d.between(0.6, 1.5) * ts_s,
        td_s: if derivative { d.between(1.0, 4.0) * ts_s } else { 0.0 },
        action: if gain > 0.0 { Action::Reverse } else { Action::Direct },
        op_min: 0.0,
        op_max: 100.0,
        op_resolution: [0.0, 0.01, 0.1][seed as usize / 2 % 3],
    };
    let fs = d.between(1.0, 4.0);
    let sticking = ValveModel { law: ValveLaw::He, fs, fd: fs * d.between(0.1, 0.9), ..ValveModel::HEALTHY };
    LoopModel {
        ts_s,
        process,
        rest_op: 50.0,
        rest_pv: 80.0,
        controller,
        valve: if seed % 4 < 2 { sticking } else { ValveModel::HEALTHY },
        pv_noise_sd: gain.abs() * libm::exp(d.between(libm::log(0.01), libm::log(0.2))),
        load: vec![Disturbance::Ar1 { sd: 0.5, time_constant_s: 30.0 * ts_s }],
        pv_disturbance: vec![],
    }
}

/// 1200 samples with OP stamped `skew` samples late.
fn skewed(record: &Record, skew: isize) -> Record {
    let n = record.len() as isize;
    let (from, to) = (skew.max(0), n + skew.min(0));
    let op = (from..to).map(|k| record.op_path[(k - skew) as usize]).collect();
    let pv = record.pv[from as usize..to as usize].to_vec();
    Record::uniform(record.ts_s, op, pv)
}

#[test]
fn lag_gain_and_times_are_the_simulated_ones() {
    let (mut right, mut kc, mut ti, mut td) = (0, vec![], vec![], vec![]);
    for seed in 0..40 {
        let model = drawn(seed);
        let settings = model.controller;
        let record = ClosedLoop::new(model, 0.0, 81.0, seed).record(1200, 81.0);
        let skew = (seed % 4) as isize - 1;
        let found = read(&skewed(&record, skew));
        println!("{seed} skew {skew} {settings:?}\n   {found:?}");
        let Some(Reading { kc: k, ti_s, td_s, lag_samples, .. }) = found else { continue };
        right += usize::from(lag_samples == skew as f64);
        let gain = if settings.action == Action::Reverse { settings.kc } else { -settings.kc };
        kc.push((k / gain - 1.0).abs());
        ti.push((ti_s / settings.ti_s - 1.0).abs());
        if settings.td_s > 0.0 {
            td.push((td_s / settings.td_s - 1.0).abs());
        }
    }
    println!(
        "right lag {right} of 40, median errors: Kc {}, Ti {}, Td {}",
        stats::median(&kc),
        stats::median(&ti),
        stats::median(&td)
    );
    println!(
        "90 %: Kc {}, Ti {}, Td {}",
        stats::quantile(&kc, 0.9),
        stats::quantile(&ti, 0.9),
        stats::quantile(&td, 0.9)
    );
    assert!(right >= 38, "right lag in {right} of 40");
    assert!(stats::median(&kc) < 0.05 && stats::median(&ti) < 0.05 && stats::median(&td) < 0.1);
}

#[test]
fn nothing_is_read_where_no_controller_acts() {
    for seed in 0..20 {
        let mut d = Draw::new(seed);
        // OP and PV from two independent loops.
        let one = ClosedLoop::new(drawn(seed), 0.0, 81.0, seed).record(1200, 81.0);
        let mut other = ClosedLoop::new(drawn(seed + 100), 0.0, 81.0, seed + 100).record(1200, 81.0);
        other.op_path = one.op_path;
        other.sp = None;
        let unrelated = read(&other);
        // A person moves OP occasionally.
        let mut closed = ClosedLoop::new(drawn(seed), 0.0, 81.0, seed);
        let (mut op, mut pv) = (vec![], vec![]);
        for k in 0..1200 {
            if k % 80 == 0 {
                closed.set_manual(Some(d.between(45.0, 55.0)));
            }
            let scan = closed.step(81.0);
            op.push(scan.op);
            pv.push(scan.pv);
        }
        let manual = read(&Record::uniform(1.0, op, pv));
        assert_eq!((unrelated, manual), (None, None), "seed {seed}");
    }
}

/// A PI loop of the seed, without derivative, and the sign of its gain.
fn proportional(seed: u64) -> (LoopModel, f64) {
    let mut model = drawn(2 * seed);
    model.controller.op_resolution = 0.0;
    let sign = if model.controller.action == Action::Reverse { 1.0 } else { -1.0 };
    (model, sign)
}

/// Median errors of Kc and Ti over ten loops, and how many controllers were identified.
fn errors(make: impl Fn(LoopModel, u64) -> Record) -> (usize, f64, f64) {
    let (mut kc, mut ti) = (vec![], vec![]);
    for seed in 0..10 {
        let (model, sign) = proportional(seed);
        let settings = model.controller;
        let Some(found) = read(&make(model, seed)) else { continue };
        kc.push((sign * found.kc / settings.kc - 1.0).abs());
        ti.push((found.ti_s / settings.ti_s - 1.0).abs());
    }
    (kc.len(), stats::median(&kc), stats::median(&ti))
}

#[test]
fn saturation_filters_coarse_output_and_boxes_are_survived() {
    let clipped = errors(|mut model, seed| {
        (model.controller.op_min, model.controller.op_max) = (49.0, 51.5);
        ClosedLoop::new(model, 0.0, 80.5, seed).record(1200, 80.5)
    });
    let coarse = errors(|mut model, seed| {
        model.controller.op_resolution = 0.2;
        ClosedLoop::new(model, 0.0, 81.0, seed).record(1200, 81.0)
    });
    let filtered = errors(|model, seed| {
        let mut record = ClosedLoop::new(model, 0.0, 81.0, seed).record(1200, 81.0);
        // The controller filters PV over two samples before using it; the recorded PV is not filtered.
        let mut x = record.pv[0];
        let mut raw = Vec::new();
        for pv in &record.pv {
            raw.push(3.0 * pv - 2.0 * x);
            x = *pv;
        }
        record.pv = raw;
        record
    });
    let boxed = errors(|model, seed| {
        let record = ClosedLoop::new(model, 0.0, 81.0, seed).record(4800, 81.0);
        boxed(record.ts_s, &record.op_path, &record.pv, 4)
    });
    println!("clipped {clipped:?}, coarse {coarse:?}, filtered {filtered:?}, boxed {boxed:?}");
    // If the noise in OP is a tenth of its steps, no lag leads, and no controller is identified.
    for ((read, kc, ti), least) in [(clipped, 8), (coarse, 6), (filtered, 9)] {
        assert!(read >= least && kc < 0.05 && ti < 0.05, "{read} of 10: {kc} {ti}");
    }
    // Means over bins hide part of the response: fewer controllers are identified, but not wrongly.
    assert!(boxed.1 < 0.2 && boxed.2 < 0.2, "{boxed:?}");
}
