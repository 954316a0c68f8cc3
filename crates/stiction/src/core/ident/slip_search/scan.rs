//! The first stage: a coarse look at the whole plane of bands.

use super::candidate::{Candidate, apart};
use super::coarse_scan::CoarseScan;
use super::evaluator::Evaluator;
use super::local_search::LEAST_S;
use super::read::Reading;
use super::settings::ScanSettings;
use crate::core::ident::class::Class;
use crate::core::ident::evaluator::lattice_index;
use crate::core::ident::normalised::Start;
use crate::core::ident::random::{normal, uniform};
use crate::core::optim::{Contour, Objective, Settings, Solver};
use crate::core::sim::slips::Law;
use crate::core::sim::steps::Step;
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;

/// Positions of the stem before the record, as shares of the static band from OP's first value.
const STARTS: [f64; 17] =
    [0.0, -0.9, 0.9, -0.45, 0.45, -0.7, 0.7, -0.2, 0.2, -0.97, 0.97, -0.8, 0.8, -0.6, 0.6, -0.3, 0.3];
/// Starts tried for a stem with at most this many reversals: the fewer reversals, the more its initial position matters.
const STARTS_BY_REVERSALS: [(usize, usize); 3] = [(2, 17), (4, 5), (7, 3)];
/// Share relative to the least one so far from which no other starts are tried.
const WORTH_STARTS: f64 = 4.0;
/// Fewer moves than this are few; then the numbers of places searched, of steps in s (shares of it) per side, and of steps in
/// j.
const SELDOM: usize = 40;
const STRAIGHT: usize = 4;
const STEPS_IN_S: i32 = 24;
const STEP_IN_S: f64 = 0.008;
const STEPS_IN_J: i32 = 36;
/// Places read from PV and searched around, ever closer (shares of s, 1.5 times as far in j), and looks at each distance.
const LOOKED_AROUND: usize = 14;
const CLOSER: [f64; 4] = [0.02, 0.01, 0.005, 0.0025];
const LOOKS: usize = 10;
/// Error relative to the best place's up to which a place is searched around.
const WORTH_LOOKING_AROUND: f64 = 4.0;
/// OP's running extremes on either side of the first slip that may have moved the stem.
const RECORDS: usize = 4;
/// Bins per period into which the steps of a sliding stem are merged.
const LUMPS: f64 = 24.0;

/// The scan under one law; keeps everything that it sees.
#[derive(Debug, Clone)]
pub struct Scan {
    scans: Vec<CoarseScan>,
    /// Sum of squares to which shares refer.
    whole: f64,
    lump: u32,
    lumped: Vec<Step>,
    /// Everything seen.
    pub pool: Vec<Candidate>,
    /// Valve signals evaluated.
    pub looks: u64,
    /// Least share left unexplained so far.
    least: f64,
}

impl Scan {
    /// A scan of the evaluator's points, by the error filtered with `1 - rho q^-1`; `whole` is the sum of squares without any
    /// model.
    #[must_use]
    pub(crate) fn new(evaluator: &Evaluator<'_>, rho: f64, whole: f64) -> Self {
        Self::of(evaluator, CoarseScan::of(evaluator.problem, rho, evaluator.points), whole)
    }

    fn of(evaluator: &Evaluator<'_>, scans: Vec<CoarseScan>, whole: f64) -> Self {
        let lump = ((evaluator.problem.normalised.period / LUMPS) as u32).max(1);
        Self { scans, whole, lump, lumped: Vec::new(), pool: Vec::new(), looks: 0, least: 1.0 }
    }

    /// Looks at the contour solver's grid, then at evenly spaced places.
    pub(crate) fn run(
        &mut self,
        evaluator: &mut Evaluator<'_>,
        fineness_pct: f64,
        seed: u64,
        settings: &ScanSettings,
        rng: &mut ChaCha8Rng,
    ) {
        // Covers the whole grid; later stages refine better than the solver would.
        let steps = 100.0 / fineness_pct.clamp(0.2, 50.0);
        let grid = 0.5 * steps * (steps + 3.0) + 12.0;
        let asked = Settings { budget: settings.budget.max(grid as u64), fineness_pct, seed };
        let _ = Contour.search(&mut Looking { scan: self, evaluator }, &asked);
        self.evenly(evaluator, settings, rng);
    }

