//! Uncertainty of the bands: which other bands explain the record nearly as well.
//!
//! The plane of (s, j) is tiled by cells that give the same slips. From the best cell, the walk goes across edges in s and in
//! j, along the ridge where an earlier slip and a longer lag look alike, and at random; the cells of other candidates start
//! further walks. A cell has the likelihood of its fit, `exp(-(SSE - SSE*) / (2 sigma^2))`, spread over its rectangle by the
//! squared error as a function of fd; s is uniform inside a cell. Quantiles of this mixture are the likelihood's intervals. The
//! likelihood ignores model error, such as a valve or a disturbance unlike the model; this shows in the residual and sets a
//! minimum width, calibrated on simulated loops, see [`crate::core::ident::width`].

use super::around::Around;
use super::candidate::Candidate;
use super::evaluator::{Evaluator, Polished};
use super::later::Moves;
use super::local_search::across;
use crate::core::ident::evaluator::View;
use crate::core::ident::normalised::Start;
use crate::core::ident::random::{moved, normal, seeded_rng, uniform};
use crate::core::ident::residual::{Whiteness, whiteness};
use crate::core::ident::width::{Spread, THIRDS, hull};
use crate::core::optim::local::on_triangle;
use crate::core::signal::stats;
use rand_chacha::ChaCha8Rng;

/// Probability of the mixture beyond either end of a likelihood interval.
const TAIL: f64 = 0.05;
/// Logarithm of a weight below which a cell is ignored.
const NEGLIGIBLE: f64 = -12.0;
/// Cells walked per side in s and in j, and how many negligible neighbours in a row end a walk.
const WALK_S: usize = 25;
const WALK_J: usize = 10;
const LOST: usize = 4;
/// Most points by which all moves are shifted earlier or later, and how many negligible shifts in a row end the search.
const MOST_LATER: isize = 60;
const LOST_LATER: usize = 20;
/// Steps to better neighbours from such a shift, and the logarithm of a weight from which they are tried.
const BESIDE: usize = 8;
const WORTH_A_STEP: f64 = -1200.0;
/// Logarithm of a weight from which such a shift is inside the interval: half of the 90 % quantile of chi squared with one
/// degree of freedom, as for a profile likelihood.
const PROFILE: f64 = -1.353;
/// Looks around the best candidate, each around a better one than the last.
const ROUNDS: usize = 3;
/// Random moves.
const MOVES: usize = 120;
/// Number of other candidates included.
const RIVALS: usize = 12;
/// Sampling points in a cell, in s and in fd.
const PLACES: [usize; 2] = [5, 25];
/// Golden section: the fractional parts of its multiples are evenly distributed.
const GOLDEN: f64 = 0.618_033_988_749_895;
/// j counts as identified if its standard error, times this, is below a third of s.
const SEEN: f64 = 5.0;

/// Result of [`spread`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Found {
    /// The intervals, spans of OP.
    pub spread: Spread,
    /// The best candidate found: the requested one, or a better one.
    pub best: Candidate,
    /// Its process.
    pub process: Polished,
    /// Standard error of its fd, spans, for white residuals; infinite if fd cannot be separated from the gain.
    pub band_error: f64,
}

