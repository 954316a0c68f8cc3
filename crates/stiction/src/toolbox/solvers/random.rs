//! Adaptive random search (after Masri, Bekey and Safford 1980): draws from a square around the best point, which grows after a
//! gain and shrinks otherwise; a square that has become too small is reset to full size.

use super::draw::Draws;
use crate::core::optim::{Meter, Objective, Outcome, Settings, Solver, Termination};

/// The single-start adaptive random solver.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct AdaptiveRandom;

/// Draws over the whole triangle before the first square.
const SCOUTS: u64 = 200;
/// Half width of a square when it is opened.
const WIDE: f64 = 0.5;
/// Half width at which a square ends: steps of a thousandth of OP's span are finer than any measurement.
pub(super) const FINEST: f64 = 1e-3;
/// Consecutive draws without gain before the square shrinks.
const PATIENCE: u32 = 16;
/// Consecutive squares without gain before the search ends.
const FRUITLESS: u32 = 6;
/// Least relative gain of a useful square.
const GAIN: f64 = 1e-4;

impl Solver for AdaptiveRandom {
    fn name(&self) -> &'static str {
        "random"
    }

    fn search(&self, objective: &mut dyn Objective, settings: &Settings) -> Outcome {
        let mut meter = Meter::new(objective, settings.budget);
        let mut draws = Draws::new(settings.seed);
        for _ in 0..SCOUTS {
            if meter.ask(draws.anywhere()).is_none() {
                return meter.outcome;
            }
        }
        let mut fruitless = 0;
        while fruitless < FRUITLESS {
            let before = meter.outcome.cost;
            let best = meter.outcome.best;
            if descend(&mut meter, best, before, WIDE, &mut draws).is_none() {
                return meter.outcome;
            }
            let gained = before - meter.outcome.cost > GAIN * before;
            fruitless = if gained { 0 } else { fruitless + 1 };
        }
        meter.outcome.stopped = Termination::Converged;
        meter.outcome
    }
}

/// One square, shrinking from wide to nothing around a point of known cost; returns where it ends, or `None` when the budget is
/// spent.
pub(super) fn descend(
    meter: &mut Meter<'_>,
    from: [f64; 2],
    cost: f64,
    wide: f64,
    draws: &mut Draws,
) -> Option<([f64; 2], f64)> {
    let (mut best, mut least, mut reach, mut misses) = (from, cost, wide, 0);
    while reach > FINEST {
        let point = draws.near(best, reach);
        let found = meter.ask(point)?;
        if found < least {
            (best, least, misses) = (point, found, 0);
            reach = (1.3 * reach).min(wide);
        } else {
            misses += 1;
        }
        if misses == PATIENCE {
            (reach, misses) = (0.6 * reach, 0);
        }
    }
    Some((best, least))
}