    /// Looks evenly on a logarithmic scale of s: a linear grid is too coarse for small bands.
    fn evenly(&mut self, evaluator: &mut Evaluator<'_>, settings: &ScanSettings, rng: &mut ChaCha8Rng) {
        // Every round looks at other places.
        let shift = [uniform(rng), 0.3 + 0.4 * uniform(rng)];
        for a in 0..settings.sizes {
            let along = (a as f64 + shift[0]) / settings.sizes as f64;
            let s = libm::pow(settings.least_s, 1.0 - along);
            for b in 0..settings.jumps {
                let j = s * (b as f64 + shift[1]) / settings.jumps as f64;
                Looking { scan: self, evaluator }.cost([s, j]);
            }
        }
    }

    /// An even look for a process whose second lag is `tau` points long: its best places in that class, best first, and the
    /// number of valve signals evaluated. With two lags, the right slips look wrong to a single-lag scan.
    pub(crate) fn behind_lag(
        evaluator: &mut Evaluator<'_>,
        tau: f64,
        settings: &ScanSettings,
        rng: &mut ChaCha8Rng,
    ) -> (Vec<Candidate>, u64) {
        let scans = CoarseScan::behind_lag(evaluator.problem, tau, evaluator.points);
        let mut scan = Self::of(evaluator, scans, 1.0);
        let class = std::mem::replace(&mut evaluator.class, Class::First);
        scan.evenly(evaluator, settings, rng);
        evaluator.class = class;
        let place = lattice_index(tau);
        let mut seen = scan.best(settings);
        for c in &mut seen {
            let [single, _] = c.fit.places;
            (c.class, c.fit.places) = (class, [single.max(place), single.min(place)]);
        }
        (seen, scan.looks)
    }

    /// Adds candidates worth a fit from line searches through the best places and, if bands were read from PV, from searches
    /// around them: closer looks, for records whose slips the even look misses.
    pub(crate) fn closer(
        &mut self,
        evaluator: &mut Evaluator<'_>,
        readings: &[Reading],
        settings: &ScanSettings,
        rng: &mut ChaCha8Rng,
    ) -> Vec<Candidate> {
        let before = self.pool.len();
        self.straight_looks(evaluator);
        let mut found = apart(&self.pool[before..], settings.keep[0], settings.keep[1]);
        found.extend(self.near(evaluator, readings, rng));
        found
    }

    /// Looks at the bands read from PV and ever closer around them: the best place of each reading, best first.
    fn near(&mut self, evaluator: &mut Evaluator<'_>, readings: &[Reading], rng: &mut ChaCha8Rng) -> Vec<Candidate> {
        let problem = evaluator.problem;
        let seen_before = std::mem::take(&mut self.pool);
        let mut found: Vec<Candidate> = Vec::new();
        for Reading { bands: [s, j], first: (point, up) } in readings {
            let mut starts = problem.starts_near(*point, *up, RECORDS);
            starts.extend(problem.starts(0.5 * (s + j), &STARTS[..1]));
            for start in starts {
                self.look(evaluator, *s, *j, start);
            }
            found.extend(self.best_of_pool());
        }
        found.sort_by(|a, b| a.sse().total_cmp(&b.sse()));
        found.truncate(LOOKED_AROUND);
        let worth = WORTH_LOOKING_AROUND * found.first().map_or(0.0, Candidate::sse);
        found.retain(|c| c.sse() <= worth);
        for place in &mut found {
            for reach in CLOSER {
                let (s, j, start) = (place.s, place.j, place.start);
                for _ in 0..LOOKS {
                    let s_there = (s * (1.0 + reach * normal(rng))).min(1.0);
                    self.look(evaluator, s_there, (j + 1.5 * reach * s * normal(rng)).clamp(0.0, s_there), start);
                }
                if let Some(better) = self.best_of_pool().filter(|c| c.sse() < place.sse()) {
                    *place = better;
                }
            }
        }
        self.pool = seen_before;
        apart(&found, usize::MAX, 0)
    }

    /// The best of the pool; empties it.
    fn best_of_pool(&mut self) -> Option<Candidate> {
        self.pool.drain(..).min_by(|a, b| a.sse().total_cmp(&b.sse()))
    }

