//! How well the bands are known: what other bands explain the record nearly as well.
//!
//! The plane of (s, j) is tiled by cells that give the same slips. From the best cell on, cells are walked edge to edge
//! in s and in j, along the ridge where an earlier slip and a longer lag look alike, and at random. A cell counts by
//! the likelihood of its fit, `exp(-(SSE - SSE*) / (2 sigma^2))`, spread over its rectangle by the squared error
//! against fd; s is even inside a cell. Quantiles of this mixture are the likelihood's intervals. What the likelihood
//! does not know, a valve or a disturbance unlike the model, shows in the residual, and sets a least width; the
//! figures of that are measured on simulated loops, see [`super::width`].

use super::candidate::{Bench, Candidate, Effort, Start};
use super::residual::{Whiteness, whiteness};
use super::search::{generator, normal, uniform};
use super::width::{Spread, hull};
use crate::optim::local::on_triangle;
use crate::signal::stats;
use rand_chacha::ChaCha8Rng;

/// Share of the mixture beyond either end of a likelihood interval.
const TAIL: f64 = 0.05;
/// Logarithm of a weight below which a cell does not count.
const NEGLIGIBLE: f64 = -12.0;
/// Cells walked to either side in s and in j, and neighbours in a row that do not count after which a walk ends.
const WALK_S: usize = 25;
const WALK_J: usize = 10;
const LOST: usize = 4;
/// Random moves.
const MOVES: usize = 120;
/// Cells whose process is fitted to its end.
const POLISHED: usize = 40;
/// Places in a cell, in s and in fd.
const PLACES: [usize; 2] = [5, 25];
/// Golden section: its multiples' fractions are even.
const GOLDEN: f64 = 0.618_033_988_749_895;
/// Standard error of j, times this, that must stay below a third of s for j to count as seen.
const SEEN: f64 = 5.0;

/// What [`spread`] found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Found {
    /// The intervals, spans of OP.
    pub spread: Spread,
    /// The best candidate met: the one asked about, or a better one.
    pub best: Candidate,
}

/// The likelihood's intervals around `best`, in spans of OP, and a better candidate if one is met on the way. `without`
/// is the squared error without friction.
pub fn spread(bench: &mut Bench<'_>, best: &Candidate, without: f64, seed: u64) -> Found {
    let mut tests = test(bench, best);
    let mut looking = Looking::new(bench, *best, tests.inflation);
    looking.walk();
    looking.ridge();
    looking.wander(&mut generator(seed, 2));
    looking.polish();
    let mut top = looking.top;
    if top.fit.sse < best.fit.sse {
        top = looking.bench.settle(&top).filter(|c| c.fit.sse <= top.fit.sse).unwrap_or(top);
        tests = test(looking.bench, &top);
        looking.accept(top, tests.inflation);
        looking.walk();
        looking.polish();
        top = looking.top;
    }
    let (mixture, flat) = looking.mixture();
    let error = 2.0 * looking.bench.band_error(&top) * looking.stretch * tests.inflation.sqrt();
    let index = if without > 0.0 { (1.0 - top.fit.sse / without).clamp(0.0, 1.0) } else { 0.0 };
    let path = &looking.bench.question.path;
    let [s, j] = top.centred();
    let of = |f: &dyn Fn(&Place) -> f64, value: f64| hull(mixture.interval(f), [value, value]);
    let spread = Spread {
        s: of(&|p| p.s, s),
        j: if flat { looking.allowed(j) } else { of(&|p| p.j, j) },
        fs: of(&|p| 0.5 * (p.s + p.j), 0.5 * (s + j)),
        fd: of(&|p| 0.5 * (p.s - p.j), 0.5 * (s - j)),
        j_identifiable: !flat && SEEN * error < 0.33 * s,
        whiteness: tests,
        quantum: quantum(path),
        index,
    };
    Found { spread, best: top }
}

fn test(bench: &mut Bench<'_>, of: &Candidate) -> Whiteness {
    let residual = bench.residual(of);
    let from = bench.target.from.min(bench.question.mean.len());
    whiteness(&residual, &bench.question.mean[from..])
}