/// The likelihood's intervals around `best`, whose process is `process` in this view, and a better candidate if one is found.
/// `rivals` are other candidates of its law and class; `index` is the share of the error that friction removes.
pub(crate) fn spread(
    evaluator: &mut Evaluator<'_>,
    view: &mut View,
    best: &Candidate,
    rivals: &[Candidate],
    index: f64,
    seed: u64,
) -> Option<Found> {
    let process = evaluator.polish(view, best)?;
    let mut tests = test(evaluator, view, best, &process);
    let mut looking = Looking::new(evaluator, view, *best, process, tests.inflation)?;
    let mut rng = seeded_rng(seed, 2);
    for round in 1..=ROUNDS {
        let asked = looking.top;
        looking.walk();
        looking.ridge();
        looking.meet(rivals);
        looking.wander(&mut rng);
        if looking.top.sse() >= looking.first {
            break;
        }
        let top = looking.top;
        let process = looking.evaluator.polish(looking.view, &top)?;
        // The cell's quadratic model may promise more than exists, and a candidate found in the last round is not searched
        // around.
        if process.sse >= looking.process.sse || round == ROUNDS {
            looking.top = asked;
            break;
        }
        tests = test(looking.evaluator, looking.view, &top, &process);
        looking.accept(top, process, tests.inflation)?;
    }
    let top = looking.top;
    let (mixture, flat) = looking.mixture();
    let error = 2.0 * looking.band_error() * tests.inflation.sqrt();
    let path = looking.evaluator.problem.normalised.path.values();
    let [s, j] = centred(&top);
    let of = |f: &dyn Fn([f64; 2]) -> f64| {
        let value = f([s, j]);
        hull(mixture.interval(&|p: &Place| f([p.s, p.j])), looking.profile_range(f, value))
    };
    let spread = Spread {
        s: of(&|[s, _]| s),
        j: if flat { looking.allowed(j) } else { of(&|[_, j]| j) },
        fs: of(&|[s, j]| 0.5 * (s + j)),
        fd: of(&|[s, j]| 0.5 * (s - j)),
        j_identifiable: !flat && SEEN * error < 0.33 * s,
        whiteness: tests,
        quantum: quantum(path),
        index,
        distinct: false,
        thirds: [None; THIRDS],
    };
    Some(Found { spread, best: top, process: looking.process, band_error: looking.band_error() })
}

/// The midpoint in (s, j) of the range that the slips and the fitted fd allow.
#[must_use]
pub(crate) fn centred(of: &Candidate) -> [f64; 2] {
    let fd = of.fit.fd;
    let [s_cell, j_cell] = of.cells;
    let low = s_cell[0].max(j_cell[0] + 2.0 * fd);
    let high = s_cell[1].min(of.s.max(1.0)).min(j_cell[1] + 2.0 * fd);
    let s = if low <= high { 0.5 * (low + high) } else { of.s };
    [s, (s - 2.0 * fd).clamp(0.0, s)]
}

fn test(evaluator: &mut Evaluator<'_>, view: &View, of: &Candidate, process: &Polished) -> Whiteness {
    let left = evaluator.residual(view, of, process);
    let rho = view.rho();
    // Filtered like the view.
    let filtered: Vec<f64> = core::iter::once(0.0).chain(left.windows(2).map(|w| w[1] - rho * w[0])).collect();
    let left = if rho == 0.0 { left } else { filtered };
    let mean = &evaluator.problem.normalised.mean;
    let from = view.from().min(mean.len());
    whiteness(&left, &mean[from..])
}

/// Step of the grid on which values lie, 0 if (nearly) all values differ.
fn quantum(path: &[f64]) -> f64 {
    const LEAST: f64 = 1e-6;
    let sorted = stats::sorted(path);
    let gaps: Vec<f64> = sorted.windows(2).map(|w| w[1] - w[0]).filter(|g| *g > LEAST).collect();
    if gaps.is_empty() || 2 * gaps.len() > path.len() { 0.0 } else { stats::quantile(&gaps, 0.05) }
}

/// State of the search around the answer.
struct Looking<'b, 'a> {
    evaluator: &'b mut Evaluator<'a>,
    view: &'b mut View,
    /// Time constants at and near those of the best candidate.
    around: Around,
    cells: Vec<Candidate>,
    /// The best place for each s along the ridge.
    on_ridge: Vec<Candidate>,
    top: Candidate,
    process: Polished,
    /// Error of the candidate from which the search started.
    first: f64,
    /// Variance of the residual, per independent point.
    variance: f64,
    stretch: f64,
}

