//! Costs of the solver and its surroundings: kernels, indicators, whole estimates, a calm loop, general solvers.

use std::path::Path;

use super::{Row, cpu};
use crate::evaluate;
use stiction::core::detect::{self, View};
use stiction::core::ident::class::Class;
use stiction::core::ident::{Options, controller, evaluator};
use stiction::core::optim::{Settings, SolverName};
use stiction::core::record::Record;
use stiction::core::signal::stats;
use stiction::core::sim::slips::{FirstSlip, Law, Stroke};
use stiction::core::sim::steps::{Path as OpPath, Steps};
use stiction::core::verdict::{AssessParams, assess, is_screened_out};
use stiction::toolbox::surface::{BUDGET, Surface, solve};
use stiction_lab::truth::{Half, Regime, TruthLoop, accuracy, verdict_case};

/// Rounds per kernel.
const ROUNDS: usize = 9;
/// Simulated loops per regime for timing whole estimates.
const LOOPS: u64 = 2;

/// Emits every row as soon as it is known.
///
/// # Errors
/// Those of `out`; the labelled recordings cannot be read.
pub fn rows(recordings: Option<&Path>, mut out: impl FnMut(Vec<Row>) -> anyhow::Result<()>) -> anyhow::Result<()> {
    out(kernels(&accuracy(Half::Report, Regime::HeStart, 1)))?;
    out(indicators())?;
    out(calm())?;
    out(estimates())?;
    out(solver())?;
    recordings.map_or(Ok(()), |index| out(labelled(index)?))
}

fn us(name: impl Into<String>, ms: f64) -> Row {
    Row { name: name.into(), value: ms * 1e3, unit: "us" }
}

fn in_ms(name: impl Into<String>, value: f64) -> Row {
    Row { name: name.into(), value, unit: "ms" }
}

/// Valve model and evaluator, for one model.
fn kernels(found: &TruthLoop) -> Vec<Row> {
    let span = stats::span(&found.op);
    let middle = stats::mean(&found.op);
    let path = OpPath::new(found.op.iter().map(|u| (u - middle) / span).collect(), 1);
    let (s, j) = (found.s.unwrap_or(1.0) / span, found.j.unwrap_or(0.0) / span);
    let first = FirstSlip { direction: 1.0, threshold: path.values()[0] + 0.5 * s };
    let (n, mut steps) = (path.points(), Steps::default());
    let law = cpu::ms(ROUNDS, || steps.run(&path, n, Stroke::FREE, Law::He, [s, j], first));
    let view = evaluator::View::new(&found.pv, 0.0, 60);
    let tables = cpu::ms(ROUNDS, || view.table(12.0));
    let table = view.table(12.0);
    let both = [&table, &table];
    let sums = cpu::ms(ROUNDS, || {
        evaluator::reduce(Class::First, &view, both, &steps.list, 4, &mut evaluator::HeldSums::default())
    });
    let of = format!("{n} samples, {} slips", steps.slips);
    vec![
        us(format!("valve law, {of}"), law),
        us(format!("evaluator, one model, {of}"), sums),
        us(format!("evaluator, tables of a time constant, {n} samples"), tables),
    ]
}

/// Indicators and controller identification, over loops of every kind.
fn indicators() -> Vec<Row> {
    let records: Vec<Record> = (0..12).map(|seed| verdict_case(Half::Report, seed).record()).collect();
    let points = stats::median(&records.iter().map(|r| r.len() as f64).collect::<Vec<_>>());
    let over = |call: &dyn Fn(&Record)| {
        let times: Vec<f64> = records.iter().map(|r| cpu::ms(3, || call(r))).collect();
        stats::median(&times)
    };
    let scores = |r: &Record| {
        let view = View::new(r);
        for detector in detect::ALL {
            std::hint::black_box(detector.score(&view));
        }
    };
    let read = |r: &Record| {
        std::hint::black_box(controller::read(r));
    };
    vec![
        in_ms(format!("indicators, median of 12 loops of {points:.0} samples"), over(&scores)),
        in_ms("controller read from the record, same loops", over(&read)),
    ]
}

/// A calm loop with and without screening.
fn calm() -> Vec<Row> {
    let params = AssessParams::default();
    let record = (0..400)
        .step_by(2)
        .map(|seed| verdict_case(Half::Report, seed))
        .filter(|found| matches!(found.kind, "noise only" | "coloured" | "random walk"))
        .map(|found| found.record())
        .find(|record| record.len() >= 1_000 && is_screened_out(record, &params));
    let Some(record) = record else { return Vec::new() };
    let whole = AssessParams { screening: false, ..params.clone() };
    vec![
        in_ms(format!("calm loop of {} samples, screened", record.len()), cpu::ms(ROUNDS, || assess(&record, &params))),
        in_ms("the same without screening", cpu::ms(3, || assess(&record, &whole))),
    ]
}

/// Whole estimates over simulated loops.
fn estimates() -> Vec<Row> {
    let params = AssessParams { always_fit: true, ..AssessParams::default() };
    let loops = Regime::ALL.into_iter().flat_map(|regime| (0..LOOPS).map(move |seed| (regime, seed)));
    let times: Vec<f64> = loops
        .map(|(regime, seed)| {
            let record = accuracy(Half::Report, regime, seed).record();
            cpu::ms(1, || assess(&record, &params))
        })
        .collect();
    let name = |what: &str| format!("estimate, whole document, {} simulated loops: {what}", times.len());
    vec![in_ms(name("median"), stats::median(&times)), in_ms(name("90 %"), stats::quantile(&times, 0.9))]
}

/// Models of a general solver on the error surface.
fn solver() -> Vec<Row> {
    let record = accuracy(Half::Report, Regime::HeStart, 1).record();
    let settings = Settings { budget: BUDGET, fineness_pct: 5.0, seed: 1 };
    let once = |solver: SolverName| {
        let name = solver.name();
        let mut surface = Surface::new(&record, &Options::default(), Law::He, Class::First).ok()?;
        let started = cpu::seconds();
        let found = solve(&mut surface, solver.solver(), &settings);
        let each = (cpu::seconds() - started) / found.outcome.evaluations.max(1) as f64;
        Some(in_ms(format!("--solver {name}, 10,000 models of {} samples", record.len()), each * 1e7))
    };
    [SolverName::Random, SolverName::Contour].into_iter().filter_map(once).collect()
}

/// Labelled recordings.
fn labelled(index: &Path) -> anyhow::Result<Vec<Row>> {
    let records = evaluate::records(index)?;
    let times: Vec<f64> = records.iter().map(|(r, params)| cpu::ms(1, || assess(r, params))).collect();
    let name = |what: &str| format!("estimate, {} recordings of {}: {what}", times.len(), index.display());
    Ok(vec![in_ms(name("mean"), stats::mean(&times)), in_ms(name("90 %"), stats::quantile(&times, 0.9))])
}