/// Step of the grid that values stand on, 0 where they are (nearly) all different.
fn quantum(path: &[f64]) -> f64 {
    const LEAST: f64 = 1e-6;
    let sorted = stats::sorted(path);
    let gaps: Vec<f64> = sorted.windows(2).map(|w| w[1] - w[0]).filter(|g| *g > LEAST).collect();
    if gaps.is_empty() || 2 * gaps.len() > path.len() { 0.0 } else { stats::quantile(&gaps, 0.05) }
}

/// The search of the surroundings.
struct Looking<'b, 'a> {
    bench: &'b mut Bench<'a>,
    cells: Vec<Candidate>,
    top: Candidate,
    /// Variance of the residual, per independent point.
    variance: f64,
    stretch: f64,
}

impl<'b, 'a> Looking<'b, 'a> {
    fn new(bench: &'b mut Bench<'a>, best: Candidate, inflation: f64) -> Self {
        let stretch = bench.band_stretch(&best).min(5.0);
        let mut looking = Self { bench, cells: Vec::new(), top: best, variance: 0.0, stretch };
        looking.accept(best, inflation);
        looking
    }

    /// Starts from a new best candidate.
    fn accept(&mut self, best: Candidate, inflation: f64) {
        self.cells.retain(|c| !c.covers(best.s, best.j, best.start));
        self.cells.push(best);
        self.top = best;
        let count = (self.bench.target.y.len() as f64 - 8.0).max(1.0);
        self.variance = (best.fit.sse / count * inflation).max(1e-14);
    }

    fn weight(&self, sse: f64) -> f64 {
        -(sse - self.top.fit.sse) / (2.0 * self.variance)
    }

    /// The candidate at a place, fitted from `shape` with the lag changed, or remembered.
    fn visit(&mut self, s: f64, j: f64, start: Start, from: &Candidate, lag: f64) -> Option<Candidate> {
        let [s, j] = on_triangle([s, j]);
        if s < 1e-4 {
            return None;
        }
        let known = self.cells.iter().rposition(|c| c.covers(s, j, start));
        if lag == 0.0
            && let Some(at) = known
        {
            return Some(self.cells[at]);
        }
        let mut shape = from.fit.shape;
        shape[self.bench.class.shape_len() - 1] += lag;
        let shape = self.bench.class.clamp(shape, &self.bench.question.limits);
        let hopeless = (1.3 * self.top.fit.sse).max(self.top.fit.sse - 4.0 * NEGLIGIBLE * self.variance);
        let wanted = self.top.fit.sse - 3.0 * NEGLIGIBLE * self.variance;
        let effort = Effort { steps: 1, hopeless, wanted };
        let found = self.bench.fit(s, j, start, &[shape], effort).filter(|c| c.fit.gain != 0.0)?;
        if found.fit.sse < self.top.fit.sse {
            self.top = found;
        }
        match known {
            Some(at) if found.fit.sse < self.cells[at].fit.sse => self.cells[at] = found,
            Some(_) => {}
            None => self.cells.push(found),
        }
        Some(found)
    }

    /// From the best cell across the edges in s, to either side, then in j.
    fn walk(&mut self) {
        let home = self.top;
        self.walk_edges(WALK_S, [1e-4, 3.0], |c| c.s_cell, |edge| [edge, home.j.min(edge)]);
        let home = self.top;
        self.walk_edges(WALK_J, [0.0, home.s], |c| c.j_cell, |edge| [home.s, edge]);
    }

    /// From the best cell to either side, at most `most` cells, while their edges lie inside `range`; `place` is where
    /// an edge is looked at.
    fn walk_edges(
        &mut self,
        most: usize,
        range: [f64; 2],
        cell: impl Fn(&Candidate) -> [f64; 2],
        place: impl Fn(f64) -> [f64; 2],
    ) {
        let home = self.top;
        for up in [false, true] {
            let (mut at, mut warm, mut lost) = (home, home, 0);
            for _ in 0..most {
                let [low, high] = cell(&at);
                let edge = if up { high * (1.0 + 1e-9) + 1e-12 } else { low * (1.0 - 1e-9) - 1e-12 };
                if !edge.is_finite() || edge <= range[0] || edge > range[1] {
                    break;
                }
                let [s, j] = place(edge);
                let Some(next) = self.visit(s, j, home.start, &warm, 0.0) else { break };
                if self.weight(next.fit.sse) > NEGLIGIBLE {
                    (warm, lost) = (next, 0);
                } else {
                    lost += 1;
                }
                if lost == LOST || cell(&next) == cell(&at) {
                    break;
                }
                at = next;
            }
        }
    }

