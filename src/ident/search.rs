//! The search over candidates: a global look by any solver, then the exact cells.
//!
//! In (s, j) the plane is tiled by rectangles that give the same slips; inside one the cost is constant once fd is
//! fitted. The right rectangle may be a few tenths of a per cent wide, so the best places of the global look are
//! improved by random steps, a third of them to just across the edge of the rectangle at hand.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use super::bank::{BINS, Bank, Glance};
use super::candidate::{Bench, Candidate, Effort, Landing, MIN_SLIPS, Question, Start, freedom};
use super::class::Class;
use super::fit::Fitted;
use crate::optim::Objective;
use crate::sim::slips::{Law, Sequence};

/// Boxes a period of the first looks.
const COARSE: f64 = 20.0;
/// Boxes a period of the later looks, and of the error surface.
pub const FINE: f64 = 40.0;
/// Turns of the stem below which several positions before the record are looked at.
const FEW_REVERSALS: usize = 8;
/// Cost over the best one up to which a place is kept for its dead time.
const NOT_FAR: f64 = 1.3;
/// Cost over the best one from which a step is not worth refining.
const HOPELESS: f64 = 2.5;
/// Cost over the best one that a refinement must promise by its slopes.
const WANTED: f64 = 1.1;

/// A uniform draw from 0 to below 1.
pub fn uniform(rng: &mut ChaCha8Rng) -> f64 {
    (rng.next_u64() >> 11) as f64 / (1_u64 << 53) as f64
}

/// A normal draw (the sum of twelve uniform ones, less six).
pub fn normal(rng: &mut ChaCha8Rng) -> f64 {
    (0..12).map(|_| uniform(rng)).sum::<f64>() - 6.0
}

/// The global look as a solver sees it: every point against the whole bank; keeps everything that it is asked for.
#[derive(Debug)]
pub struct Look<'a> {
    question: &'a Question,
    law: Law,
    signs: &'a [f64],
    bank: Bank,
    sequence: Sequence,
    evaluations: u64,
    /// Everything looked at so far, by sign and view, cost and shape those of the bank.
    pub pools: Vec<[Vec<Candidate>; 2]>,
    /// The better part of it by sign and range of dead time, both views together.
    pub strata: Vec<[Stratum; BINS]>,
}

/// Places that suit one range of dead time, by view: the best ones and those not far behind.
pub type Stratum = [Vec<Candidate>; 2];

impl<'a> Look<'a> {
    /// A look for one law and these signs of the gain.
    #[must_use]
    pub fn new(question: &'a Question, law: Law, signs: &'a [f64]) -> Self {
        let pools = signs.iter().map(|_| [Vec::new(), Vec::new()]).collect();
        let strata = signs.iter().map(|_| core::array::from_fn(|_| [Vec::new(), Vec::new()])).collect();
        let bank = Bank::new(question, COARSE);
        Self { question, law, signs, bank, sequence: Sequence::default(), evaluations: 0, pools, strata }
    }

    /// Valve signals looked at.
    #[must_use]
    pub const fn evaluations(&self) -> u64 {
        self.evaluations
    }

    /// Goes on in finer boxes with the best places of every view; the others are forgotten.
    pub fn sharpen(&mut self) {
        let best: Vec<Candidate> = self.pools.iter().flatten().flat_map(|pool| beam(pool, 12, 4)).collect();
        self.bank = Bank::new(self.question, FINE);
        let strata: Vec<Candidate> = self.strata.iter().flatten().flatten().flat_map(|kept| beam(kept, 3, 0)).collect();
        let pools = self.pools.iter_mut().flatten();
        for pool in pools.chain(self.strata.iter_mut().flatten().flatten()) {
            pool.clear();
        }
        for c in best.into_iter().chain(strata) {
            self.ask(c.s, c.j, c.start);
        }
    }