impl<'b, 'a> Looking<'b, 'a> {
    fn new(
        evaluator: &'b mut Evaluator<'a>,
        view: &'b mut View,
        best: Candidate,
        process: Polished,
        inflation: f64,
    ) -> Option<Self> {
        let around = evaluator.around(view, &process);
        let mut looking = Self {
            evaluator,
            view,
            around,
            cells: Vec::new(),
            on_ridge: Vec::new(),
            top: best,
            process,
            first: 0.0,
            variance: 0.0,
            stretch: 1.0,
        };
        looking.accept(best, process, inflation)?;
        Some(looking)
    }

    /// Restarts from a new best candidate.
    fn accept(&mut self, best: Candidate, process: Polished, inflation: f64) -> Option<()> {
        (self.evaluator.law, self.evaluator.class) = (best.law, best.class);
        self.around = self.evaluator.around(self.view, &process);
        let lag = process.lag;
        let best =
            self.evaluator.fit_around(self.view, &self.around, [best.s, best.j], best.start, lag, f64::INFINITY)?;
        self.stretch = self.evaluator.band_stretch(self.view, &best, &process).min(5.0);
        self.cells.retain(|c| !c.covers(best.s, best.j, best.start));
        self.cells.push(best);
        (self.top, self.process, self.first) = (best, process, best.sse());
        let count = (self.view.count() - 8.0).max(1.0);
        self.variance = (best.sse() / count * inflation).max(1e-14);
        Some(())
    }

    /// Standard error of fd, spans, for white residuals; infinite if the data cannot separate it from the gain.
    fn band_error(&mut self) -> f64 {
        let Some((profile, _)) = self.evaluator.profile(self.view, &self.around, &self.top) else {
            return f64::INFINITY;
        };
        let count = (self.view.count() - 8.0).max(1.0);
        self.stretch * profile.error(self.top.fit.fd, self.top.sse() / count, self.top.fit.gain)
    }

    fn weight(&self, sse: f64) -> f64 {
        -(sse - self.top.sse()) / (2.0 * self.variance)
    }

