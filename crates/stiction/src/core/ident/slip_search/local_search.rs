//! Improves a candidate by local search.
//!
//! The plane of (s, j) is tiled by cells that give the same slips; within a cell the error is constant once fd is fitted. The
//! right cell may be a few tenths of a per cent wide, so steps go just across the edges of the current cell, or are drawn from
//! many scales.

use rand_chacha::ChaCha8Rng;

use super::candidate::{Candidate, LatticeFit, apart};
use super::evaluator::Evaluator;
use crate::core::ident::evaluator::View;
use crate::core::ident::normalised::{SlipEnd, Start};
use crate::core::ident::random::{moved, normal, uniform};

/// Smallest s of the search, spans.
pub(crate) const LEAST_S: f64 = 1e-4;
/// Cells per side in a walk over neighbours.
const CELLS: usize = 4;
/// How far such a walk goes in s, as a share of s, and in j.
const REACH: [f64; 2] = [0.05, 0.15];
/// Relative gain below which the neighbours count as no improvement.
const NO_GAIN: f64 = 1e-4;
/// Error relative to the best one up to which places on the ridge are kept.
const ON_RIDGE: f64 = 2.5;
/// The same limit for refining their processes.
const ON_RIDGE_REFINED: f64 = 1.2;

/// Smallest s of a walk from cell to cell, as a share of its starting s.
const LEAST_ALONG: f64 = 0.5;
/// Error relative to the last followed cell's from which a cell is skipped, and the relative distance in s after which the next
/// cell is followed in any case.
const COMB: f64 = 1.5;
const FOLLOWED_FOR: f64 = 0.02;
/// Offsets of the stem before the record from OP's first value, as shares of fs, and the relative distance in s after which all
/// are tried again.
pub(super) const STEMS: [f64; 21] = [
    -0.98, -0.88, -0.78, -0.69, -0.59, -0.49, -0.39, -0.29, -0.2, -0.1, 0.0, 0.1, 0.2, 0.29, 0.39, 0.49, 0.59, 0.69,
    0.78, 0.88, 0.98,
];
const OTHER_STEMS: f64 = 0.01;

/// How close to the best error a process's error must be for the process to be refined.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Nearness {
    /// Least and largest relative distance, for random steps.
    pub within: [f64; 2],
    /// This times the share of PV that the best candidate leaves: if it leaves much, errors differ little from cell to cell,
    /// and all would be refined.
    pub at_share: f64,
    /// Factor of the distance for neighbouring cells.
    pub cells: f64,
}

impl Nearness {
    /// The daemon's setting.
    pub(crate) const USUAL: Self = Self { within: [1e-3, 0.01], at_share: 3e-4, cells: 2.0 };

    /// Error up to which a random step from a candidate is refined.
    fn of_step(&self, best: &Candidate, view: &View) -> f64 {
        best.sse() * (1.0 + self.distance(best, view))
    }

    /// The same for a neighbouring cell.
    fn of_cell(&self, best: &Candidate, view: &View) -> f64 {
        best.sse() * (1.0 + self.cells * self.distance(best, view))
    }

    fn distance(&self, best: &Candidate, view: &View) -> f64 {
        let share = best.sse() / view.nothing().max(1e-300);
        (self.at_share / share.max(1e-300)).clamp(self.within[0], self.within[1])
    }
}

/// A value just across an edge of a cell.
#[must_use]
pub(crate) fn across(cell: [f64; 2], up: bool) -> f64 {
    if up { cell[1] * (1.0 + 1e-9) + 1e-12 } else { cell[0] * (1.0 - 1e-9) - 1e-12 }
}

/// The bands within the valve's limits, or `None` if no friction is left.
fn kept(evaluator: &Evaluator<'_>, s: f64, j: f64) -> Option<[f64; 2]> {
    let s = s.min(1.0);
    (s.is_finite() && j.is_finite() && s >= LEAST_S).then(|| [s, evaluator.problem.normalised.slip_end.keep(s, j)])
}

/// Values of j to try with another s on the ridge where an earlier slip and a longer lag look alike: the same j, the same share
/// of s, the same fd, and the same fs (the stem then rests farther from OP's reversal by the change in s).
fn ridge_jumps([from_s, from_j]: [f64; 2], s: f64, slip_end: SlipEnd) -> [f64; 4] {
    let moved = s - from_s;
    [from_j, from_j / from_s * s, from_j + moved, from_j - moved].map(|j| slip_end.keep(s, j))
}

