//! The first stage: places of the whole plane of bands, looked at coarsely.

use super::candidate::{Candidate, apart};
use super::coarse_scan::CoarseScan;
use super::evaluator::Evaluator;
use super::local_search::LEAST_S;
use super::settings::ScanSettings;
use crate::ident::search::uniform;
use crate::optim::{Objective, Outcome, Settings, Solver};
use crate::sim::slips::Law;
use crate::sim::steps::Step;
use rand_chacha::ChaCha8Rng;

/// Places of the stem before the record, shares of the static band from OP's first value.
const STARTS: [f64; 5] = [0.0, -0.9, 0.9, -0.45, 0.45];
/// Changes of the stem's direction from which its place before the record hardly matters, and from which it matters less.
const MANY_REVERSALS: usize = 8;
const SOME_REVERSALS: usize = 4;
/// Stretches of a period over which a sliding stem's steps are put together.
const LUMPS: f64 = 24.0;

/// The scan under one law: an objective for any solver, which keeps all that it sees.
#[derive(Debug)]
pub struct Scan<'e, 'a> {
    evaluator: &'e mut Evaluator<'a>,
    scans: Vec<CoarseScan>,
    /// Sum of squares that shares are taken of.
    whole: f64,
    lump: u32,
    lumped: Vec<Step>,
    /// Everything seen.
    pub pool: Vec<Candidate>,
    /// Valve signals looked at.
    pub looks: u64,
}

impl<'e, 'a> Scan<'e, 'a> {
    /// A scan of what the evaluator looks at, by the error behind `1 - rho q^-1`; `whole` is what no model leaves.
    #[must_use]
    pub fn new(evaluator: &'e mut Evaluator<'a>, rho: f64, whole: f64) -> Self {
        let scans = CoarseScan::of(evaluator.problem, rho, evaluator.points);
        let lump = ((evaluator.problem.question.period / LUMPS) as u32).max(1);
        Self { evaluator, scans, whole, lump, lumped: Vec::new(), pool: Vec::new(), looks: 0 }
    }

    /// The solver's look, then an even one on a logarithmic scale of s, which no linear grid gives to small bands.
    pub fn run(
        &mut self,
        solver: &dyn Solver,
        fineness_pct: f64,
        seed: u64,
        settings: &ScanSettings,
        rng: &mut ChaCha8Rng,
    ) -> Outcome {
        let asked = Settings { budget: settings.budget, fineness_pct, seed };
        let outcome = solver.search(self, &asked);
        // Another round sees other places.
        let shift = [uniform(rng), 0.3 + 0.4 * uniform(rng)];
        for a in 0..settings.sizes {
            let along = (a as f64 + shift[0]) / settings.sizes as f64;
            let s = libm::pow(settings.least_s, 1.0 - along);
            for b in 0..settings.jumps {
                self.cost([s, s * (b as f64 + shift[1]) / settings.jumps as f64]);
            }
        }
        outcome
    }

    /// Candidates worth a fit, best first.
    #[must_use]
    pub fn best(&self, settings: &ScanSettings) -> Vec<Candidate> {
        apart(&self.pool, settings.keep[0], settings.keep[1])
    }

    /// Puts the steps of a sliding stem together.
    fn lump_steps(&mut self) {
        self.lumped.clear();
        let mut from = 0;
        for step in &self.evaluator.steps().list {
            match self.lumped.last_mut() {
                Some(last) if step.direction == 0.0 && last.direction == 0.0 && step.point - from < self.lump => {
                    last.level += step.level;
                    last.point = from + (step.point - from).div_ceil(2);
                }
                _ => {
                    self.lumped.push(*step);
                    from = step.point;
                }
            }
        }
    }
}

impl Objective for Scan<'_, '_> {
    fn cost(&mut self, [s, share]: [f64; 2]) -> f64 {
        if s < LEAST_S {
            return f64::INFINITY;
        }
        let problem = self.evaluator.problem;
        let j = problem.question.landing.jump(s, share);
        let mut least = f64::INFINITY;
        for (which, start) in problem.starts(0.5 * (s + j), &STARTS).into_iter().enumerate() {
            if which >= 3 && self.evaluator.steps().reversals > SOME_REVERSALS {
                break;
            }
            let Some(freedom) = self.evaluator.slip(s, j, start) else { continue };
            self.looks += 1;
            let slides = self.evaluator.law == Law::Tracking && self.lump > 1;
            if slides {
                self.lump_steps();
            }
            let steps = if slides { &self.lumped } else { &self.evaluator.steps().list };
            let seen = self.scans.iter().map(|scan| scan.look(steps, &freedom));
            let Some(seen) = seen.min_by(|a, b| a.share.total_cmp(&b.share)) else { continue };
            if seen.share < 1.0 {
                self.pool.push(self.evaluator.seen([s, j], start, seen.share * self.whole, seen.tau, seen.lag));
            }
            least = least.min(seen.share);
            if self.evaluator.steps().reversals >= MANY_REVERSALS {
                break;
            }
        }
        least
    }
}