    /// Far steps in s, each with the lag that makes up for it.
    fn ridge(&mut self) {
        let home = self.top;
        for share in [0.005, 0.01, 0.02, 0.04, 0.08, 0.16] {
            for side in [-share, share] {
                let s = home.s * (1.0 + side);
                let lag = -(s - home.s) / self.bench.question.rate.max(1e-6);
                let j = home.j / home.s * s;
                let found = self.visit(s, home.j, home.start, &home, lag);
                if found.is_some_and(|c| self.weight(c.fit.sse) > 4.0 * NEGLIGIBLE) {
                    self.visit(s, j, home.start, &home, lag);
                }
            }
        }
    }

    /// Random moves that go where the weight is (Metropolis).
    fn wander(&mut self, rng: &mut ChaCha8Rng) {
        let mut at = self.top;
        for _ in 0..MOVES {
            let kind = uniform(rng);
            let (mut s, mut j, mut start, mut lag) = (at.s, at.j, at.start, 0.0);
            let sigma = 0.05 * libm::pow(10.0, -2.0 * uniform(rng)) * at.s;
            if kind < 0.7 {
                if kind < 0.45 {
                    s = across(s, at.s_cell, sigma, rng);
                }
                if kind > 0.25 {
                    j = across(j, at.j_cell, 4.0 * sigma, rng);
                }
            } else if kind < 0.85 {
                lag = 1.5 * normal(rng);
                s -= lag * self.bench.question.rate;
            } else if kind < 0.95 {
                let list = self.bench.question.records[usize::from(!start.up)].len();
                let by = 1 + (3.0 * uniform(rng) * uniform(rng)) as usize;
                let up = uniform(rng) < 0.5;
                start.record =
                    if up { (start.record + by).min(list.max(1) - 1) } else { start.record.saturating_sub(by) };
            } else {
                start.place = uniform(rng);
            }
            let Some(next) = self.visit(s, j, start, &at, lag) else { continue };
            let gain = self.weight(next.fit.sse) - self.weight(at.fit.sse);
            if gain >= 0.0 || libm::log(uniform(rng).max(1e-300)) < gain {
                at = next;
            }
        }
    }

    /// Everything that the slips of cells that count allow j to be.
    fn allowed(&self, j: f64) -> [f64; 2] {
        let count = self.cells.iter().filter(|c| self.weight(c.fit.sse) > NEGLIGIBLE / 4.0);
        count.fold([j, j], |all, c| hull(all, [c.j_cell[0].min(j), c.j_cell[1].min(c.s_cell[1].min(c.s.max(1.0)))]))
    }

    /// Fits the process to its end in the cells that may count most: a weight is that of the best process for the
    /// slips.
    fn polish(&mut self) {
        let mut order: Vec<usize> = (0..self.cells.len()).collect();
        order.sort_by(|a, b| self.cells[*a].fit.sse.total_cmp(&self.cells[*b].fit.sse));
        for k in order.into_iter().take(POLISHED) {
            let c = self.cells[k];
            if self.weight(c.fit.sse) < 2.5 * NEGLIGIBLE || c.covers(self.top.s, self.top.j, self.top.start) {
                continue;
            }
            let effort = Effort::of(4);
            let shapes = [c.fit.shape, self.top.fit.shape];
            let found = self.bench.fit(c.s, c.j, c.start, &shapes, effort).filter(|f| f.fit.gain != 0.0);
            if let Some(found) = found.filter(|f| f.fit.sse < c.fit.sse) {
                self.cells[k] = found;
                if found.fit.sse < self.top.fit.sse {
                    self.top = found;
                }
            }
        }
    }

