//! A user-defined solver on the error surface, compared with the built-in ones.
//!
//! `cargo run --release --example own_solver`

use stiction::sim::he_step;
use stiction::solver::{ALL, Objective, Outcome, Settings, Solver, Surface, solve};
use stiction::{Class, Law, ModelChoice, NoFit, Options, Record, ValveChoice};

/// Walks down each row of a grid: a poor solver, but a short one.
struct Rows;

impl Solver for Rows {
    fn name(&self) -> &'static str {
        "rows"
    }

    /// Points are [s, j] relative to OP's span, with s = fs + fd and j = fs - fd.
    fn search(&self, objective: &mut dyn Objective, settings: &Settings) -> Outcome {
        let side = ((2 * settings.budget) as f64).sqrt() as u32;
        let mut best = Outcome::nothing();
        for row in 1..side {
            for column in 0..row {
                let point = [f64::from(row) / f64::from(side), f64::from(column) / f64::from(side)];
                let cost = objective.cost(point);
                best.evaluations += 1;
                if cost < best.cost {
                    (best.cost, best.best) = (cost, point);
                }
            }
        }
        best
    }
}

/// OP oscillates, a sticking valve follows it, and a first-order process responds to the valve.
fn record() -> Record {
    let op: Vec<f64> =
        (0..600).map(|k| 6.0 * (f64::from(k) * 0.06).sin() + 2.0 * (f64::from(k) * 0.017).sin()).collect();
    let (mut stem, mut pv, mut measured) = (0.0, 0.0, Vec::new());
    for &u in &op {
        measured.push(pv);
        stem = he_step(stem, u, 2.5, 1.0);
        pv += 0.1 * (1.5 * stem - pv);
    }
    Record::uniform(1.0, op, measured)
}

fn compare() -> Result<(), NoFit> {
    let options = Options { model: ModelChoice::Fopdt, valve: ValveChoice::He, ..Options::default() };
    let record = record();
    let settings = Settings { budget: 2000, fineness_pct: 2.0, seed: 1 };
    let own: &dyn Solver = &Rows;
    for solver in ALL.into_iter().chain([own]) {
        let mut surface = Surface::new(&record, &options, Law::He, Class::First)?;
        let found = solve(&mut surface, solver, &settings);
        let outcome = found.outcome;
        println!(
            "{:<13} fs {:.3}  fd {:.3}  MSE {:.3e}  {} evaluations, {}  (truth: 2.5, 1)",
            solver.name(),
            found.fs,
            found.fd,
            found.mse,
            outcome.evaluations,
            outcome.stopped.name()
        );
    }
    Ok(())
}

fn main() {
    if let Err(why) = compare() {
        eprintln!("{why}");
    }
}