/// The same process with its lag shifted.
fn later(fit: &LatticeFit, by: f64) -> LatticeFit {
    LatticeFit { delay: (fit.lag() + by).max(0.0) as usize, ..*fit }
}

/// Random steps from a candidate; a worse one is never accepted.
pub(crate) fn random_steps(
    evaluator: &mut Evaluator<'_>,
    view: &mut View,
    from: Candidate,
    count: usize,
    near: Nearness,
    rng: &mut ChaCha8Rng,
) -> Candidate {
    (evaluator.class, evaluator.law) = (from.class, from.law);
    let mut best = from;
    for _ in 0..count {
        let (s, j, start, lag) = random_step(evaluator, &best, rng);
        let Some([s, j]) = kept(evaluator, s, j) else { continue };
        if best.covers(s, j, start) {
            continue;
        }
        let enough = near.of_step(&best, view);
        let found = evaluator.fit(view, [s, j], start, &later(&best.fit, lag), enough);
        if let Some(found) = found.filter(|f| f.sse() <= best.sse() && f.fit.gain != 0.0) {
            best = found;
        }
    }
    best
}

/// Draws the next random step: bands, first slip, and the change of lag that goes with them.
fn random_step(evaluator: &Evaluator<'_>, from: &Candidate, rng: &mut ChaCha8Rng) -> (f64, f64, Start, f64) {
    let normalised = evaluator.problem.normalised;
    let (mut s, mut j, mut start, mut lag) = (from.s, from.j, from.start, 0.0);
    let kind = uniform(rng);
    if kind < 0.65 {
        let sigma = 0.1 * libm::pow(10.0, -2.2 * uniform(rng));
        if !(0.25..0.43).contains(&kind) {
            s = moved(s, from.cells[0], sigma * s, rng);
        }
        if kind >= 0.25 {
            j = moved(j, from.cells[1], 4.0 * sigma * s.max(j), rng);
        }
        if uniform(rng) < 0.15 {
            lag = normal(rng);
        }
        if uniform(rng) < 0.06 {
            // A staircase with half or double steps agrees with the right one at every other step.
            j *= [0.5, 2.0, 2.0 / 3.0, 1.5][(4.0 * uniform(rng)) as usize];
        }
    } else if kind < 0.78 {
        // Along the ridge: an earlier slip and a longer lag look alike.
        lag = 3.0 * uniform(rng) * normal(rng);
        s -= lag * normalised.rate;
        j = ridge_jumps([from.s, from.j], s, normalised.slip_end)[(4.0 * uniform(rng)) as usize];
        if uniform(rng) < 0.5 {
            start = normalised.moved_start(start, -lag);
        }
    } else if kind < 0.92 {
        start = another_start(evaluator, start, rng);
        if uniform(rng) < 0.5 {
            s = moved(s, from.cells[0], 0.01 * s, rng);
        }
    } else {
        start.place = uniform(rng);
    }
    (s, j, start, lag)
}

/// A first slip at a neighbouring extreme of OP, occasionally anywhere on either side.
fn another_start(evaluator: &Evaluator<'_>, from: Start, rng: &mut ChaCha8Rng) -> Start {
    let count = |up: bool| evaluator.problem.normalised.extremes[usize::from(!up)].len();
    let by = 1 + (3.0 * uniform(rng) * uniform(rng)) as usize;
    let extreme = if uniform(rng) < 0.5 { from.extreme + by } else { from.extreme.saturating_sub(by) };
    let extreme = extreme.min(count(from.up).max(1) - 1);
    if uniform(rng) < 0.25 || extreme == from.extreme {
        let up = uniform(rng) < 0.5;
        return Start { up, extreme: (uniform(rng) * count(up) as f64) as usize, place: 0.5 };
    }
    Start { extreme, ..from }
}

/// A walk over neighbours that keeps the best one.
struct Neighbours<'e, 'a, 'v> {
    evaluator: &'e mut Evaluator<'a>,
    view: &'v mut View,
    near: Nearness,
    best: Candidate,
}

