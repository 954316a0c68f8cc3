//! Compares the simulated loop with the plant that generated the record.

use super::plant::Known;
use super::*;
use crate::core::sim::closed_loop::{ClosedLoop, LoopModel, ValveLaw, ValveModel};
use crate::core::sim::controller::{Action, PidSettings};
use crate::core::sim::process::ProcessModel;
use crate::core::verdict::{AssessParams, Controller, Process, assess};

const NOISE: f64 = 0.05;
const SECOND_ORDER: ProcessModel = ProcessModel { gain: 1.8, tau: 22.0, tau2: 9.0, dead_time: 5.4, integrating: false };

fn plant(valve: ValveModel) -> LoopModel {
    let controller = PidSettings {
        kc: 0.7,
        ti_s: 18.0,
        td_s: 0.0,
        action: Action::Reverse,
        op_min: 0.0,
        op_max: 100.0,
        op_resolution: 0.0,
    };
    LoopModel {
        ts_s: 1.0,
        process: SECOND_ORDER,
        rest_op: 50.0,
        rest_pv: 60.0,
        controller,
        valve,
        pv_noise_sd: NOISE,
        load: vec![],
        pv_disturbance: vec![],
    }
}

/// A settled stretch of the loop.
fn recorded(model: &LoopModel) -> Record {
    let mut closed = ClosedLoop::new(model.clone(), 0.0, 60.0, 1);
    closed.record(2000, 61.0);
    closed.record(1500, 61.0)
}

fn sticking() -> ValveModel {
    ValveModel { law: ValveLaw::He, fs: 4.0, fd: 2.0, ..ValveModel::HEALTHY }
}

/// An assessment with the loop's true parameters.
fn truth(record: &Record) -> Assessment {
    let ProcessModel { gain, tau, tau2, dead_time, integrating } = SECOND_ORDER;
    let controller = Controller { kc: 0.7, ti_s: 18.0, td_s: 0.0, lag_samples: 0.0, r2: 1.0, unexplained: 0.0 };
    let process = Process {
        order: 2,
        gain,
        time_constants_s: vec![tau, tau2],
        dead_time_s: dead_time,
        integrating,
        mse: NOISE * NOISE,
        fit_pct: 99.0,
        tested: true,
        gain_interval: None,
        dead_time_interval_s: None,
    };
    let found = assess(record, &AssessParams { always_fit: true, ..AssessParams::default() });
    Assessment {
        stiction: Some(true),
        fs: Some(4.0),
        fd: Some(2.0),
        s_interval: Some([5.9, 6.1]),
        j_interval: Some([1.9, 2.1]),
        j_identifiable: Some(true),
        process: Some(process),
        controller: Some(controller),
        ..found
    }
}

#[test]
fn the_plant_leaves_the_noise_only_with_its_second_lag_and_its_dead_time() {
    let record = recorded(&plant(sticking()));
    let assessment = truth(&record);
    let known = Known::of(&record, &assessment).unwrap();
    let shape = known.shape();
    let fitted = known.plant(shape).unwrap();
    assert!((fitted.shape.process.gain / SECOND_ORDER.gain - 1.0).abs() < 0.01, "{}", fitted.shape.process.gain);
    assert!(fitted.mse.sqrt() < 1.1 * NOISE, "{}", fitted.mse.sqrt());
    let process = shape.process;
    for wrong in [
        ProcessModel { tau2: 0.0, ..process },
        ProcessModel { dead_time: 0.0, ..process },
        ProcessModel { dead_time: process.dead_time + 1.0, ..process },
    ] {
        let other = known.plant(super::plant::Shape { process: wrong, ..shape }).unwrap();
        assert!(other.mse > 1.5 * fitted.mse, "{wrong:?}: {} {}", other.mse, fitted.mse);
    }
}

#[test]
fn the_loop_behaves_as_its_plant_with_the_valve_stuck_and_repaired() {
    let model = plant(sticking());
    let record = recorded(&model);
    let found = repair(&record, &truth(&record), &RepairParams::default()).unwrap();
    let healthy = recorded(&plant(ValveModel::HEALTHY));
    let sd = |record: &Record| crate::core::signal::stats::std_dev(&record.pv);
    let near = |figure: Figure, truth: f64| (figure.value / truth - 1.0).abs() < 0.1;
    assert!(near(found.now.pv_sd, sd(&record)), "{:?} {}", found.now.pv_sd, sd(&record));
    assert!(found.now.oscillates == Some(true) && found.repaired.oscillates == Some(false));
    // Part of the residual may be model error, which a repair would remove, too.
    let repaired = found.repaired.pv_sd.value / sd(&healthy);
    assert!((0.6..1.6).contains(&repaired), "{:?} {}", found.repaired.pv_sd, sd(&healthy));
}