    /// The candidate at a place, fitted from the process of `from` with the lag changed, or the cached one.
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
        let hopeless = (1.3 * self.top.sse()).max(self.top.sse() - 4.0 * NEGLIGIBLE * self.variance);
        let lag = from.fit.lag() + lag;
        let found = self.evaluator.fit_around(self.view, &self.around, [s, j], start, lag, hopeless)?;
        if found.fit.gain == 0.0 {
            return None;
        }
        if found.sse() < self.top.sse() {
            self.top = found;
        }
        match known {
            Some(at) if found.sse() < self.cells[at].sse() => self.cells[at] = found,
            Some(_) => {}
            None => self.cells.push(found),
        }
        Some(found)
    }

    /// Walks from the best cell across the edges in s, to either side, then in j.
    fn walk(&mut self) {
        let home = self.top;
        self.walk_edges(home, WALK_S, [1e-4, 3.0], |c| c.cells[0], |edge| [edge, home.j.min(edge)]);
        let home = self.top;
        self.walk_edges(home, WALK_J, [0.0, home.s], |c| c.cells[1], |edge| [home.s, edge]);
    }

    /// Walks from the best cell to either side, at most `most` cells, while the edges are inside `range`; `place` gives the
    /// bands for an edge.
    fn walk_edges(
        &mut self,
        home: Candidate,
        most: usize,
        range: [f64; 2],
        cell: impl Fn(&Candidate) -> [f64; 2],
        place: impl Fn(f64) -> [f64; 2],
    ) {
        for up in [false, true] {
            let (mut at, mut warm, mut lost) = (home, home, 0);
            for _ in 0..most {
                let [low, high] = cell(&at);
                let edge = across([low, high], up);
                if !edge.is_finite() || edge <= range[0] || edge > range[1] {
                    break;
                }
                let [s, j] = place(edge);
                let Some(next) = self.visit(s, j, home.start, &warm, 0.0) else { break };
                if self.weight(next.sse()) > NEGLIGIBLE {
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

    /// Walks along the ridge to either side, point by point: all moves earlier with a longer lag, and the reverse.
    fn ridge(&mut self) {
        let home = self.top;
        if self.evaluator.slip(home.s, home.j, home.start).is_none() {
            return;
        }
        let moves = Moves::of(self.evaluator.steps(), home.law);
        for side in [-1, 1] {
            let (mut at, mut lost) = (home, 0);
            for by in 1..=MOST_LATER {
                let by = side * by;
                let normalised = self.evaluator.problem.normalised;
                let Some(bands) = moves.later(normalised, home.start, home.j, by) else { break };
                let lag = home.fit.lag() - by as f64 - at.fit.lag();
                let best = self.visit(bands.s, bands.j, bands.start, &at, lag).map(|c| self.settle_beside(c));
                let counts = best.is_some_and(|c| self.weight(c.sse()) > NEGLIGIBLE);
                self.on_ridge.extend(best);
                lost = if counts { 0 } else { lost + 1 };
                if lost == LOST_LATER {
                    break;
                }
                at = best.filter(|_| counts).unwrap_or(at);
            }
        }
    }

    /// Moves step by step to the best neighbouring cell or first slip, if the place may turn out to matter.
    fn settle_beside(&mut self, from: Candidate) -> Candidate {
        let mut best = from;
        for _ in 0..BESIDE {
            if self.weight(best.sse()) < WORTH_A_STEP {
                break;
            }
            let home = best;
            let [s, j] = [0, 1].map(|k| [false, true].map(|up| across(home.cells[k], up)));
            let starts = [home.start.extreme.saturating_sub(1), home.start.extreme + 1];
            let places = s.map(|s| (s, home.j.min(s), home.start)).into_iter();
            let places = places.chain(j.map(|j| (home.s, j, home.start)));
            let places = places.chain(starts.map(|extreme| (home.s, home.j, Start { extreme, ..home.start })));
            for (s, j, start) in places.filter(|(s, j, _)| s.is_finite() && j.is_finite()) {
                let next = self.visit(s, j, start, &home, 0.0);
                best = next.filter(|c| c.sse() < best.sse()).unwrap_or(best);
            }
            if best.sse() >= home.sse() {
                break;
            }
        }
        best
    }

    /// The range of a value over the places on the ridge that explain the record nearly as well as the best one.
    fn profile_range(&self, of: impl Fn([f64; 2]) -> f64, value: f64) -> [f64; 2] {
        let near = self.on_ridge.iter().filter(|c| self.weight(c.sse()) > PROFILE);
        near.fold([value, value], |all, c| hull(all, [of(centred(c)); 2]))
    }

    /// Random moves that favour high weights (Metropolis).
    fn wander(&mut self, rng: &mut ChaCha8Rng) {
        let mut at = self.top;
        for _ in 0..MOVES {
            let kind = uniform(rng);
            let (mut s, mut j, mut start, mut lag) = (at.s, at.j, at.start, 0.0);
            let sigma = 0.05 * libm::pow(10.0, -2.0 * uniform(rng)) * at.s;
            if kind < 0.7 {
                if kind < 0.45 {
                    s = moved(s, at.cells[0], sigma, rng);
                }
                if kind > 0.25 {
                    j = moved(j, at.cells[1], 4.0 * sigma, rng);
                }
            } else if kind < 0.85 {
                lag = 1.5 * normal(rng);
                s -= lag * self.evaluator.problem.normalised.rate;
            } else if kind < 0.95 {
                let list = self.evaluator.problem.normalised.extremes[usize::from(!start.up)].len();
                let by = 1 + (3.0 * uniform(rng) * uniform(rng)) as usize;
                let up = uniform(rng) < 0.5;
                start.extreme =
                    if up { (start.extreme + by).min(list.max(1) - 1) } else { start.extreme.saturating_sub(by) };
            } else {
                start.place = uniform(rng);
            }
            let Some(next) = self.visit(s, j, start, &at, lag) else { continue };
            let gain = self.weight(next.sse()) - self.weight(at.sse());
            if gain >= 0.0 || libm::log(uniform(rng).max(1e-300)) < gain {
                at = next;
            }
        }
    }

    /// The range of j that the slips of all relevant cells allow.
    fn allowed(&self, j: f64) -> [f64; 2] {
        let count = self.cells.iter().filter(|c| self.weight(c.sse()) > NEGLIGIBLE / 4.0);
        count.fold([j, j], |all, c| {
            hull(all, [c.cells[1][0].min(j), c.cells[1][1].min(c.cells[0][1].min(c.s.max(1.0)))])
        })
    }

    /// Walks from the cells of other candidates with enough weight.
    fn meet(&mut self, rivals: &[Candidate]) {
        let class = self.top.class;
        for rival in rivals.iter().filter(|c| c.class == class).take(RIVALS) {
            let found = self.visit(rival.s, rival.j, rival.start, rival, 0.0);
            let Some(found) = found.filter(|c| self.weight(c.sse()) > NEGLIGIBLE) else { continue };
            self.walk_edges(found, WALK_J, [1e-4, 3.0], |c| c.cells[0], |edge| [edge, found.j.min(edge)]);
        }
    }

    /// Weighted sampling points of all relevant cells, and whether the best cell cannot separate fd from the gain.
    fn mixture(&mut self) -> (Mixture, bool) {
        let (mut places, mut flat) = (Vec::new(), false);
        let mut order: Vec<Candidate> =
            self.cells.iter().copied().filter(|c| self.weight(c.sse()) > NEGLIGIBLE).collect();
        order.sort_by(|a, b| a.sse().total_cmp(&b.sse()));
        // Each rectangle counts once, with its best first slip.
        let mut cells: Vec<Candidate> = Vec::new();
        for c in order {
            if !cells.iter().any(|t| t.covers(c.s, c.j, t.start)) {
                cells.push(c);
            }
        }
        for c in &cells {
            let Some((profile, [fd_low, fd_high])) = self.evaluator.profile(self.view, &self.around, c) else {
                continue;
            };
            let least = profile.sse(c.fit.fd);
            let even = profile.is_flat();
            if c.sse() <= self.top.sse() {
                flat = even;
            }
            let s_high = if c.cells[0][1].is_finite() { c.cells[0][1] } else { c.s.max(1.0) };
            let s_width = s_high - c.cells[0][0];
            let stretch = self.stretch;
            let sse = |fd: f64| {
                if even {
                    c.sse()
                } else {
                    c.sse() + (profile.sse(c.fit.fd + (fd - c.fit.fd) / stretch) - least).max(0.0)
                }
            };
            let band = self.band_that_counts(&sse, [fd_low, fd_high], c.fit.fd);
            let step = (band[1] - band[0]) / PLACES[1] as f64;
            let area = (s_width / PLACES[0] as f64) * step.max(1e-12);
            for m in 0..PLACES[1] {
                let fd = band[0] + (m as f64 + 0.5) * step;
                let weight = libm::exp(self.weight(sse(fd)).min(0.0)) * area;
                // Rows are shifted against each other, so that s is uniform over the cell instead of taking a few values.
                let shift = (m as f64 * GOLDEN).fract();
                for k in 0..PLACES[0] {
                    let s = c.cells[0][0] + s_width * (k as f64 + shift) / PLACES[0] as f64;
                    let j = s - 2.0 * fd;
                    // The ends of a cell belong to it, so that each cell contributes at least one point.
                    if j >= c.cells[1][0] - 2.0 * step && j <= c.cells[1][1] + 2.0 * step && j <= s + 2.0 * step {
                        places.push(Place { s, j: j.max(0.0), weight });
                    }
                }
            }
        }
        (Mixture { places }, flat)
    }

    /// The part of a band of fd with relevant weight, found from its best value outwards by bisection.
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

/// One point in the plane of (s, j).
#[derive(Debug, Clone, Copy)]
struct Place {
    s: f64,
    j: f64,
    weight: f64,
}

/// Weighted points.
struct Mixture {
    places: Vec<Place>,
}

impl Mixture {
    /// Interval of a value without [`TAIL`] on either side; empty (end before start) without points.
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
