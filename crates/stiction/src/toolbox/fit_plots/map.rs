//! The error over the plane of the bands, with all process parameters optimised: the toolbox's error map.

use super::{FitPlots, class_of};
use crate::core::ident::slip_search::interval::centred;
use crate::core::sim::slips::Law;
use crate::toolbox::surface::Surface;

/// One cell of an [`ErrorMap`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cell {
    /// Static band, OP units.
    pub fs: f64,
    /// Kinetic band, OP units.
    pub fd: f64,
    /// Root mean squared free-run error of the best process, PV units, at the best of a few points in the cell; `None` if the
    /// stem moves less than three times, so that no process can be fitted.
    pub rms: Option<f64>,
}

/// Error over the feasible part of the plane, 0 <= fd <= fs, fs + fd <= S0.
#[derive(Debug, Clone, PartialEq)]
pub struct ErrorMap {
    /// Law of the valve.
    pub law: Law,
    /// Order of the process, 1 or 2.
    pub order: u8,
    /// Side of a cell, OP units.
    pub step: f64,
    /// Cells, fs slowest; the first one is the valve without friction.
    pub cells: Vec<Cell>,
    /// The cell of least error.
    pub best: Cell,
    /// Least and largest fs, then fd, of the suggested cells: those whose squared error exceeds the least by at most a tenth of
    /// the distance to the error without friction, or is no larger than the answer's.
    pub region: [[f64; 2]; 2],
}

/// Share of the distance from the least squared error to that without friction up to which a cell is suggested.
const SUGGESTED: f64 = 0.1;

/// Points of a cell besides its middle, within the triangle.
fn around([s, j]: [f64; 2], step: f64) -> Vec<[f64; 2]> {
    let quarter = 0.25 * step;
    let all = [[s - quarter, j], [s + quarter, j], [s, j - quarter], [s, j + quarter]];
    all.into_iter().filter(|[s, j]| 0.0 <= *j && j <= s && *s <= 1.0).collect()
}

impl FitPlots<'_> {
    /// The error of each cell of a grid of `step`, a share of OP's span, for one order of the process. `None` if no cell has an
    /// error.
    #[must_use]
    pub fn error_map(&self, order: u8, step: f64) -> Option<ErrorMap> {
        let law = self.candidate.law;
        let class = class_of(order, self.candidate.class.integrates());
        let mut surface = Surface::of_sign(self.record, &self.options, (law, class), Some(self.sign), self.rho).ok()?;
        let own = self.evaluate(|evaluator, view| {
            let own = self.in_order(order, evaluator, view)?;
            if self.rho == 0.0 {
                return Some((centred(&own), self.rms(evaluator.polish(view, &own)?.sse)));
            }
            let mut behind = evaluator.problem.view(self.rho, evaluator.points);
            let own = evaluator.in_class(&mut behind, &own, class)?;
            Some((centred(&own), self.rms(own.sse())))
        });
        let mut rms = |[s, j]: [f64; 2]| surface.mse(0.5 * (s + j) * self.span(), 0.5 * (s - j) * self.span()).sqrt();
        // If no process fits with OP as the valve signal, use the error without any model.
        let without = Some(rms([0.0; 2])).filter(|rms| rms.is_finite());
        let without = without.unwrap_or_else(|| {
            self.evaluate(|evaluator, _| self.rms(evaluator.problem.view(self.rho, evaluator.points).nothing()))
        });
        let mut cells = vec![Cell { fs: 0.0, fd: 0.0, rms: Some(without) }];
        let count = (1.0 / step.max(1e-3) + 1e-9).floor() as u32;
        for a in 1..=count {
            for b in 0..=a.min(count - a) {
                let (fs, fd) = (f64::from(a) * step, f64::from(b) * step);
                let middle = [fs + fd, fs - fd];
                // Valleys are narrower than cells: a cell gets the error of its best point.
                let places = around(middle, step).into_iter().chain([middle]);
                let mut best = places.map(&mut rms).fold(f64::INFINITY, f64::min);
                if let Some(([s, j], own)) = own
                    && (s - middle[0]).abs() <= step
                    && (j - middle[1]).abs() <= step
                {
                    best = best.min(own);
                }
                cells.push(Cell { fs: fs * self.span(), fd: fd * self.span(), rms: best.is_finite().then_some(best) });
            }
        }
        let known = || cells.iter().filter_map(|c| c.rms.map(|rms| (*c, rms)));
        let (best, least) = known().min_by(|a, b| a.1.total_cmp(&b.1))?;
        let most = known().find(|(c, _)| c.fs == 0.0).map_or(least, |(_, rms)| rms);
        let limit = least * least + SUGGESTED * (most * most - least * least).max(0.0);
        // The answer itself is always suggested, however narrow its valley.
        let chosen = own.filter(|_| order == self.candidate.class.order()).map_or(0.0, |(_, rms)| rms * rms);
        let limit = limit.max(chosen);
        let mut region = [[best.fs; 2], [best.fd; 2]];
        for (cell, _) in known().filter(|(_, rms)| rms * rms <= limit) {
            for (side, value) in region.iter_mut().zip([cell.fs, cell.fd]) {
                *side = [side[0].min(value), side[1].max(value)];
            }
        }
        Some(ErrorMap { law, order, step: step * self.span(), cells, best, region })
    }
}
