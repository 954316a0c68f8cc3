//! Branch and bound: divides the triangle into ever smaller cells, the most promising first, and drops cells that cannot
//! contain anything better.
//!
//! The bound of a cell comes from the steepest slopes of the root of the cost seen near the cell and in general. The surface
//! is piecewise smooth with steps of unknown height, so the bound is **heuristic**: it proves nothing, and
//! [`Outcome::lower_bound`] is an estimate.

use std::collections::BinaryHeap;

use crate::core::optim::{Meter, Objective, Outcome, Settings, Solver, Termination, local};

/// The branch-and-bound solver.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BranchBound;

/// Factors on the slopes seen, first and last: when no cell is promising any more, the search reduces its slopes and continues.
const MARGIN: f64 = 1.5;
const MOST_MARGIN: f64 = 50.0;
/// Half the longer side of a cell below which it is not divided.
const FINEST: f64 = 5e-4;
/// Number of slopes kept, and the quantile of them that applies everywhere.
const SLOPES: usize = 512;
const STEEP: f64 = 0.9;

/// A cell of the square (s, j/s), with the root of the cost at its centre.
#[derive(Debug, Clone, Copy)]
struct Cell {
    middle: [f64; 2],
    half: [f64; 2],
    root: f64,
    bound: f64,
    slope: f64,
}

impl Cell {
    fn reach(&self) -> f64 {
        (self.half[0] * self.half[0] + self.half[1] * self.half[1]).sqrt()
    }
}

impl PartialEq for Cell {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other).is_eq()
    }
}

impl Eq for Cell {}

impl PartialOrd for Cell {
    fn partial_cmp(&self, other: &Self) -> Option<core::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Cell {
    /// The cell with the least bound is the greatest; ties are broken by position, so that the order is deterministic.
    fn cmp(&self, other: &Self) -> core::cmp::Ordering {
        let key = |c: &Self| [c.bound, c.middle[0], c.middle[1]];
        let pairs = key(other).into_iter().zip(key(self));
        pairs.map(|(a, b)| a.total_cmp(&b)).find(|o| o.is_ne()).unwrap_or(core::cmp::Ordering::Equal)
    }
}

impl Solver for BranchBound {
    fn name(&self) -> &'static str {
        "branch-bound"
    }

    fn search(&self, objective: &mut dyn Objective, settings: &Settings) -> Outcome {
        // The last tenth of the budget refines the best point.
        let tree_budget = settings.budget - settings.budget / 10;
        let meter = Meter::new(objective, tree_budget);
        let mut tree = Tree { meter, slopes: Vec::new(), worst: 0.0, margin: MARGIN };
        let left = tree.grow();
        let Tree { mut meter, .. } = tree;
        meter.left += settings.budget - tree_budget;
        let (best, cost) = (meter.outcome.best, meter.outcome.cost);
        if cost.is_finite() {
            local::compass(&mut meter, best, cost, 0.01, 1e-4);
        }
        let root = meter.outcome.cost.sqrt();
        meter.outcome.lower_bound = left.map(|bound| bound.min(root)).map(|bound| bound * bound);
        meter.outcome
    }
}

struct Tree<'a> {
    meter: Meter<'a>,
    /// The latest slopes, unordered.
    slopes: Vec<f64>,
    /// The largest finite root, used for points without a model.
    worst: f64,
    margin: f64,
}

impl Tree<'_> {
    /// Divides cells until none is promising, all are small, or the budget is spent. Returns the least bound left.
    fn grow(&mut self) -> Option<f64> {
        let mut open = BinaryHeap::new();
        let first = self.cell([0.5, 0.5], [0.5, 0.5], None)?;
        open.push(first);
        let mut least_closed = f64::INFINITY;
        while let Some(cell) = open.pop() {
            let best = self.meter.outcome.cost.sqrt();
            if cell.bound >= best {
                if self.margin > MOST_MARGIN {
                    self.meter.outcome.stopped = Termination::Converged;
                    return Some(best.min(least_closed));
                }
                self.margin *= 2.0;
                open.push(cell);
                open = open.into_iter().map(|c| Cell { bound: self.bound(&c), ..c }).collect();
                continue;
            }
            if cell.half[0].max(cell.half[1]) < FINEST {
                least_closed = least_closed.min(cell.bound);
                continue;
            }
            let Some(children) = self.cut(&cell) else {
                return Some(cell.bound.min(least_closed));
            };
            open.extend(children);
        }
        self.meter.outcome.stopped = Termination::Complete;
        Some(least_closed)
    }

    /// Thirds along the longer side; the middle one keeps its cost.
    fn cut(&mut self, cell: &Cell) -> Option<[Cell; 3]> {
        let axis = usize::from(cell.half[1] > cell.half[0]);
        let third = cell.half[axis] / 3.0;
        let mut half = cell.half;
        half[axis] = third;
        let shifted = |sign: f64| {
            let mut middle = cell.middle;
            middle[axis] += sign * 2.0 * third;
            middle
        };
        let low = self.cell(shifted(-1.0), half, Some(cell))?;
        let high = self.cell(shifted(1.0), half, Some(cell))?;
        let slope = low.slope.max(high.slope);
        let mut middle = Cell { half, slope, ..*cell };
        middle.bound = self.bound(&middle);
        Some([low, middle, high])
    }

    /// Evaluates the centre of a cell and bounds it.
    fn cell(&mut self, middle: [f64; 2], half: [f64; 2], parent: Option<&Cell>) -> Option<Cell> {
        let cost = self.meter.ask([middle[0], middle[0] * middle[1]])?;
        let root = if cost.is_finite() { cost.sqrt() } else { self.worst };
        self.worst = self.worst.max(root);
        let mut slope = 0.0;
        if let Some(parent) = parent {
            let way = (0..2).map(|i| (middle[i] - parent.middle[i]).abs()).fold(0.0, f64::max);
            slope = (root - parent.root).abs() / way;
            if self.slopes.len() < SLOPES {
                self.slopes.push(slope);
            } else {
                let at = self.meter.outcome.evaluations as usize % SLOPES;
                self.slopes[at] = slope;
            }
        }
        let mut cell = Cell { middle, half, root, bound: 0.0, slope };
        cell.bound = self.bound(&cell);
        Some(cell)
    }

    fn bound(&self, cell: &Cell) -> f64 {
        let usual = {
            let mut slopes = self.slopes.clone();
            if slopes.is_empty() {
                f64::INFINITY
            } else {
                let at = (STEEP * (slopes.len() - 1) as f64) as usize;
                *slopes.select_nth_unstable_by(at, f64::total_cmp).1
            }
        };
        (cell.root - self.margin * cell.slope.max(usual) * cell.reach()).max(0.0)
    }
}