impl Neighbours<'_, '_, '_> {
    fn look(&mut self, s: f64, j: f64, start: Start, fit: LatticeFit) -> Option<Candidate> {
        let bands = kept(self.evaluator, s, j)?;
        let enough = self.near.of_cell(&self.best, self.view);
        let found = self.evaluator.fit(self.view, bands, start, &fit, enough)?;
        if found.sse() < self.best.sse() && found.fit.gain != 0.0 {
            self.best = found;
        }
        Some(found)
    }

    /// Tries the cells to one side in s, with the jump fixed or moved along, then those in j.
    fn cells(&mut self, home: &Candidate, up: bool) {
        let (mut s, mut cell) = (home.s, home.cells[0]);
        for _ in 0..CELLS {
            let edge = across(cell, up);
            if !edge.is_finite() || (edge - s).abs() > REACH[0] * s {
                break;
            }
            s = edge;
            let Some(found) = self.look(s, home.j, home.start, self.best.fit) else { break };
            cell = found.cells[0];
            self.look(s, home.j + s - home.s, home.start, self.best.fit);
        }
        let (mut j, mut cell) = (home.j, home.cells[1]);
        for _ in 0..CELLS {
            let edge = across(cell, up);
            if !edge.is_finite() || (edge - j).abs() > REACH[1] * home.s {
                break;
            }
            j = edge;
            let Some(found) = self.look(home.s, j, home.start, self.best.fit) else { break };
            cell = found.cells[1];
        }
        for up_in_j in [false, true] {
            self.look(across(home.cells[0], up), across(home.cells[1], up_in_j), home.start, self.best.fit);
        }
    }

    /// Tries places along the ridge, and first slips before and after.
    fn ridge_and_starts(&mut self, home: &Candidate, up: bool) {
        let (rate, count) = {
            let normalised = self.evaluator.problem.normalised;
            (normalised.rate.max(1e-6), normalised.extremes[usize::from(!home.start.up)].len())
        };
        for lag in [0.3, 0.7, 1.5].map(|lag: f64| if up { lag } else { -lag }) {
            let s = home.s - lag * rate;
            self.look(s, home.j, home.start, later(&home.fit, lag));
            self.look(s, home.j + s - home.s, home.start, later(&home.fit, lag));
        }
        for by in [1, 2, 4] {
            let extreme = if up {
                (home.start.extreme + by).min(count.max(1) - 1)
            } else {
                home.start.extreme.saturating_sub(by)
            };
            if extreme != home.start.extreme {
                self.look(home.s, home.j, Start { extreme, ..home.start }, home.fit);
            }
        }
    }

    /// Improves the threshold of the first slip by a parabola through three values.
    fn threshold(&mut self, home: &Candidate) {
        let errors = [0.0, 0.5, 1.0].map(|place| {
            let found = self.look(home.s, home.j, Start { place, ..home.start }, home.fit);
            found.map_or(f64::INFINITY, |c| c.sse())
        });
        let bend = errors[0] - 2.0 * errors[1] + errors[2];
        if bend > 1e-9 * errors[1] && bend.is_finite() {
            let place = 0.5 + 0.25 * (errors[0] - errors[2]) / bend;
            if (0.0..1.0).contains(&place) {
                self.look(home.s, home.j, Start { place, ..home.start }, home.fit);
            }
        }
    }
}

/// Tries neighbouring cells, first slips and thresholds, `rounds` times or until none is better.
pub(crate) fn neighbours(
    evaluator: &mut Evaluator<'_>,
    view: &mut View,
    from: Candidate,
    rounds: usize,
    near: Nearness,
) -> Candidate {
    (evaluator.class, evaluator.law) = (from.class, from.law);
    let mut walk = Neighbours { evaluator, view, near, best: from };
    for _ in 0..rounds {
        let home = walk.best;
        for up in [false, true] {
            walk.cells(&home, up);
            walk.ridge_and_starts(&home, up);
        }
        walk.threshold(&home);
        if walk.best.sse() >= (1.0 - NO_GAIN) * home.sse() {
            break;
        }
    }
    walk.best
}

/// Samples the ridge around a candidate evenly, `reach` (a share of s) to either side; returns the best places.
pub(crate) fn along_ridge(
    evaluator: &mut Evaluator<'_>,
    view: &mut View,
    around: &Candidate,
    reach: f64,
    steps: usize,
) -> Vec<Candidate> {
    let slip_end = evaluator.problem.normalised.slip_end;
    let mut pool = vec![*around];
    let mut least = around.sse();
    for side in [-1.0, 1.0] {
        let mut walk = RidgeWalk::new(evaluator, view, around, least);
        for k in 1..=steps {
            let s = (around.s * (1.0 + side * reach * k as f64 / steps as f64)).min(1.0);
            let Some([s, near]) = kept(walk.evaluator, s, walk.last.j) else { continue };
            let starts = [walk.last.start, walk.moved_start(s)];
            let [same, share, with_s, against] = ridge_jumps([around.s, around.j], s, slip_end);
            let found = walk.look(s, [same, near, share, with_s, against], &starts);
            if let Some(best) = found.filter(|b| b.sse() < ON_RIDGE * around.sse()) {
                walk.last = best;
            }
        }
        least = walk.least;
        pool.append(&mut walk.pool);
    }
    apart(&pool, 4, 0)
}

