//! The solvers that search the [error surface](super::surface): one file per solver beside the grid of [`Contour`], one entry in
//! [`ALL`].

mod branch_bound;
mod draw;
mod multistart;
mod random;

pub use branch_bound::BranchBound;
pub use multistart::Multistart;
pub use random::AdaptiveRandom;

use crate::core::optim::{Contour, Solver, SolverName};

/// All solvers.
pub const ALL: [&dyn Solver; 4] = [&Contour, &Multistart, &AdaptiveRandom, &BranchBound];

impl SolverName {
    /// All solvers, in the order of [`ALL`].
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::optim::{Objective, Settings, Termination};

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
