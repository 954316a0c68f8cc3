//! Compares whole gap documents of simulated loops byte for byte.
//!
//! `REMAKE=1 cargo test -p stiction-lab --test proof gap_golden` rewrites them.

use std::fs;
use std::path::Path;

use stiction::core::detect::oscillation;
use stiction::core::gap::calibration::Calibration;
use stiction::core::gap::document::GapDocument;
use stiction::core::gap::{GapOptions, Serial, diagnose};
use stiction::core::record::Record;
use stiction::core::sim::actuator::Actuator;
use stiction::core::sim::closed_loop::{ClosedLoop, LoopModel, ValveLaw, ValveModel};
use stiction::core::sim::controller::{Action, PidSettings};
use stiction::core::sim::disturbance::Disturbance;
use stiction::core::sim::process::ProcessModel;
use stiction_lab::calibrate_gap::search_id;
use stiction_lab::truth::fixture::Draw;

/// A sticking valve in front of a first-order process.
fn plain() -> LoopModel {
    LoopModel {
        ts_s: 1.0,
        process: ProcessModel { gain: 1.0, tau: 11.0, tau2: 0.0, dead_time: 3.4, integrating: false },
        rest_op: 50.0,
        rest_pv: 80.0,
        controller: PidSettings {
            kc: 0.9,
            ti_s: 11.0,
            td_s: 0.0,
            action: Action::Reverse,
            op_min: 0.0,
            op_max: 100.0,
            op_resolution: 0.0,
        },
        valve: ValveModel { law: ValveLaw::He, fs: 2.2, fd: 0.9, ..ValveModel::HEALTHY },
        pv_noise_sd: 0.06,
        load: vec![],
        pv_disturbance: vec![],
    }
}

/// 500 scans with set-point moves.
fn record(model: LoopModel) -> Record {
    let mut d = Draw::new(29);
    let mut sp = model.rest_pv;
    let mut closed = ClosedLoop::new(model, 0.0, sp, 3);
    let (mut op, mut pv, mut set) = (vec![], vec![], vec![]);
    for k in 0..500 {
        if k % 170 == 60 {
            sp = 80.0 + d.between(-4.0, 4.0);
        }
        let scan = closed.step(sp);
        op.push(scan.op);
        pv.push(scan.pv);
        set.push(scan.sp);
    }
    Record { sp: Some(set), ..Record::uniform(1.0, op, pv) }
}

fn held(name: &str, model: LoopModel) {
    let record = record(model);
    let period = oscillation::detect(&record.op(), &record.pv).map(|o| o.period_points);
    let options = GapOptions { period_points: period, ..GapOptions::default() };
    let diagnosis = diagnose(&record, &options, &Serial).unwrap();
    let document = GapDocument::new(name, &record, &options, &diagnosis);
    let text = serde_json::to_string_pretty(&document).unwrap() + "\n";
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../stiction/tests/golden/gap-{name}.json"));
    if std::env::var_os("REMAKE").is_some() {
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(&path, &text).unwrap();
    }
    let golden = fs::read_to_string(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    let first = golden.lines().zip(text.lines()).enumerate().find(|(_, (a, b))| a != b);
    assert!(golden == text, "{}: the first line that differs is {first:?}", path.display());
}

#[test]
fn a_loop_like_the_base() {
    held("base", plain());
}

#[test]
fn play_behind_the_stem() {
    let mut model = plain();
    model.valve.actuator = Actuator { play: 1.6, ..Actuator::NONE };
    held("backlash", model);
}

#[test]
fn a_sinusoid_from_outside() {
    let mut model = plain();
    model.pv_disturbance.push(Disturbance::Sine { amplitude: 0.5, period_s: 37.0, phase_deg: 20.0 });
    held("sinusoid", model);
}

#[test]
fn the_calibration_is_of_this_search() {
    let (of, now) = (&Calibration::shipped().search, search_id().unwrap());
    assert!(
        *of == now,
        "the probabilities of `gap` are of search {of}, the search is {now}: answer a development set (`stiction-lab challenge \
         new`, `run`) and fit them again (`challenge calibrate`); where fresh loops show that they still hold, name {now} in \
         calibration.json"
    );
}
