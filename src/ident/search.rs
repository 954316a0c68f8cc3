//! The search over candidates: a global look by any solver, then the exact cells.
//!
//! In (s, j) the plane is tiled by rectangles that give the same slips; inside one the cost is constant once fd is
//! fitted. The right rectangle may be a few tenths of a per cent wide, so the best places of the global look are
//! improved by random steps, a third of them to just across the edge of the rectangle at hand.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use super::candidate::{Bench, Candidate, Effort, Start};
use super::class::Shape;
use crate::optim::Objective;
use crate::optim::local::on_triangle;

/// A uniform draw from 0 to below 1.
pub(super) fn uniform(rng: &mut ChaCha8Rng) -> f64 {
    (rng.next_u64() >> 11) as f64 / (1_u64 << 53) as f64
}

/// A normal draw (the sum of twelve uniform ones, less six).
pub(super) fn normal(rng: &mut ChaCha8Rng) -> f64 {
    (0..12).map(|_| uniform(rng)).sum::<f64>() - 6.0
}

/// The global look as a solver sees it; keeps everything that it is asked for.
#[derive(Debug)]
pub struct Look<'b, 'a> {
    bench: &'b mut Bench<'a>,
    /// Everything fitted so far.
    pub pool: Vec<Candidate>,
    /// Shapes that every candidate starts from.
    cold: Vec<Shape>,
    warm: Option<(f64, Shape)>,
    starts: usize,
    steps: usize,
}

impl<'b, 'a> Look<'b, 'a> {
    /// A look with `starts` stem positions a point and `steps` Gauss-Newton steps a candidate.
    pub fn new(bench: &'b mut Bench<'a>, starts: usize, steps: usize) -> Self {
        let period = bench.question.period;
        let limits = bench.question.limits;
        let class = bench.class;
        let shape = |tau: f64, lag: f64| class.clamp(class.start(tau, lag), &limits);
        let near = limits.lag[0];
        let cold = vec![
            shape(0.03 * period, near + 0.015 * period),
            shape(0.1 * period, near + 0.03 * period),
            shape(0.1 * period, near + 0.1 * period),
            shape(2.0 * period, near + 0.03 * period),
        ];
        Self { bench, pool: Vec::new(), cold, warm: None, starts, steps }
    }

    /// Cost of one point with one start, fitted or remembered.
    fn ask(&mut self, s: f64, j: f64, start: Start) -> f64 {
        if let Some(known) = self.pool.iter().rev().find(|c| c.covers(s, j, start)) {
            return known.fit.sse;
        }
        let mut shapes = self.cold.clone();
        shapes.extend(self.warm.map(|w| w.1));
        let hopeless = self.warm.map_or(f64::INFINITY, |w| 4.0 * w.0);
        let Some(found) = self.bench.fit(s, j, start, &shapes, Effort { steps: self.steps, hopeless }) else {
            return f64::INFINITY;
        };
        if self.warm.is_none_or(|w| found.fit.sse < w.0) && found.fit.gain != 0.0 {
            self.warm = Some((found.fit.sse, found.fit.shape));
        }
        self.pool.push(found);
        found.fit.sse
    }
}

impl Objective for Look<'_, '_> {
    fn cost(&mut self, point: [f64; 2]) -> f64 {
        let [s, j] = point;
        if s < 1e-4 {
            return f64::INFINITY;
        }
        let starts = self.bench.question.starts(0.5 * (s + j), self.starts);
        starts.into_iter().map(|start| self.ask(s, j, start)).fold(f64::INFINITY, f64::min)
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
            let here = (3.0 * c.j / c.s).floor().clamp(0.0, 2.0) as i32 == third;
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
        let Step { s, j, start: first, lag } = step(bench, &best, fine, rng);
        if s < 1e-4 || best.covers(s, j, first) {
            continue;
        }
        let effort = Effort { steps: 1, hopeless: 2.0 * best.fit.sse };
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

fn step(bench: &Bench<'_>, from: &Candidate, fine: bool, rng: &mut ChaCha8Rng) -> Step {
    let kind = uniform(rng);
    let (mut s, mut j, mut start, mut lag) = (from.s, from.j, from.start, 0.0);
    if kind < 0.65 {
        let sigma = if fine { 0.05 } else { 0.1 * libm::pow(10.0, -2.2 * uniform(rng)) };
        if !(0.25..0.43).contains(&kind) {
            s = moved(s, from.s_cell, sigma * s, rng);
        }
        if kind >= 0.25 {
            j = moved(j, from.j_cell, 4.0 * sigma * s, rng);
        }
        if uniform(rng) < 0.15 {
            // The cost has kinks at whole lags.
            lag = normal(rng);
        }
    } else if kind < 0.78 {
        // Along the ridge: an earlier slip and a longer lag look alike.
        lag = 3.0 * uniform(rng) * normal(rng);
        s -= lag * bench.question.rate;
        if uniform(rng) < 0.5 {
            j = j / from.s * s;
        }
    } else if kind < 0.92 {
        let list = bench.question.records[usize::from(!start.up)].len();
        let by = 1 + (3.0 * uniform(rng) * uniform(rng)) as usize;
        start.record =
            if uniform(rng) < 0.5 { (start.record + by).min(list - 1) } else { start.record.saturating_sub(by) };
        if uniform(rng) < 0.25 || start.record == from.start.record {
            // Anywhere, on either side.
            let up = uniform(rng) < 0.5;
            let list = bench.question.records[usize::from(!up)].len();
            start = Start { up, record: (uniform(rng) * list as f64) as usize, place: 0.5 };
        }
        if uniform(rng) < 0.5 {
            s = moved(s, from.s_cell, 0.01 * s, rng);
        }
    } else {
        start.place = uniform(rng);
    }
    let [s, j] = on_triangle([s, j]);
    Step { s, j, start, lag }
}

/// A value just across an edge of its cell (30 %), else a normal step.
fn moved(value: f64, cell: [f64; 2], sigma: f64, rng: &mut ChaCha8Rng) -> f64 {
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
