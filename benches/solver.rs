//! `cargo bench`: the solver's parts, on simulated loops with known truth.
//!
//! Wall-clock times, for changes on one quiet machine. `stiction-lab bench` measures CPU time.
#![allow(missing_docs, clippy::unwrap_used)]

use divan::{Bencher, black_box};
use stiction::core::detect::{self, View};
use stiction::core::gap::{GapOptions, Serial, diagnose};
use stiction::core::ident::class::Class;
use stiction::core::ident::{Options, controller, evaluator, quantify};
use stiction::core::record::Record;
use stiction::core::signal::stats;
use stiction::core::sim::slips::{FirstSlip, Law, Stroke};
use stiction::core::sim::steps::{Path, Steps};
use stiction::core::verdict::{AssessParams, assess, is_screened_out};
use stiction_lab::truth::{Half, Regime, TruthLoop, accuracy, verdict_case};

fn main() {
    divan::main();
}

fn sticking() -> TruthLoop {
    accuracy(Half::Report, Regime::HeStart, 1)
}

fn calm() -> Record {
    let cases = (0..400).step_by(2).map(|seed| verdict_case(Half::Report, seed).record());
    cases.into_iter().find(|r| r.len() >= 1_000 && is_screened_out(r, &AssessParams::default())).unwrap()
}

/// A valve law's path, bands and first slip, in spans of OP.
fn law_of(found: &TruthLoop) -> (Path, [f64; 2], FirstSlip) {
    let (span, middle) = (stats::span(&found.op), stats::mean(&found.op));
    let path = Path::new(found.op.iter().map(|u| (u - middle) / span).collect(), 1);
    let bands = [found.s.unwrap() / span, found.j.unwrap() / span];
    let first = FirstSlip { direction: 1.0, threshold: path.values()[0] + 0.5 * bands[0] };
    (path, bands, first)
}

#[divan::bench(args = [Law::He, Law::Tracking])]
fn valve_law(bencher: Bencher, law: Law) {
    let (path, bands, first) = law_of(&sticking());
    let mut steps = Steps::default();
    bencher.bench_local(|| steps.run(black_box(&path), path.points(), Stroke::FREE, law, bands, first));
}

#[divan::bench(args = [Class::First, Class::Second, Class::Integrating, Class::LagIntegrating])]
fn evaluator_one_model(bencher: Bencher, class: Class) {
    let found = sticking();
    let (path, bands, first) = law_of(&found);
    let mut steps = Steps::default();
    steps.run(&path, path.points(), Stroke::FREE, Law::He, bands, first);
    let view = evaluator::View::new(&found.pv, 0.0, 60);
    let tables = [view.table(12.0), view.table(4.0)];
    let both = if class == Class::Second { [&tables[0], &tables[1]] } else { [&tables[0], &tables[0]] };
    bencher.bench_local(|| {
        evaluator::reduce(class, &view, both, black_box(&steps.list), 4, &mut evaluator::HeldSums::default())
    });
}

#[divan::bench]
fn evaluator_tables(bencher: Bencher) {
    let view = evaluator::View::new(&sticking().pv, 0.0, 60);
    bencher.bench_local(|| view.table(black_box(12.0)));
}

#[divan::bench]
fn indicators(bencher: Bencher) {
    let record = sticking().record();
    bencher.bench_local(|| {
        let view = View::new(black_box(&record));
        detect::ALL.map(|detector| detector.score(&view))
    });
}

#[divan::bench]
fn controller_reading(bencher: Bencher) {
    let record = sticking().record();
    bencher.bench_local(|| controller::read(black_box(&record)));
}

#[divan::bench]
fn search(bencher: Bencher) {
    let record = sticking().record();
    bencher.bench_local(|| quantify(black_box(&record), &Options::default()));
}

#[divan::bench(args = [Regime::HeStart, Regime::TrackingSetPoint, Regime::HighNoise])]
fn estimate(bencher: Bencher, regime: Regime) {
    let record = accuracy(Half::Report, regime, 1).record();
    let params = AssessParams { always_fit: true, ..AssessParams::default() };
    bencher.bench_local(|| assess(black_box(&record), &params));
}

#[divan::bench]
fn calm_loop_screened(bencher: Bencher) {
    let record = calm();
    bencher.bench_local(|| assess(black_box(&record), &AssessParams::default()));
}

#[divan::bench(sample_count = 3, sample_size = 1)]
fn gap_diagnosis(bencher: Bencher) {
    let record = sticking().record();
    bencher.bench_local(|| diagnose(black_box(&record), &GapOptions::default(), &Serial).unwrap());
}
