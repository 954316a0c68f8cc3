//! Benefit of a repair, predicted from a record and compared with the simulated truth. `--nocapture` prints the figures of
//! docs/plant.md.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use crate::cases;
use stiction::core::record::Record;
use stiction::core::signal::stats;
use stiction::core::sim::closed_loop::{ClosedLoop, LoopModel, ValveLaw, ValveModel};
use stiction::core::sim::controller::{Action, PidSettings};
use stiction::core::sim::disturbance::Disturbance;
use stiction::core::sim::process::ProcessModel;
use stiction::core::verdict::{AssessParams, assess};
use stiction::repair::{Figure, NoRepair, Repair, RepairParams, repair};
use stiction_lab::truth::fixture::Draw;

const SAMPLES: usize = 1_200;
const SETTLES: usize = 1_200;

/// A well-tuned loop with a limit cycle from its valve.
fn drawn(seed: u64) -> LoopModel {
    let mut d = Draw::new(seed.wrapping_mul(104_729).wrapping_add(17));
    let tau = libm::exp(d.between(libm::log(8.0), libm::log(25.0)));
    let dead_time = d.between(2.0, 6.0);
    let integrating = seed % 5 == 4;
    let sign = if d.uniform() < 0.5 { 1.0 } else { -1.0 };
    let gain = sign * if integrating { d.between(0.02, 0.1) } else { d.between(0.5, 2.5) };
    let tight = d.between(0.2, 0.5);
    let kc = if integrating {
        tight / (gain.abs() * (dead_time + 2.0))
    } else {
        tight * tau / (dead_time + 2.0) / gain.abs()
    };
    let fs = d.between(1.0, 4.0);
    let law = if seed.is_multiple_of(2) { ValveLaw::He } else { ValveLaw::Tracking };
    let swing = gain.abs() * fs * if integrating { 20.0 } else { 1.0 };
    LoopModel {
        ts_s: 1.0,
        process: ProcessModel { gain, tau: if integrating { 0.0 } else { tau }, tau2: 0.0, dead_time, integrating },
        rest_op: 50.0,
        rest_pv: 80.0,
        controller: PidSettings {
            kc,
            ti_s: if integrating { 10.0 * (dead_time + 2.0) } else { tau * d.between(0.7, 1.5) },
            td_s: 0.0,
            action: if gain > 0.0 { Action::Reverse } else { Action::Direct },
            op_min: 0.0,
            op_max: 100.0,
            op_resolution: 0.0,
        },
        valve: ValveModel { law, fs, fd: fs * d.between(0.1, 0.8), ..ValveModel::HEALTHY },
        pv_noise_sd: d.between(0.01, 0.05) * swing,
        load: vec![Disturbance::Ar1 { sd: d.between(0.05, 0.2) * fs, time_constant_s: d.between(10.0, 60.0) }],
        pv_disturbance: vec![],
    }
}

/// A record of the loop after its transient.
fn recorded(model: &LoopModel, seed: u64) -> Record {
    let start = 1.2 * model.valve.fs * if model.process.integrating { 10.0 } else { 1.0 } * model.process.gain;
    let mut closed = ClosedLoop::new(model.clone(), 0.0, 80.0 + start, seed);
    closed.record(SETTLES, 80.0 + start);
    closed.record(SAMPLES, 80.0 + start)
}

fn told(record: &Record) -> Result<Repair, NoRepair> {
    repair(
        record,
        &assess(record, &AssessParams { always_fit: true, ..AssessParams::default() }),
        &RepairParams::default(),
    )
}

/// How often an interval contains the truth, and the errors of the values.
#[derive(Default)]
struct Score {
    held: usize,
    all: usize,
    off: Vec<f64>,
    wide: Vec<f64>,
}

impl Score {
    fn add(&mut self, figure: &Figure, truth: f64) {
        let [low, high] = figure.interval;
        self.all += 1;
        self.held += usize::from((low..=high).contains(&truth));
        self.off.push(libm::log(figure.value / truth).abs());
        self.wide.push(high / low);
    }

    fn print(&self, name: &str) {
        let off = 100.0 * libm::expm1(stats::median(&self.off));
        let wide = stats::median(&self.wide);
        println!(
            "{name}: {} of {} held, off by {off:.0} % in the middle, intervals {wide:.2} wide (high over low)",
            self.held, self.all
        );
    }

    fn share(&self) -> f64 {
        self.held as f64 / self.all as f64
    }
}