    /// Cost of one point with one start, looked up or remembered.
    fn ask(&mut self, s: f64, j: f64, start: Start) -> f64 {
        let Some([plain, _]) = self.pools.first() else { return f64::INFINITY };
        if let Some(known) = plain.iter().rev().find(|c| c.covers(s, j, start)) {
            return known.fit.sse;
        }
        let q = self.question;
        let (per_box, whole) = (q.per_point * self.bank.points, q.mean.len() / self.bank.points * self.bank.points);
        let path = &q.path[..whole * q.per_point];
        self.sequence.run_in(q.stroke, self.law, path, per_box, [s, j], q.first_slip(start));
        let v = &self.sequence;
        if v.slips < MIN_SLIPS {
            return f64::INFINITY;
        }
        let freedom = freedom(v, [s, j], 1.0, q.limits, q.landing);
        self.evaluations += 1;
        let glances = self.bank.look(&v.at, &v.direction, &freedom, self.signs);
        let (s_cell, j_cell) = (v.s_cell, v.j_cell);
        let candidate = |glance: Glance| {
            let shape = Class::First.clamp([libm::log(glance.tau), glance.lag, 0.0], &q.limits);
            let gain = if glance.share < 1.0 { 1.0 } else { 0.0 };
            let fit = Fitted { sse: glance.share, gain, fd: freedom.fd_default, memory: [0.0; 3], shape };
            Candidate { s, j, start, s_cell, j_cell, slips: v.slips, reversals: v.reversals, fit }
        };
        let mut cost = f64::INFINITY;
        for ((pools, strata), views) in self.pools.iter_mut().zip(&mut self.strata).zip(&glances) {
            for (view, bins) in views.iter().enumerate() {
                for (bin, glance) in bins.iter().enumerate() {
                    let kept = &mut strata[bin][view];
                    // The first of a list is its best.
                    let best = kept.first().map_or(f64::INFINITY, |c| c.fit.sse);
                    if glance.share < NOT_FAR * best {
                        kept.push(candidate(*glance));
                        if glance.share < best {
                            let last = kept.len() - 1;
                            kept.swap(0, last);
                        }
                    }
                }
                let best = bins.iter().min_by(|a, b| a.share.total_cmp(&b.share));
                pools[view].extend(best.map(|g| candidate(*g)));
            }
            cost = views[0].iter().map(|g| g.share).fold(cost, f64::min);
        }
        cost
    }
}

impl Look<'_> {
    /// Random steps from each of `from`, the best places of one sign's view: here every step sees all dead times, so
    /// the ridge of an earlier slip with a longer dead time is no obstacle.
    pub fn climb(&mut self, sign: usize, view: usize, from: Vec<Candidate>, steps: usize, rng: &mut ChaCha8Rng) {
        for mut best in from {
            for _ in 0..steps {
                let Step { s, j, start, .. } = step(self.question, &best, false, rng);
                if s < 1e-4 || best.covers(s, j, start) {
                    continue;
                }
                let known = self.pools[sign][view].len();
                self.ask(s, j, start);
                if let Some(found) = self.pools[sign][view].get(known).filter(|f| f.fit.sse <= best.fit.sse) {
                    best = *found;
                }
            }
        }
    }
}

impl Look<'_> {
    /// Straight looks through each of `from`: along s, along s with j in proportion, along j.
    pub fn cross(&mut self, from: &[Candidate]) {
        let landing = self.question.landing;
        for c in from {
            for k in -24..=24 {
                let s = (c.s * (1.0 + 0.008 * f64::from(k))).min(1.0);
                self.ask(s, landing.keep(s, c.j), c.start);
                self.ask(s, c.j / c.s * s, c.start);
            }
            for k in 0..36 {
                let j = c.s * libm::pow(0.03, f64::from(k) / 36.0);
                self.ask(c.s, landing.jump(c.s, j), c.start);
            }
        }
    }
}

impl Objective for Look<'_> {
    fn cost(&mut self, point: [f64; 2]) -> f64 {
        let [s, j] = point;
        if s < 1e-4 {
            return f64::INFINITY;
        }
        let j = self.question.landing.jump(s, j);
        // Where the stem stood before matters only while there are few slips.
        let first = self.question.starts(0.5 * (s + j), 1);
        let cost = first.iter().map(|start| self.ask(s, j, *start)).fold(f64::INFINITY, f64::min);
        if self.sequence.reversals >= FEW_REVERSALS {
            return cost;
        }
        let others = self.question.starts(0.5 * (s + j), 3);
        others.into_iter().map(|start| self.ask(s, j, start)).fold(cost, f64::min)
    }
}

/// The best candidates that stand apart: `overall` of them by cost, then `each` of every third of j/s, without which
/// models that slip at every sample would fill the list.
#[must_use]
pub fn beam(pool: &[Candidate], overall: usize, each: usize) -> Vec<Candidate> {
    let mut order: Vec<&Candidate> = pool.iter().filter(|c| c.fit.gain != 0.0).collect();
    order.sort_by(|a, b| a.fit.sse.total_cmp(&b.fit.sse));
    let mut chosen: Vec<Candidate> = Vec::new();
    let apart = |chosen: &[Candidate], c: &Candidate| {
        chosen.iter().all(|o| (o.s / c.s - 1.0).abs() > 0.012 || (o.j - c.j).abs() > 0.05 * c.s)
    };
    for c in &order {
        if chosen.len() < overall && apart(&chosen, c) {
            chosen.push(**c);
        }
    }
    for third in 0..3 {
        let mut taken = 0;
        for c in &order {
            let here = (3.0 * c.j.min(c.s) / c.j.max(c.s)).floor().clamp(0.0, 2.0) as i32 == third;
            if here && taken < each && apart(&chosen, c) {
                chosen.push(**c);
                taken += 1;
            }
        }
    }
    chosen
}