/// Walks along the ridge from cell to cell of s, at most `most` cells per side; returns the best places. If a stem moves
/// seldom, the error is a comb of cells a fraction of a per cent wide, and no cell's error predicts the next one's.
pub(crate) fn along_cells(
    evaluator: &mut Evaluator<'_>,
    view: &mut View,
    around: &Candidate,
    most: usize,
) -> Vec<Candidate> {
    let mut pool = vec![*around];
    for up in [false, true] {
        let mut walk = RidgeWalk::new(evaluator, view, around, around.sse());
        let (mut cell, mut asked) = (around.cells[0], 0.0);
        for _ in 0..most {
            let s = across(cell, up);
            if !(LEAST_ALONG * around.s..=1.0).contains(&s) {
                break;
            }
            let slip_end = walk.evaluator.problem.normalised.slip_end;
            let [same, share, _, against] = ridge_jumps([walk.last.s, walk.last.j], s, slip_end);
            let moved = walk.moved_start(s);
            let beside = |by: isize| Start { extreme: moved.extreme.saturating_add_signed(by), ..moved };
            let mut starts = vec![walk.last.start, moved];
            starts.extend([1, 2, -1, -2].map(beside));
            if (s / asked - 1.0).abs() > OTHER_STEMS {
                asked = s;
                starts.extend(walk.evaluator.problem.starts(0.5 * (s + same), &STEMS));
            }
            let Some(found) = walk.look(s, [same, share, against], &starts) else { break };
            cell = found.cells[0];
            // Follow the comb along its lower edge.
            if found.sse() < COMB * walk.last.sse() || (s / walk.last.s - 1.0).abs() > FOLLOWED_FOR {
                walk.last = found;
            }
        }
        pool.append(&mut walk.pool);
    }
    apart(&pool, 6, 0)
}

/// A walk along the ridge where an earlier slip and a longer lag look alike.
struct RidgeWalk<'e, 'a, 'v> {
    evaluator: &'e mut Evaluator<'a>,
    view: &'v mut View,
    /// The last place that was followed.
    last: Candidate,
    /// Least error found.
    least: f64,
    pool: Vec<Candidate>,
}

impl<'e, 'a, 'v> RidgeWalk<'e, 'a, 'v> {
    fn new(evaluator: &'e mut Evaluator<'a>, view: &'v mut View, from: &Candidate, least: f64) -> Self {
        (evaluator.class, evaluator.law) = (from.class, from.law);
        Self { evaluator, view, last: *from, least, pool: Vec::new() }
    }

    /// Points by which another s delays the slips relative to the place that is followed.
    fn later_by(&self, s: f64) -> f64 {
        (s - self.last.s) / self.evaluator.problem.normalised.rate.max(1e-6)
    }

    /// The first slip that belongs to another s.
    fn moved_start(&self, s: f64) -> Start {
        self.evaluator.problem.normalised.moved_start(self.last.start, self.later_by(s))
    }

    /// The best of several first slips with the first jump, then of the other jumps with that start.
    fn look<const N: usize>(&mut self, s: f64, jumps: [f64; N], starts: &[Start]) -> Option<Candidate> {
        let guess = later(&self.last.fit, -self.later_by(s));
        let mut best: Option<Candidate> = None;
        for (k, start) in starts.iter().enumerate() {
            if !starts[..k].contains(start) {
                self.keep(s, jumps[0], *start, &guess, &mut best);
            }
        }
        let start = best?.start;
        for (k, j) in jumps.iter().enumerate().skip(1) {
            if !jumps[..k].contains(j) {
                self.keep(s, *j, start, &guess, &mut best);
            }
        }
        self.pool.extend(best);
        best
    }

    fn keep(&mut self, s: f64, j: f64, start: Start, guess: &LatticeFit, best: &mut Option<Candidate>) {
        let found = self.evaluator.fit(self.view, [s, j], start, guess, ON_RIDGE_REFINED * self.least);
        let Some(found) = found.filter(|f| f.fit.gain != 0.0) else { return };
        self.least = self.least.min(found.sse());
        if best.is_none_or(|b| found.sse() < b.sse()) {
            *best = Some(found);
        }
    }
}
