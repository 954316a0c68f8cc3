//! Search over the two friction bands in normalised form: s and j as fractions of OP's span on the triangle
//! `0 <= j <= s <= 1`, where `s = fs + fd` is dead band plus stick band and `j = fs - fd` the slip jump.
//!
//! A solver gets a cost function of two numbers, a budget and a seed; it knows nothing about valves. One file per solver, one
//! entry in [`ALL`].

mod branch_bound;
mod contour;
mod draw;
pub(crate) mod local;
mod multistart;
mod random;

pub use branch_bound::BranchBound;
pub use contour::Contour;
pub use multistart::Multistart;
pub use random::AdaptiveRandom;

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

/// All solvers.
pub const ALL: [&dyn Solver; 4] = [&Contour, &Multistart, &AdaptiveRandom, &BranchBound];

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

impl SolverName {
    /// All solvers, in the order of [`optim::ALL`](ALL).
    pub const ALL: [Self; ALL.len()] = [Self::Contour, Self::Multistart, Self::Random, Self::BranchBound];

    /// The solver itself.
    #[must_use]
    pub const fn solver(self) -> &'static dyn Solver {
        ALL[self as usize]
    }

    /// The solver's name.
    #[must_use]
    pub fn name(self) -> &'static str {
        self.solver().name()
    }

    /// The solver with this name.
    #[must_use]
    pub fn of(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|s| s.name() == name)
    }
}

/// Counts evaluations and keeps the best, for all solvers.
struct Meter<'a> {
    objective: &'a mut dyn Objective,
    left: u64,
    outcome: Outcome,
}

impl<'a> Meter<'a> {
    fn new(objective: &'a mut dyn Objective, budget: u64) -> Self {
        Self { objective, left: budget, outcome: Outcome::nothing() }
    }

    /// Cost of a point, or `None` when the budget is used up.
    fn ask(&mut self, point: [f64; 2]) -> Option<f64> {
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

#[cfg(test)]
mod tests {
    use super::*;

    struct Bowl([f64; 2]);

    impl Objective for Bowl {
        fn cost(&mut self, p: [f64; 2]) -> f64 {
            assert!(0.0 <= p[1] && p[1] <= p[0] && p[0] <= 1.0, "{p:?}");
            (p[0] - self.0[0]) * (p[0] - self.0[0]) + (p[1] - self.0[1]) * (p[1] - self.0[1])
        }
    }

    #[test]
    fn every_solver_finds_a_bowl_anywhere_on_the_triangle() {
        let settings = Settings { budget: 5000, fineness_pct: 5.0, seed: 1 };
        for solver in ALL {
            let name = SolverName::of(solver.name()).unwrap();
            assert_eq!(serde_json::to_value(name).unwrap(), solver.name());
            for target in [[0.42, 0.11], [1.0, 1.0], [0.03, 0.0], [0.77, 0.76]] {
                let found = solver.search(&mut Bowl(target), &settings);
                assert!(found.cost < 1e-4, "{} {target:?}: {found:?}", solver.name());
                assert_eq!(found, solver.search(&mut Bowl(target), &settings));
            }
        }
    }

    #[test]
    fn every_solver_finds_the_deepest_of_many_valleys() {
        struct Valleys;
        impl Objective for Valleys {
            fn cost(&mut self, p: [f64; 2]) -> f64 {
                let bowl = |x: f64, y: f64| (p[0] - x) * (p[0] - x) + (p[1] - y) * (p[1] - y);
                let ripple = 1.0 - libm::cos(25.0 * (p[0] - 0.63)) * libm::cos(25.0 * (p[1] - 0.22));
                // No model near the tip, as if the stem hardly moved.
                if p[0] > 0.95 { f64::INFINITY } else { bowl(0.63, 0.22) + 0.03 * ripple }
            }
        }
        let settings = Settings { budget: 10_000, fineness_pct: 5.0, seed: 4 };
        for solver in ALL {
            let found = solver.search(&mut Valleys, &settings);
            let [s, j] = found.best;
            assert!((s - 0.63).abs() < 0.01 && (j - 0.22).abs() < 0.01, "{}: {found:?}", solver.name());
            assert!(found.lower_bound.is_none_or(|bound| bound <= found.cost), "{}: {found:?}", solver.name());
        }
    }

    #[test]
    fn every_solver_keeps_its_budget() {
        for solver in ALL {
            for budget in [0, 1, 7, 100] {
                let settings = Settings { budget, fineness_pct: 1.0, seed: 3 };
                let found = solver.search(&mut Bowl([0.5, 0.2]), &settings);
                assert!(found.evaluations <= budget && found.stopped == Termination::Budget);
            }
        }
    }
}
