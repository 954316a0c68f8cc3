//! Search over the two friction bands in normalised form: s and j as fractions of OP's span on the triangle
//! `0 <= j <= s <= 1`, where `s = fs + fd` is dead band plus stick band and `j = fs - fd` the slip jump.
//!
//! A solver gets a cost function of two numbers, a budget and a seed; it knows nothing about valves. The fit uses the grid of
//! [`Contour`]; the other solvers are in [`crate::toolbox::solvers`].

mod contour;
pub(crate) mod local;

pub use contour::Contour;

use serde::Serialize;

/// The function to minimise.
pub trait Objective {
    /// Cost of the point `[s, j]`, shares of OP's span with `s = fs + fd` and `j = fs - fd`: lower is better, infinite if no
    /// model exists. A solver stays inside the triangle `0 <= j <= s <= 1` and within its budget.
    fn cost(&mut self, point: [f64; 2]) -> f64;
}

/// Budget and random seed of a solver.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// Most calls of [`Objective::cost`].
    pub budget: u64,
    /// Step of the contour grid, % of the span.
    pub fineness_pct: f64,
    /// Seed of all random choices.
    pub seed: u64,
}

/// Why a search stopped.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Termination {
    /// The method has evaluated everything it needed.
    Complete,
    /// The budget was used up.
    Budget,
    /// No further gain expected: steps, gains or bounds became too small.
    Converged,
    /// Stopped on request; the result so far is valid.
    Interrupted,
}

impl Termination {
    /// The word in documents.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Complete => "complete",
            Self::Budget => "budget",
            Self::Converged => "converged",
            Self::Interrupted => "interrupted",
        }
    }
}

/// Result of a search.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Outcome {
    /// Best point `[s, j]`.
    pub best: [f64; 2],
    /// Its cost.
    pub cost: f64,
    /// Number of evaluations.
    pub evaluations: u64,
    /// Why it stopped.
    pub stopped: Termination,
    /// Lower bound of the cost according to the solver, if its method has one. Heuristic, not proven.
    pub lower_bound: Option<f64>,
}

impl Outcome {
    /// The result of a search before its first evaluation.
    #[must_use]
    pub const fn nothing() -> Self {
        Self {
            best: [0.0, 0.0],
            cost: f64::INFINITY,
            evaluations: 0,
            stopped: Termination::Complete,
            lower_bound: None,
        }
    }
}

/// A global search. The same settings and cost give the same result on every machine.
pub trait Solver: Sync {
    /// The solver's name on the command line and in documents.
    fn name(&self) -> &'static str;
    /// Searches the triangle within the budget.
    fn search(&self, objective: &mut dyn Objective, settings: &Settings) -> Outcome;
}

/// A built-in solver.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum SolverName {
    /// A regular grid, then a local search around the best points.
    #[default]
    Contour,
    /// Adaptive random search from many starts.
    Multistart,
    /// Adaptive random search.
    Random,
    /// Branch and bound.
    BranchBound,
}

/// Counts evaluations and keeps the best, for all solvers.
pub(crate) struct Meter<'a> {
    objective: &'a mut dyn Objective,
    pub(crate) left: u64,
    pub(crate) outcome: Outcome,
}

impl<'a> Meter<'a> {
    pub(crate) fn new(objective: &'a mut dyn Objective, budget: u64) -> Self {
        Self { objective, left: budget, outcome: Outcome::nothing() }
    }

    /// Cost of a point, or `None` when the budget is used up.
    pub(crate) fn ask(&mut self, point: [f64; 2]) -> Option<f64> {
        if self.left == 0 {
            self.outcome.stopped = Termination::Budget;
            return None;
        }
        self.left -= 1;
        self.outcome.evaluations += 1;
        let cost = self.objective.cost(point);
        if cost < self.outcome.cost {
            self.outcome.cost = cost;
            self.outcome.best = point;
        }
        Some(cost)
    }
}