/// Random steps from `start`, `steps` of them, never to a worse place; `fine` draws from small steps only.
pub fn climb(bench: &mut Bench<'_>, start: Candidate, steps: usize, fine: bool, rng: &mut ChaCha8Rng) -> Candidate {
    let mut best = start;
    for _ in 0..steps {
        let Step { s, j, start: first, lag } = step(bench.question, &best, fine, rng);
        if s < 1e-4 || best.covers(s, j, first) {
            continue;
        }
        let effort = Effort { steps: 1, hopeless: HOPELESS * best.fit.sse, wanted: WANTED * best.fit.sse };
        let mut shape = best.fit.shape;
        shape[bench.class.shape_len() - 1] += lag;
        let shape = bench.class.clamp(shape, &bench.question.limits);
        let found = bench.fit(s, j, first, &[shape], effort);
        if let Some(found) = found.filter(|f| f.fit.sse <= best.fit.sse && f.fit.gain != 0.0) {
            best = found;
        }
    }
    best
}

/// Where the next random step goes.
struct Step {
    s: f64,
    j: f64,
    start: Start,
    /// Change of the lag that goes with it, points.
    lag: f64,
}

fn step(question: &Question, from: &Candidate, fine: bool, rng: &mut ChaCha8Rng) -> Step {
    let kind = uniform(rng);
    let (mut s, mut j, mut start, mut lag) = (from.s, from.j, from.start, 0.0);
    if kind < 0.65 {
        let sigma = if fine { 0.05 } else { 0.1 * libm::pow(10.0, -2.2 * uniform(rng)) };
        if !(0.25..0.43).contains(&kind) {
            s = moved(s, from.s_cell, sigma * s, rng);
        }
        if kind >= 0.25 {
            j = moved(j, from.j_cell, 4.0 * sigma * s.max(j), rng);
        }
        if uniform(rng) < 0.15 {
            // The cost has kinks at whole lags.
            lag = normal(rng);
        }
        if uniform(rng) < 0.06 {
            // A staircase of half or double steps meets the right one at every other step.
            j *= [0.5, 2.0, 2.0 / 3.0, 1.5][(4.0 * uniform(rng)) as usize];
        }
    } else if kind < 0.78 {
        // Along the ridge: an earlier slip and a longer lag look alike.
        lag = 3.0 * uniform(rng) * normal(rng);
        s -= lag * question.rate;
        j = ridge_jumps([from.s, from.j], s, question.landing)[(4.0 * uniform(rng)) as usize];
        if uniform(rng) < 0.5 {
            // All slips come earlier, the first one too.
            start = question.moved_start(start, -lag);
        }
    } else if kind < 0.92 {
        let list = question.records[usize::from(!start.up)].len();
        let by = 1 + (3.0 * uniform(rng) * uniform(rng)) as usize;
        start.record =
            if uniform(rng) < 0.5 { (start.record + by).min(list - 1) } else { start.record.saturating_sub(by) };
        if uniform(rng) < 0.25 || start.record == from.start.record {
            // Anywhere, on either side.
            let up = uniform(rng) < 0.5;
            let list = question.records[usize::from(!up)].len();
            start = Start { up, record: (uniform(rng) * list as f64) as usize, place: 0.5 };
        }
        if uniform(rng) < 0.5 {
            s = moved(s, from.s_cell, 0.01 * s, rng);
        }
    } else {
        start.place = uniform(rng);
    }
    let s = s.clamp(0.0, 1.0);
    let j = question.landing.keep(s, j);
    Step { s, j, start, lag }
}

/// Jumps that may go with another s on the ridge where an earlier slip and a longer lag look alike: the same, the same
/// share of s, the same fd, and the same fs (the stem then stands farther from where OP turns by as much).
pub(super) fn ridge_jumps([from_s, from_j]: [f64; 2], s: f64, landing: Landing) -> [f64; 4] {
    let moved = s - from_s;
    [from_j, from_j / from_s * s, from_j + moved, from_j - moved].map(|j| landing.keep(s, j))
}

/// A value just across an edge of its cell (30 %), else a normal step.
#[must_use]
pub fn moved(value: f64, cell: [f64; 2], sigma: f64, rng: &mut ChaCha8Rng) -> f64 {
    if uniform(rng) < 0.3 {
        let edge = if uniform(rng) < 0.5 { cell[0] * (1.0 - 1e-9) - 1e-12 } else { cell[1] * (1.0 + 1e-9) + 1e-12 };
        if edge.is_finite() && edge > 0.0 {
            return edge;
        }
    }
    value + sigma * normal(rng)
}

/// A generator for one purpose of one search.
#[must_use]
pub fn generator(seed: u64, purpose: u64) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(purpose);
    rng
}