    /// Line searches through the best places whose stem moves seldom: their valleys are too narrow for an even look, and looks
    /// are cheap.
    fn straight_looks(&mut self, evaluator: &mut Evaluator<'_>) {
        let seldom: Vec<Candidate> = self.pool.iter().copied().filter(|c| c.slips < SELDOM).collect();
        let slip_end = evaluator.problem.normalised.slip_end;
        for c in apart(&seldom, STRAIGHT, 0) {
            for k in -STEPS_IN_S..=STEPS_IN_S {
                let s = (c.s * (1.0 + STEP_IN_S * f64::from(k))).min(1.0);
                for j in [c.j, c.j / c.s * s, c.j + s - c.s] {
                    self.look(evaluator, s, slip_end.keep(s, j), c.start);
                }
            }
            for k in 0..STEPS_IN_J {
                let j = c.s * libm::pow(0.03, f64::from(k) / f64::from(STEPS_IN_J));
                self.look(evaluator, c.s, slip_end.jump(c.s, j), c.start);
            }
            for by in [1, 2, 3, 5, 8, 13] {
                for extreme in [c.start.extreme + by, c.start.extreme.saturating_sub(by)] {
                    self.look(evaluator, c.s, c.j, Start { extreme, ..c.start });
                }
            }
        }
    }

    /// Candidates worth a fit, best first.
    #[must_use]
    pub(crate) fn best(&self, settings: &ScanSettings) -> Vec<Candidate> {
        apart(&self.pool, settings.keep[0], settings.keep[1])
    }

    /// The best of every half octave of s, separately for short and long dead times: a model that lacks an effect often prefers
    /// slips of a very different size.
    #[must_use]
    pub(crate) fn of_every_size(&self, evaluator: &Evaluator<'_>) -> Vec<Candidate> {
        let short = 0.25 * evaluator.problem.normalised.limits.lag[1];
        let class = |c: &Candidate| ((2.0 * libm::log2(c.s)).floor() as i32, c.fit.lag() < short);
        let mut best: BTreeMap<(i32, bool), Candidate> = BTreeMap::new();
        for c in &self.pool {
            let slot = best.entry(class(c)).or_insert(*c);
            if c.sse() < slot.sse() {
                *slot = *c;
            }
        }
        best.into_values().collect()
    }

    /// Merges the steps of a sliding stem.
    fn lump_steps(&mut self, steps: &[Step]) {
        self.lumped.clear();
        let mut from = 0;
        for step in steps {
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

    /// The least share over the starts that such bands need.
    fn cost_of(&mut self, evaluator: &mut Evaluator<'_>, s: f64, j: f64) -> f64 {
        let mut least = f64::INFINITY;
        for (which, start) in evaluator.problem.starts(0.5 * (s + j), &STARTS).into_iter().enumerate() {
            let reversals = evaluator.steps().reversals;
            let wanted = STARTS_BY_REVERSALS.into_iter().find(|(most, _)| reversals <= *most).map_or(1, |(_, w)| w);
            if which >= wanted && which > 0 {
                break;
            }
            least = least.min(self.look(evaluator, s, j, start));
            // Another start changes only what comes before the first reversal.
            if least > WORTH_STARTS * self.least {
                break;
            }
        }
        self.least = self.least.min(least);
        least
    }

    /// The share that one valve signal leaves unexplained; the candidate is kept in the pool.
    fn look(&mut self, evaluator: &mut Evaluator<'_>, s: f64, j: f64, start: Start) -> f64 {
        let Some(freedom) = evaluator.slip(s, j, start) else { return f64::INFINITY };
        self.looks += 1;
        let slides = evaluator.law == Law::Tracking && self.lump > 1;
        if slides {
            self.lump_steps(&evaluator.steps().list);
        }
        let steps = if slides { &self.lumped } else { &evaluator.steps().list };
        let seen = self.scans.iter().map(|scan| scan.look(steps, &freedom));
        let Some(seen) = seen.min_by(|a, b| a.share.total_cmp(&b.share)) else { return f64::INFINITY };
        if seen.share < 1.0 {
            self.pool.push(evaluator.seen([s, j], start, seen.share * self.whole, seen.tau, seen.lag));
        }
        seen.share
    }
}

/// The scan as an objective for the contour solver.
struct Looking<'s, 'e, 'a> {
    scan: &'s mut Scan,
    evaluator: &'e mut Evaluator<'a>,
}

impl Objective for Looking<'_, '_, '_> {
    fn cost(&mut self, [s, share]: [f64; 2]) -> f64 {
        if s < LEAST_S {
            return f64::INFINITY;
        }
        let j = self.evaluator.problem.normalised.slip_end.jump(s, share);
        self.scan.cost_of(self.evaluator, s, j)
    }
}
