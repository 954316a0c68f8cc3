//! Where to begin looking for an effect: what the base leaves, and how its valve moves.

use super::columns;
use crate::core::gap::noise::least_squares::Orthonormal;
use crate::core::gap::problem::Problem;
use crate::core::signal::stats;

/// The base's best fit as the effects' starts see it.
#[derive(Debug)]
pub struct Clues<'a> {
    /// The record.
    pub problem: &'a Problem,
    /// What the base leaves of PV at each point, deviations.
    pub residual: &'a [f64],
    /// Lowest and highest place of the stem, spans.
    pub stem: [f64; 2],
    /// The base's lag, points.
    pub lag: f64,
}

impl Clues<'_> {
    /// Share of the residual's fitted part that columns over the record explain beside a constant.
    fn explained(&self, columns: impl IntoIterator<Item = Vec<f64>>) -> f64 {
        let fitted = |x: &[f64]| self.problem.train.iter().flat_map(|[a, b]| &x[*a..*b]).copied().collect::<Vec<f64>>();
        let mut left = fitted(self.residual);
        let constant = Orthonormal::of([vec![1.0; left.len()]]);
        constant.take_out(&mut left);
        let whole = stats::dot(&left, &left);
        let taken = constant.beyond(columns.into_iter().map(|x| fitted(&x))).power_of(&left);
        if whole > 0.0 { taken / whole } else { 0.0 }
    }

    /// The frequencies, radians a point, at which the residual holds most, best first, each a peak of its own.
    #[must_use]
    pub(crate) fn frequencies(&self, wanted: usize) -> Vec<f64> {
        const STEPS: usize = 240;
        let n = self.problem.n() as f64;
        let (low, high) = (2.0 * core::f64::consts::PI / n, 1.2_f64);
        // Finer than a period in the record between steps at the low end, coarser at the high one.
        let grid: Vec<f64> = (0..STEPS).map(|i| low * libm::pow(high / low, i as f64 / (STEPS - 1) as f64)).collect();
        let power: Vec<f64> = grid.iter().map(|w| self.explained(columns::waves(*w, self.problem.n()))).collect();
        self.peaks(&grid, &power, wanted)
    }

    /// The instants at which a step in the residual explains most of it, points, best first.
    #[must_use]
    pub(crate) fn steps(&self, wanted: usize) -> Vec<f64> {
        self.scan(wanted, |at, n| columns::step(at, None, n))
    }

    /// The instants from which a ramp explains most of it, points, best first.
    #[must_use]
    pub(crate) fn bends(&self, wanted: usize) -> Vec<f64> {
        self.scan(wanted, columns::ramp)
    }

    fn scan(&self, wanted: usize, column: impl Fn(f64, usize) -> Vec<f64>) -> Vec<f64> {
        const STEPS: usize = 60;
        let (from, to) = (self.problem.blocks.from as f64, self.problem.n() as f64);
        let grid: Vec<f64> = (0..STEPS).map(|i| from + (to - from) * (i as f64 + 0.5) / STEPS as f64).collect();
        let power: Vec<f64> = grid.iter().map(|t| self.explained([column(*t, self.problem.n())])).collect();
        self.peaks(&grid, &power, wanted)
    }

    fn peaks(&self, grid: &[f64], power: &[f64], wanted: usize) -> Vec<f64> {
        let mut found: Vec<(f64, f64)> = (0..grid.len())
            .filter(|i| {
                let at = |i: usize| power.get(i).copied().unwrap_or(-1.0);
                at(*i) >= at(i.wrapping_sub(1)) && at(*i) >= at(i + 1)
            })
            .map(|i| (power[i], grid[i]))
            .collect();
        found.sort_by(|a, b| b.0.total_cmp(&a.0));
        found.into_iter().take(wanted).map(|(_, x)| x).collect()
    }
}