#[test]
fn what_a_repair_buys_is_foretold() {
    let [mut now, mut fixed, mut slow, mut travel, mut turns] = [(); 5].map(|()| Score::default());
    let mut refused = 0;
    let each = cases(20, 50);
    for seed in 0..each {
        let model = drawn(seed);
        let record = recorded(&model, seed);
        let told = match told(&record) {
            Ok(told) => told,
            Err(why) => {
                println!("{seed}: {why}");
                refused += 1;
                continue;
            }
        };
        // Another section of the same plant, with other noise.
        let healthy = LoopModel { valve: ValveModel::HEALTHY, ..model.clone() };
        let halved = PidSettings { kc: 0.5 * model.controller.kc, ..model.controller };
        let half = LoopModel { controller: halved, ..model.clone() };
        let [same, healthy, half] = [&model, &healthy, &half].map(|m| recorded(m, seed + 1_000));
        now.add(&told.now.pv_sd, stats::std_dev(&same.pv));
        fixed.add(&told.repaired.pv_sd, stats::std_dev(&healthy.pv));
        slow.add(&told.half_gain.pv_sd, stats::std_dev(&half.pv));
        let off = |f: &Figure, x: &Record| f.value / stats::std_dev(&x.pv);
        let offs = [(&told.now.pv_sd, &same), (&told.repaired.pv_sd, &healthy), (&told.half_gain.pv_sd, &half)];
        let [a, b, c] = offs.map(|(f, x)| off(f, x));
        println!("{seed}: foretold over true: now {a:.2}, repaired {b:.2}, half the gain {c:.2}");
        let days = SAMPLES as f64 / 86_400.0;
        let stem = healthy.mv.as_deref().unwrap();
        let way: f64 = stem.windows(2).map(|w| (w[1] - w[0]).abs()).sum();
        travel.add(&told.repaired.travel_per_day, way / days);
        turns.add(&told.now.reversals_per_day, stats::turns(same.mv.as_deref().unwrap(), told.turn_op) as f64 / days);
    }
    println!("{refused} of {each} refused");
    now.print("PV's spread now");
    fixed.print("PV's spread repaired");
    slow.print("PV's spread with half the gain");
    travel.print("travel repaired");
    turns.print("turns now");
    // If no stiction is found, or the model does not hold in the rest of the record, no benefit is computed.
    assert!(3 * refused <= 2 * each, "{refused} of {each}");
    for score in [&now, &fixed, &slow] {
        assert!(score.share() >= 0.75, "{}", score.share());
    }
    // The intervals must also be narrow enough to be useful.
    assert!(stats::median(&fixed.wide) < 8.0 && stats::median(&slow.wide) < 6.0);
}

#[test]
fn where_nothing_sticks_and_the_set_point_rests_no_repair_is_computed() {
    // A tight controller that rings under load, with a frictionless valve.
    let mut model = drawn(0);
    model.process = ProcessModel { gain: 1.0, tau: 15.0, tau2: 6.0, dead_time: 6.0, integrating: false };
    model.controller = PidSettings { kc: 1.5, ti_s: 18.0, td_s: 0.0, action: Action::Reverse, ..model.controller };
    model.valve = ValveModel::HEALTHY;
    model.pv_noise_sd = 0.05;
    model.load = vec![Disturbance::Ar1 { sd: 2.0, time_constant_s: 20.0 }];
    // Under load alone the record fits the controller backwards as well as the process.
    let refusals: Vec<NoRepair> = (0..3).filter_map(|seed| told(&recorded(&model, seed)).err()).collect();
    assert!(refusals.len() == 3 && refusals.contains(&NoRepair::Untested), "{refusals:?}");
}

#[test]
fn what_cannot_be_told_is_refused_in_words() {
    let model = drawn(0);
    let record = recorded(&model, 0);
    let params = AssessParams { always_fit: true, ..AssessParams::default() };
    let found = assess(&record, &params);
    let answer = |change: &dyn Fn(&mut stiction::core::verdict::Assessment)| {
        let mut assessment = found.clone();
        change(&mut assessment);
        repair(&record, &assessment, &RepairParams::default()).unwrap_err()
    };
    assert_eq!(answer(&|a| a.controller = None), NoRepair::NoController);
    assert!(
        answer(&|a| a.controller = None).to_string().contains("the controller cannot be identified from this record")
    );
    assert_eq!(answer(&|a| a.process = None), NoRepair::NoModel);
    assert!(matches!(answer(&|a| a.stiction = None), NoRepair::Inconclusive(_)));
    let signs = |a: &mut stiction::core::verdict::Assessment| a.controller.as_mut().unwrap().kc *= -1.0;
    assert_eq!(answer(&signs), NoRepair::Signs);
    let weak = |a: &mut stiction::core::verdict::Assessment| a.controller.as_mut().unwrap().kc *= 0.1;
    assert!(matches!(answer(&weak), NoRepair::OtherSpread(_) | NoRepair::OtherPace(_)));
    // Equal arguments give equal answers.
    assert_eq!(told(&record), told(&record));
}
