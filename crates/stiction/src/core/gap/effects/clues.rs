//! Where to begin looking for an effect: what the base leaves, and how its valve moves.

use crate::core::gap::problem::Problem;

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
    /// Share of the residual's fitted part that columns made by `shape` explain, each with a constant.
    fn explained(&self, shape: &dyn Fn(f64) -> [f64; 2]) -> f64 {
        let (mut n, mut sums) = (0.0, [0.0; 3]);
        let points = || self.problem.train.iter().flat_map(|[a, b]| *a..*b);
        for k in points() {
            let x = shape(k as f64);
            n += 1.0;
            sums[0] += x[0];
            sums[1] += x[1];
            sums[2] += self.residual[k];
        }
        let m = sums.map(|s| s / n);
        let mut g = [0.0_f64; 6];
        for k in points() {
            let x = shape(k as f64);
            let (a, b, y) = (x[0] - m[0], x[1] - m[1], self.residual[k] - m[2]);
            for (slot, v) in g.iter_mut().zip([a * a, a * b, b * b, a * y, b * y, y * y]) {
                *slot += v;
            }
        }
        let [aa, ab, bb, ay, by, yy] = g;
        let determinant = aa * bb - ab * ab;
        let squares = if determinant > 1e-9 * aa * bb {
            (ay * (bb * ay - ab * by) + by * (aa * by - ab * ay)) / determinant
        } else if aa > 0.0 {
            ay * ay / aa
        } else {
            0.0
        };
        if yy > 0.0 { squares / yy } else { 0.0 }
    }

    /// The frequencies, radians a point, at which the residual holds most, best first, each a peak of its own.
    #[must_use]
    pub(crate) fn frequencies(&self, wanted: usize) -> Vec<f64> {
        const STEPS: usize = 240;
        let n = self.problem.n() as f64;
        let (low, high) = (2.0 * core::f64::consts::PI / n, 1.2_f64);
        // Finer than a period in the record between steps at the low end, coarser at the high one.
        let grid: Vec<f64> = (0..STEPS).map(|i| low * libm::pow(high / low, i as f64 / (STEPS - 1) as f64)).collect();
        let power: Vec<f64> = grid.iter().map(|w| self.explained(&|k| [libm::sin(w * k), libm::cos(w * k)])).collect();
        self.peaks(&grid, &power, wanted)
    }

    /// The instants at which a step in the residual explains most of it, points, best first.
    #[must_use]
    pub(crate) fn steps(&self, wanted: usize) -> Vec<f64> {
        self.scan(wanted, &|k, t| if k >= t { 1.0 } else { 0.0 })
    }

    /// The instants from which a ramp explains most of it, points, best first.
    #[must_use]
    pub(crate) fn bends(&self, wanted: usize) -> Vec<f64> {
        self.scan(wanted, &|k, t| (k - t).max(0.0))
    }

    fn scan(&self, wanted: usize, shape: &dyn Fn(f64, f64) -> f64) -> Vec<f64> {
        const STEPS: usize = 60;
        let (from, to) = (self.problem.blocks.from as f64, self.problem.n() as f64);
        let grid: Vec<f64> = (0..STEPS).map(|i| from + (to - from) * (i as f64 + 0.5) / STEPS as f64).collect();
        let power: Vec<f64> = grid.iter().map(|t| self.explained(&|k| [shape(k, *t), 0.0])).collect();
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
