//! The error over the plane of the bands, every process parameter at its best: the toolbox's error map.

use super::super::candidate::{Candidate, Effort};
use super::super::class::Shape;
use super::super::frictionless;
use super::{FitPlots, class_of};

/// One cell of an [`ErrorMap`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cell {
    /// Static band, OP units.
    pub fs: f64,
    /// Kinetic band, OP units.
    pub fd: f64,
    /// Root mean squared free-run error of the best process, PV units, at the best of a few places in the cell; `None` where the stem moves less than three
    /// times, so that no process can be fitted.
    pub rms: Option<f64>,
}

/// Error over the feasible part of the plane, 0 <= fd <= fs, fs + fd <= S0.
#[derive(Debug, Clone, PartialEq)]
pub struct ErrorMap {
    /// Order of the process, 1 or 2.
    pub order: u8,
    /// Side of a cell, OP units.
    pub step: f64,
    /// Cells, fs slowest; the first one is the valve without friction.
    pub cells: Vec<Cell>,
    /// The cell of least error.
    pub best: Cell,
    /// Least and largest fs, then fd, of the cells whose squared error lies within a tenth of the way from the least to
    /// that without friction.
    pub region: [[f64; 2]; 2],
}

/// Share of the way from the least squared error to that without friction within which a cell is still suggested.
const SUGGESTED: f64 = 0.1;
/// Gauss-Newton steps in a cell, and first positions of the stem.
const STEPS: usize = 4;
const STARTS: usize = 2;

/// Places of a cell besides its middle, within the triangle.
fn around([s, j]: [f64; 2], step: f64) -> Vec<[f64; 2]> {
    let quarter = 0.25 * step;
    let all = [[s - quarter, j], [s + quarter, j], [s, j - quarter], [s, j + quarter]];
    all.into_iter().filter(|[s, j]| 0.0 <= *j && j <= s && *s <= 1.0).collect()
}

impl FitPlots<'_> {
    /// The error of each cell of a grid of `step`, a share of OP's span, for one order of the process. `None` where no
    /// cell has an error.
    #[must_use]
    pub fn error_map(&self, order: u8, step: f64) -> Option<ErrorMap> {
        let class = class_of(order, self.class.integrates());
        let mut fits = self.fits(class);
        let own = class.clamp(self.shape_in(class), &self.normalised.limits);
        let [c_s, c_j] = self.candidate.centred();
        let slot = class.shape_len() - 1;
        let mut cells = Vec::new();
        let plain = frictionless::best(&self.normalised, &self.target, class, self.sign, 1)?;
        let zero = Cell { fs: 0.0, fd: 0.0, rms: Some(self.rms(plain.sse)) };
        cells.push(zero);
        let count = (1.0 / step.max(1e-3) + 1e-9).floor() as u32;
        let mut near: Vec<Shape> = Vec::new();
        for a in 1..=count {
            let mut column: Vec<Shape> = Vec::new();
            for b in 0..=a.min(count - a) {
                let (fs, fd) = (f64::from(a) * step, f64::from(b) * step);
                let (s, j) = (fs + fd, fs - fd);
                // The ridge: a later slip with a shorter lag looks alike.
                let mut ridge = own;
                ridge[slot] -= (s - c_s) / self.normalised.rate.max(1e-6);
                let mut shapes = vec![own, class.clamp(ridge, &self.normalised.limits), plain.shape];
                shapes.extend(column.last().into_iter().chain(near.get(b as usize)));
                let mut best: Option<Candidate> = None;
                let effort = Effort::of(STEPS);
                let starts = self.normalised.starts(fs, STARTS).into_iter().chain([self.candidate.start]);
                for start in starts {
                    let found = fits.fit_exactly([s, j], start, &shapes, effort);
                    best = found.filter(|f| best.is_none_or(|b| f.fit.sse < b.fit.sse)).or(best);
                }
                // Valleys are narrower than cells: a cell is worth its best place.
                if let Some(middle) = best {
                    let inside = (c_s - s).abs() <= step && (c_j - j).abs() <= step;
                    let own_place = inside.then_some([c_s, c_j]);
                    for [s, j] in around([s, j], step).into_iter().chain(own_place) {
                        let shapes = [middle.fit.shape, own];
                        let effort = Effort { hopeless: 4.0 * middle.fit.sse, ..Effort::of(STEPS / 2) };
                        let found = fits.fit_exactly([s, j], middle.start, &shapes, effort);
                        best = found.filter(|f| best.is_none_or(|b| f.fit.sse < b.fit.sse)).or(best);
                    }
                }
                column.push(best.map_or(own, |c| c.fit.shape));
                let rms = best.map(|c| self.rms(c.fit.sse));
                cells.push(Cell { fs: fs * self.span, fd: fd * self.span, rms });
            }
            near = column;
        }
        let known = || cells.iter().filter_map(|c| c.rms.map(|rms| (*c, rms)));
        let (best, least) = known().min_by(|a, b| a.1.total_cmp(&b.1))?;
        let most = known().find(|(c, _)| c.fs == 0.0).map_or(least, |(_, rms)| rms);
        let limit = least * least + SUGGESTED * (most * most - least * least).max(0.0);
        let mut region = [[best.fs; 2], [best.fd; 2]];
        for (cell, _) in known().filter(|(_, rms)| rms * rms <= limit) {
            for (side, value) in region.iter_mut().zip([cell.fs, cell.fd]) {
                *side = [side[0].min(value), side[1].max(value)];
            }
        }
        Some(ErrorMap { order, step: step * self.span, cells, best, region })
    }
}
