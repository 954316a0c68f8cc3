//! How much does a valve stick? A loop is simulated, and its record of OP and PV assessed as the daemon would.
//!
//! `cargo run --example quantify`

use stiction::sim::{Action, ClosedLoop, LoopModel, PidSettings, ProcessModel, ValveLaw, ValveModel};
use stiction::{AssessParams, assess};

fn main() {
    let valve = ValveModel { law: ValveLaw::He, fs: 5.0, fd: 3.0, ..ValveModel::HEALTHY };
    let controller = PidSettings {
        kc: 0.8,
        ti_s: 8.0,
        td_s: 0.0,
        action: Action::Reverse,
        op_min: 0.0,
        op_max: 100.0,
        op_resolution: 0.01,
    };
    let model = LoopModel {
        ts_s: 1.0,
        process: ProcessModel { gain: 2.0, tau: 20.0, tau2: 0.0, dead_time: 6.0, integrating: false },
        rest_op: 50.0,
        rest_pv: 60.0,
        controller,
        valve,
        pv_noise_sd: 0.05,
        load: vec![],
        pv_disturbance: vec![],
    };
    let mut plant = ClosedLoop::new(model, 0.0, 60.0, 1);
    plant.record(1800, 61.0);
    // Your own data: Record::uniform(ts_s, op, pv).
    let record = plant.record(1000, 61.0);

    let found = assess(&record, &AssessParams { always_fit: true, ..AssessParams::default() });
    println!("verdict {}, p {:?}", found.verdict.name(), found.p_stiction);
    println!("fs {:?}, fd {:?} (truth: 5, 3)", found.fs, found.fd);
    println!("s {:?} in {:?}", found.s, found.s_interval);
    println!("gates {:?}", found.gates);
}
