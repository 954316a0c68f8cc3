//! Adaptive random search from many starts, each with its own descent, so that distant valleys are searched too.

use super::draw::Draws;
use super::random::descend;
use crate::core::optim::{Meter, Objective, Outcome, Settings, Solver, Termination, local};

/// The multi-start adaptive random solver.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Multistart;

/// Draws per start, of which the best is used.
const CANDIDATES: u32 = 8;
/// Half width of a start's first square.
const WIDE: f64 = 0.15;
/// Consecutive starts without gain before the search ends.
const FRUITLESS: u32 = 12;
/// Least relative gain of a useful start.
const GAIN: f64 = 1e-4;

impl Solver for Multistart {
    fn name(&self) -> &'static str {
        "multistart"
    }

    fn search(&self, objective: &mut dyn Objective, settings: &Settings) -> Outcome {
        let mut meter = Meter::new(objective, settings.budget);
        let mut draws = Draws::new(settings.seed);
        let mut fruitless = 0;
        while fruitless < FRUITLESS {
            let before = meter.outcome.cost;
            let Some(()) = start(&mut meter, &mut draws) else { return meter.outcome };
            let gained = before.is_infinite() || before - meter.outcome.cost > GAIN * before;
            fruitless = if gained { 0 } else { fruitless + 1 };
        }
        let (best, cost) = (meter.outcome.best, meter.outcome.cost);
        local::compass(&mut meter, best, cost, 0.01, 1e-4);
        if meter.outcome.stopped != Termination::Budget {
            meter.outcome.stopped = Termination::Converged;
        }
        meter.outcome
    }
}

/// One start and its descent; `None` when the budget is spent.
fn start(meter: &mut Meter<'_>, draws: &mut Draws) -> Option<()> {
    let (mut from, mut cost) = ([0.0, 0.0], f64::INFINITY);
    for _ in 0..CANDIDATES {
        let point = draws.anywhere();
        let found = meter.ask(point)?;
        if found < cost {
            (from, cost) = (point, found);
        }
    }
    if cost.is_finite() {
        descend(meter, from, cost, WIDE, draws)?;
    }
    Some(())
}