    /// The weighted places of all cells that count, and whether the best one cannot tell fd from the gain.
    fn mixture(&mut self) -> (Mixture, bool) {
        let (mut places, mut flat) = (Vec::new(), false);
        let mut order: Vec<Candidate> =
            self.cells.iter().copied().filter(|c| self.weight(c.fit.sse) > NEGLIGIBLE).collect();
        order.sort_by(|a, b| a.fit.sse.total_cmp(&b.fit.sse));
        // One rectangle counts once, with the first slip that suits it best.
        let mut cells: Vec<Candidate> = Vec::new();
        for c in order {
            if !cells.iter().any(|t| t.covers(c.s, c.j, t.start)) {
                cells.push(c);
            }
        }
        for c in &cells {
            let Some((profile, [fd_low, fd_high])) = self.bench.profile(c) else { continue };
            let even = profile.is_flat();
            if c.fit.sse <= self.top.fit.sse {
                flat = even;
            }
            let s_high = if c.s_cell[1].is_finite() { c.s_cell[1] } else { c.s.max(1.0) };
            let s_width = s_high - c.s_cell[0];
            let stretch = self.stretch;
            let sse = |fd: f64| {
                if even { c.fit.sse } else { profile.sse(c.fit.fd + (fd - c.fit.fd) / stretch).max(c.fit.sse) }
            };
            let band = self.band_that_counts(&sse, [fd_low, fd_high], c.fit.fd);
            let step = (band[1] - band[0]) / PLACES[1] as f64;
            let area = (s_width / PLACES[0] as f64) * step.max(1e-12);
            for m in 0..PLACES[1] {
                let fd = band[0] + (m as f64 + 0.5) * step;
                let weight = libm::exp(self.weight(sse(fd)).min(0.0)) * area;
                // Rows are shifted against each other, so that s is even over the cell, not on a few values.
                let shift = (m as f64 * GOLDEN).fract();
                for k in 0..PLACES[0] {
                    let s = c.s_cell[0] + s_width * (k as f64 + shift) / PLACES[0] as f64;
                    let j = s - 2.0 * fd;
                    // The ends of a cell belong to it, and a point of it always does.
                    if j >= c.j_cell[0] - 2.0 * step && j <= c.j_cell[1] + 2.0 * step && j <= s + 2.0 * step {
                        places.push(Place { s, j: j.max(0.0), weight });
                    }
                }
            }
        }
        (Mixture { places }, flat)
    }

    /// The part of a band of fd whose weight counts, found from the best place outwards by halving.
    fn band_that_counts(&self, sse: &dyn Fn(f64) -> f64, band: [f64; 2], best: f64) -> [f64; 2] {
        let counts = |fd: f64| self.weight(sse(fd)) > self.weight(sse(best)) + NEGLIGIBLE;
        band.map(|end| {
            if counts(end) {
                return end;
            }
            let (mut inside, mut outside) = (best, end);
            for _ in 0..30 {
                let middle = 0.5 * (inside + outside);
                if counts(middle) { inside = middle } else { outside = middle }
            }
            outside
        })
    }
}

/// A value just across an edge of its cell (40 %), else a normal step.
fn across(value: f64, cell: [f64; 2], sigma: f64, rng: &mut ChaCha8Rng) -> f64 {
    if uniform(rng) < 0.4 {
        let edge = if uniform(rng) < 0.5 { cell[0] * (1.0 - 1e-9) - 1e-12 } else { cell[1] * (1.0 + 1e-9) + 1e-12 };
        if edge.is_finite() && edge > 0.0 {
            return edge;
        }
    }
    value + sigma * normal(rng)
}

/// One place in the plane of (s, j).
#[derive(Debug, Clone, Copy)]
struct Place {
    s: f64,
    j: f64,
    weight: f64,
}

/// Weighted places.
struct Mixture {
    places: Vec<Place>,
}

impl Mixture {
    /// The middle part of a value, [`TAIL`] cut off on either side; empty (end before start) without places.
    fn interval(&self, value: &dyn Fn(&Place) -> f64) -> [f64; 2] {
        let mut all: Vec<(f64, f64)> = self.places.iter().map(|p| (value(p), p.weight)).collect();
        all.sort_by(|a, b| a.0.total_cmp(&b.0));
        let total: f64 = all.iter().map(|p| p.1).sum();
        let cut = TAIL * total;
        let mut sum = 0.0;
        let mut beyond = |p: &&(f64, f64)| {
            sum += p.1;
            sum > cut
        };
        let low = all.iter().find(&mut beyond).map_or(f64::INFINITY, |p| p.0);
        sum = 0.0;
        let beyond = |p: &&(f64, f64)| {
            sum += p.1;
            sum > cut
        };
        [low, all.iter().rev().find(beyond).map_or(f64::NEG_INFINITY, |p| p.0)]
    }
}
