//! The hunt for the right slips under one valve law: a coarse look at everything, then ever finer steps from the best
//! places, first by differences of the free-run error, then by the error itself.

use core::cell::RefCell;

use rand_chacha::ChaCha8Rng;

use super::bank::BINS;
use super::candidate::{Bench, Candidate, Effort, Question};
use super::choice::ModelChoice;
use super::class::Class;
use super::fit::Target;
use super::order::{demote, deserved, frictionless, in_class};
use super::quantify::Options;
use super::review::{into_class, is_done, other_class, review};
use super::search::{Look, Stratum, beam, climb, generator, ridge_jumps, uniform};
use crate::optim::{self, Objective, Outcome, Settings};
use crate::signal::stats;
use crate::sim::slips::Law;

/// Filter of the search, first and later: differences of free-run errors forget a wrong slip, so the right one is
/// found from farther away; the plain error, which is minimised last, is sharper.
const SEARCH_RHO: f64 = 0.98;
const FINER_RHO: f64 = 0.8;
/// Rounds of straight looks through the best places, and random ones from each place afterwards.
const STRAIGHT_ROUNDS: usize = 2;
const RANDOM_LOOKS: usize = 40;
/// Squared error over another law's from which a law is out of the race.
const FAR_BEHIND: f64 = 1.5;
/// The same before the exact cells are known: where the other law leaves nothing but noise, and where it does not.
const BEYOND_NOISE: f64 = 1.5;
const HOPELESS: f64 = 4.0;
/// s in spans of OP from which an index counts in full: smaller bands are within what noise and rounding imitate.
pub const FULL_WEIGHT: f64 = 0.2;
/// Stiction index below which the exact size of the bands is not worth the work.
const WORTH_REFINING: f64 = 0.1;

/// What is hunted in: the record, its views, the signs of the gain that may be.
#[derive(Debug)]
pub struct Ground<'a> {
    /// The record.
    pub question: &'a Question,
    /// PV itself.
    pub plain: &'a Target,
    /// PV's differences.
    pub moves: &'a Target,
    /// What the search was told.
    pub options: &'a Options,
    /// Squared errors without friction that are known, plain and of moves.
    pub known: RefCell<Vec<(Class, f64, [f64; 2])>>,
}

impl<'a> Ground<'a> {
    /// The filtered view that the search works on.
    #[must_use]
    pub fn moves_of(question: &Question) -> Target {
        Target::new(&question.pv, SEARCH_RHO, question.from)
    }

    /// Least squared errors without friction, plain and of moves; computed once for a class and sign.
    fn without(&self, class: Class, sign: f64) -> [f64; 2] {
        let known = self.known.borrow().iter().find(|k| k.0 == class && k.1 == sign).map(|k| k.2);
        known.unwrap_or_else(|| {
            let found = [self.plain, self.moves].map(|target| frictionless(self.question, target, class, sign));
            self.known.borrow_mut().push((class, sign, found));
            found
        })
    }

    /// A bench for one target.
    #[must_use]
    pub fn bench(&self, law: Law, class: Class, target: &'a Target, sign: f64) -> Bench<'a> {
        Bench::new(self.question, law, class, target, sign)
    }
}

/// The best candidate by the error whose residual is as white as a first-order filter makes it.
#[derive(Debug, Clone, Copy)]
pub struct Answer {
    /// The candidate, fitted to the filtered error.
    pub candidate: Candidate,
    /// Filter of the error, 0 where the residual is white as it is.
    pub rho: f64,
    /// The same slips' squared plain error.
    pub plain_sse: f64,
}

/// The outcome of one hunt.
#[derive(Debug, Clone)]
pub struct Found {
    /// The bands to report: the best by the whitened error.
    pub answer: Option<Answer>,
    /// The best by the plain error, then others worth a look, all of one class.
    pub finalists: Vec<Candidate>,
    /// Class of the process.
    pub class: Class,
    /// The law.
    pub law: Law,
    /// Sign of the gain.
    pub sign: f64,
    /// Whether the best finalist leaves nothing but noise.
    pub done: bool,
    /// Squared error without friction, plain and filtered.
    pub without: [f64; 2],
    /// Share of the filtered error that goes with the friction; less where s is small, for so small a band noise
    /// imitates.
    pub index_moves: f64,
    /// Responses computed.
    pub evaluations: u64,
    /// How the solver ended.
    pub outcome: Outcome,
}

impl Found {
    /// Squared error of the best finalist.
    #[must_use]
    pub fn sse(&self) -> f64 {
        self.finalists.first().map_or(f64::INFINITY, |c| c.fit.sse)
    }

    /// Squared error without friction of another view.
    #[must_use]
    pub fn without_of(&self, target: &Target, ground: &Ground<'_>) -> f64 {
        frictionless(ground.question, target, self.class, self.sign)
    }

    /// Share of the plain error that goes with the friction.
    #[must_use]
    pub fn index(&self) -> f64 {
        improvement(self.sse(), self.without[0])
    }
}

/// Share of an error that goes with the friction, 0..1.
#[must_use]
pub fn improvement(with: f64, without: f64) -> f64 {
    if without > 0.0 { (1.0 - with / without).clamp(0.0, 1.0) } else { 0.0 }
}

/// What the coarse look under one law saw.
#[derive(Debug)]
pub struct Scouted<'a> {
    /// The law.
    pub law: Law,
    signs: &'a [f64],
    pools: Vec<[Vec<Candidate>; 2]>,
    strata: Vec<[Stratum; BINS]>,
    outcome: Outcome,
    looked: u64,
}

impl Scouted<'_> {
    /// Valve signals looked at.
    #[must_use]
    pub const fn looked(&self) -> u64 {
        self.looked
    }

    /// Least share of PV that a model seen leaves, over both views.
    #[must_use]
    pub fn share(&self) -> f64 {
        let seen = self.pools.iter().flatten().flatten();
        seen.map(|c| c.fit.sse).fold(f64::INFINITY, f64::min)
    }
}

/// Looks under one law at everything, for these signs of the gain.
#[must_use]
pub fn scout<'a>(ground: &Ground<'_>, law: Law, signs: &'a [f64]) -> Scouted<'a> {
    let options = ground.options;
    let solver = optim::by_name(options.solver).unwrap_or(optim::ALL[0]);
    let settings = Settings { budget: 20_000, fineness_pct: options.fineness_pct, seed: options.seed };
    let mut look = Look::new(ground.question, law, signs);
    let outcome = solver.search(&mut look, &settings);
    sweep(&mut look, options.seed);
    let mut rng = generator(options.seed, 2);
    let views: Vec<(usize, usize)> = (0..signs.len()).flat_map(|sign| [(sign, 0), (sign, 1)]).collect();
    for (sign, view) in &views {
        for _ in 0..STRAIGHT_ROUNDS {
            let from = beam(&look.pools[*sign][*view], 3, 0);
            look.cross(&from);
        }
    }
    look.sharpen();
    for (sign, view) in &views {
        let from = beam(&look.pools[*sign][*view], 6, 2);
        look.climb(*sign, *view, from, RANDOM_LOOKS, &mut rng);
    }
    let (looked, pools) = (look.evaluations(), core::mem::take(&mut look.pools));
    Scouted { law, signs, pools, strata: look.strata, outcome, looked }
}

/// Another explanation of the record: what is far behind it is not worth much work.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rival {
    /// Squared error.
    pub sse: f64,
    /// Whether it leaves nothing but noise.
    pub done: bool,
    /// Class of its process.
    pub class: Option<Class>,
}

impl Rival {
    /// None yet.
    pub const NONE: Self = Self { sse: f64::INFINITY, done: false, class: None };

    /// Squared error from which the search under another law is given up.
    fn beyond(&self) -> f64 {
        if self.done { BEYOND_NOISE * self.sse } else { HOPELESS * self.sse }
    }
}

/// Hunts from what the coarse look saw; an entry for each sign of the gain.
#[must_use]
pub fn hunt(ground: &Ground<'_>, seen: &Scouted<'_>, rival: Rival) -> Vec<Found> {
    let mut found: Vec<Found> = (0..seen.signs.len()).map(|at| follow(ground, seen, at, rival)).collect();
    for one in &mut found {
        one.evaluations += seen.looked;
    }
    found
}

/// An even look on a logarithmic scale of s, which no linear grid gives to small bands; its grid moves with the seed, so
/// that another search sees other places.
fn sweep(look: &mut Look<'_>, seed: u64) {
    const STEPS: i32 = 120;
    const SHARES: [f64; 8] = [0.03, 0.08, 0.16, 0.27, 0.4, 0.55, 0.72, 0.9];
    let mut rng = generator(seed, 3);
    let (shift, tilt) = (uniform(&mut rng) - 0.5, 1.0 + 0.24 * (uniform(&mut rng) - 0.5));
    for k in 0..STEPS {
        let s = libm::pow(0.03, (f64::from(k) + shift) / f64::from(STEPS - 1)).min(1.0);
        for share in SHARES {
            look.cost([s, (tilt * share).min(1.0) * s]);
        }
    }
}

/// The three benches of one law and sign, and how much work it is worth.
struct Chase<'g, 'a> {
    ground: &'g Ground<'a>,
    plain: Bench<'a>,
    moves: Bench<'a>,
    rng: ChaCha8Rng,
    /// Whether friction shows at all.
    shows: bool,
    /// Whether another explanation is far better.
    behind: bool,
    /// Class in which the places by moves were found.
    searched: Class,
}

impl Chase<'_, '_> {
    /// Steps to take: a fifth where no friction shows, hardly any far behind a better explanation.
    fn steps(&self, count: usize) -> usize {
        count
            / if self.behind {
                20
            } else if self.shows {
                1
            } else {
                5
            }
    }

    /// Whether every place is worth a look along its ridge.
    fn thorough(&self) -> bool {
        self.shows && !self.behind
    }

    /// From the coarse look to the best places by level and by moves, in the class that they ask for.
    fn approach(&mut self, pools: &[Vec<Candidate>; 2], rival: &Rival) -> [Vec<Candidate>; 2] {
        let ground = self.ground;
        let by_level = refit(&mut self.plain, &beam(&pools[0], 6, 2));
        let by_moves = refit(&mut self.moves, &beam(&pools[1], 12, 5));
        let best = |held: &[Candidate]| held.first().map_or(f64::INFINITY, |c| c.fit.sse);
        let nothing = ground.without(Class::First, self.plain.sign);
        let views = [best(&by_level), best(&by_moves)];
        self.shows = views.into_iter().zip(nothing).any(|(sse, nothing)| improvement(sse, nothing) > WORTH_REFINING);
        let heats = [(12, self.steps(12)), (6, self.steps(14)), (3, self.steps(14))];
        let mut by_level = race(&mut self.plain, by_level, &heats, &mut self.rng);
        by_level.truncate(3);
        let heats = [(27, self.steps(12)), (14, self.steps(18)), (8, self.steps(30))];
        let mut by_moves = race(&mut self.moves, by_moves, &heats, &mut self.rng);
        by_moves.truncate(if self.shows { 8 } else { 3 });
        let class = match rival.class.filter(|_| rival.done) {
            Some(class) => class,
            None => deserved(&mut self.moves, &mut self.plain, &by_moves, ground.options.model),
        };
        (self.plain.class, self.moves.class, self.searched) = (class, class, class);
        let by_level = by_level.iter().filter_map(|c| in_class(&mut self.plain, c)).collect();
        let by_moves = by_moves.iter().filter_map(|c| in_class(&mut self.moves, c)).collect();
        [by_level, by_moves]
    }

    /// From there to the best places by the plain error, by way of ever weaker filters.
    fn close_in(&mut self, by_level: Vec<Candidate>, by_moves: &mut Vec<Candidate>) -> Vec<Candidate> {
        let (question, class) = (self.ground.question, self.plain.class);
        let count = if self.thorough() { 3 } else { 0 };
        let near = ridge(&mut self.moves, by_moves.clone(), count, 0.15, 24);
        let heats = [(10, self.steps(30)), (5, self.steps(40)), (3, self.steps(50))];
        *by_moves = race(&mut self.moves, near, &heats, &mut self.rng);
        by_moves.truncate(4);
        let first = by_moves.first().and_then(|c| self.plain.settle(c));
        if let Some(first) = first.filter(|c| is_done(&mut self.plain, c)) {
            // Nothing is left to find but the exact cell.
            let steps = self.steps(60);
            return race(&mut self.plain, vec![first], &[(1, steps)], &mut self.rng);
        }
        let finer = Target::new(&question.pv, if class.integrates() { SEARCH_RHO } else { FINER_RHO }, question.from);
        let mut bench = self.ground.bench(self.plain.law, class, &finer, self.plain.sign);
        let held: Vec<Candidate> = by_moves.iter().filter_map(|c| bench.settle(c)).collect();
        let mut held = ridge(&mut bench, held, if self.thorough() { 2 } else { 0 }, 0.05, 25);
        held.truncate(5);
        let heats = [(5, self.steps(50)), (3, self.steps(70)), (2, self.steps(80))];
        let held = race(&mut bench, held, &heats, &mut self.rng);
        self.plain.fitter.evaluations += bench.fitter.evaluations;
        let mut held: Vec<Candidate> = held.iter().take(3).filter_map(|c| self.plain.settle(c)).collect();
        held.extend(by_level);
        let heats = [(6, self.steps(30)), (3, self.steps(70))];
        let mut held = race(&mut self.plain, held, &heats, &mut self.rng);
        held.truncate(4);
        held
    }

    /// The bands to report, by the whitened error; better finalists met on the way come first.
    fn answer(&mut self, finalists: &mut Vec<Candidate>, by_moves: &[Candidate]) -> Option<Answer> {
        let best = finalists.first().copied()?;
        let mut others = finalists.clone();
        for c in by_moves.iter().take(3) {
            others.extend(into_class(&mut self.plain, c, self.searched));
        }
        let steps = if self.shows { 150 } else { 0 };
        let mut answer = whitened(self.ground, &mut self.plain, &best, &others, steps, &mut self.rng);
        for _ in 0..2 {
            if answer.rho == 0.0 {
                break;
            }
            // What looked like a disturbance may have been wrong slips.
            let Some(start) = self.plain.settle(&answer.candidate) else { break };
            let again = climb(&mut self.plain, start, steps, false, &mut self.rng);
            let Some(again) = self.plain.settle(&again).filter(|c| c.fit.sse < 0.98 * finalists[0].fit.sse) else {
                break;
            };
            finalists.insert(0, again);
            let others = [answer.candidate, again];
            answer = whitened(self.ground, &mut self.plain, &again, &others, steps, &mut self.rng);
        }
        Some(answer)
    }

    /// The best share of the filtered error, `without` friction, that a band takes away: of the finalists, which were
    /// chosen by the plain error, and of the best by the filtered one, which a slow disturbance leads astray less.
    fn index_moves(&mut self, finalists: &[Candidate], by_moves: &[Candidate], without: f64) -> f64 {
        let mut best = 0.0;
        for (held, home) in [(finalists, self.moves.class), (by_moves, self.searched)] {
            for c in held {
                let settled = into_class(&mut self.moves, c, home);
                let share = settled.map_or(0.0, |c| improvement(c.fit.sse, without) * (c.s / FULL_WEIGHT).min(1.0));
                best = f64::max(best, share);
            }
        }
        best
    }

    /// Whether the slips now found ask for another class of process than the ones before did; the best goes there, and
    /// is never worse for it.
    fn reclass(&mut self, finalists: &mut Vec<Candidate>) -> bool {
        let Some(best) = finalists.first().copied() else { return false };
        let (home, model, steps) = (self.plain.class, self.ground.options.model, self.steps(150));
        if is_done(&mut self.plain, &best) {
            return false;
        }
        let better = other_class(&mut self.plain, best, model);
        if self.plain.class == home {
            return false;
        }
        let better = climb(&mut self.plain, better, steps, false, &mut self.rng);
        let (better, _) = demote(&mut self.plain, Some(better), model);
        let better = better.and_then(|c| self.plain.settle(&c)).filter(|c| c.fit.sse < best.fit.sse);
        let Some(better) = better else {
            self.plain.class = home;
            return false;
        };
        *finalists = vec![better];
        (self.moves.class, self.searched) = (self.plain.class, home);
        true
    }
}

/// From the coarse look to the finalists for one sign.
fn follow(ground: &Ground<'_>, seen: &Scouted<'_>, at: usize, rival: Rival) -> Found {
    let Scouted { law, outcome, .. } = *seen;
    let (sign, pools, strata) = (seen.signs[at], &seen.pools[at], &seen.strata[at]);
    let plain = ground.bench(law, Class::First, ground.plain, sign);
    let moves = ground.bench(law, Class::First, ground.moves, sign);
    let mut chase = Chase {
        ground,
        plain,
        moves,
        rng: generator(ground.options.seed, 1),
        shows: true,
        behind: false,
        searched: Class::First,
    };
    let [by_level, mut by_moves] = chase.approach(pools, &rival);
    let levels = by_level.iter().map(|c| c.fit.sse).fold(f64::INFINITY, f64::min);
    let moves = by_moves.iter().take(3).filter_map(|c| chase.plain.settle(c));
    chase.behind = moves.map(|c| c.fit.sse).fold(levels, f64::min) >= rival.beyond();
    let held = chase.close_in(by_level, &mut by_moves);
    let steps = chase.steps(150);
    let (mut finalists, class) = finish(&mut chase.plain, held, ground.options.model, steps, &mut chase.rng);
    let class = if chase.thorough() && finalists.first().is_some_and(|c| c.fit.sse < rival.beyond()) {
        review(&mut chase.plain, &mut finalists, strata, ground.options.model, &mut chase.rng)
    } else {
        class
    };
    chase.moves.class = class;
    chase.shows &= finalists.first().is_some_and(|c| c.fit.sse < FAR_BEHIND * rival.sse);
    let mut answer = chase.answer(&mut finalists, &by_moves);
    if chase.thorough() && chase.reclass(&mut finalists) {
        answer = chase.answer(&mut finalists, &by_moves);
    }
    let class = chase.plain.class;
    let done = finalists.first().is_some_and(|c| is_done(&mut chase.plain, c));
    let without = ground.without(class, sign);
    let index_moves = chase.index_moves(&finalists, &by_moves, without[1]);
    let evaluations = chase.plain.fitter.evaluations + chase.moves.fitter.evaluations;
    Found { answer, finalists, class, law, sign, done, without, index_moves, evaluations, outcome }
}

/// Lag-1 autocorrelation of a residual from which it is filtered.
const COLOURED: f64 = 0.2;
/// Strongest filter.
const MOST_RHO: f64 = 0.98;

/// What a disturbance adds to PV stays in the residual from sample to sample; with the residual's own first-order
/// filter in front of the error (as in generalised least squares, Cochrane and Orcutt 1949) it weighs as noise does.
fn whitened(
    ground: &Ground<'_>,
    plain: &mut Bench<'_>,
    best: &Candidate,
    others: &[Candidate],
    steps: usize,
    rng: &mut ChaCha8Rng,
) -> Answer {
    let mut answer = Answer { candidate: *best, rho: 0.0, plain_sse: best.fit.sse };
    let mut rho = stats::autocorrelation_1(&plain.residual(best));
    for _ in 0..2 {
        if rho < COLOURED || steps == 0 {
            return answer;
        }
        rho = rho.min(MOST_RHO);
        let target = Target::new(&ground.question.pv, rho, ground.question.from);
        let mut bench = ground.bench(plain.law, plain.class, &target, plain.sign);
        let mut held: Vec<Candidate> = others.iter().filter_map(|c| bench.settle(c)).collect();
        held.push(answer.candidate);
        let held: Vec<Candidate> = beam(&held, 4, 0).iter().filter_map(|c| bench.settle(c)).collect();
        let held = ridge(&mut bench, beam(&held, 4, 0), 2, 0.1, 25);
        let heats = [(4, steps / 3), (2, steps - steps / 3)];
        let held = race(&mut bench, held, &heats, rng);
        let Some(found) = held.first().and_then(|c| bench.settle(c)) else { return answer };
        plain.fitter.evaluations += bench.fitter.evaluations;
        let again = plain.settle(&found).map_or(f64::INFINITY, |c| c.fit.sse);
        answer = Answer { candidate: found, rho, plain_sse: again };
        // The right slips leave another residual, which may ask for another filter.
        let left = plain.settle(&found).map(|c| stats::autocorrelation_1(&plain.residual(&c)));
        match left {
            Some(next) if (next - rho).abs() > 0.1 => rho = next,
            _ => return answer,
        }
    }
    answer
}

/// The best climbs on and is settled; all come to the class that it earns.
fn finish(
    plain: &mut Bench<'_>,
    held: Vec<Candidate>,
    model: ModelChoice,
    steps: usize,
    rng: &mut ChaCha8Rng,
) -> (Vec<Candidate>, Class) {
    let Some(first) = held.first().copied() else { return (held, plain.class) };
    let best = climb(plain, first, steps, false, rng);
    let best = plain.settle(&best);
    let rich = plain.class;
    let (best, class) = demote(plain, best, model);
    let mut finalists: Vec<Candidate> = best.into_iter().collect();
    if class != rich {
        // What was a second lag may have stood for a wrong slip.
        let better = finalists.first().map(|c| climb(plain, *c, steps, false, rng));
        finalists = better.into_iter().filter_map(|c| plain.settle(&c)).collect();
    } else {
        finalists.extend(held.into_iter().skip(1));
    }
    (finalists, class)
}

/// An even look along the ridge around a candidate, its best places: a later slip goes with a shorter lag, so s up to
/// `reach` to either side with the lag that keeps the answer where it is, and the jumps that may go with it.
pub(super) fn along(bench: &mut Bench<'_>, around: &Candidate, reach: f64, steps: i32) -> Vec<Candidate> {
    let mut pool = vec![*around];
    let rate = bench.question.rate.max(1e-6);
    let slot = bench.class.shape_len() - 1;
    let least = around.fit.sse;
    for side in [-1.0, 1.0] {
        let (mut shape, mut last) = (around.fit.shape, around.s);
        for k in 1..=steps {
            let s = (around.s * (1.0 + side * reach * f64::from(k) / f64::from(steps))).min(1.0);
            let mut guess = shape;
            guess[slot] -= (s - last) / rate;
            let guess = bench.class.clamp(guess, &bench.question.limits);
            for j in ridge_jumps([around.s, around.j], s, bench.question.landing) {
                let effort = Effort { steps: 1, hopeless: 3.0 * least, wanted: 1.5 * least };
                let Some(found) = bench.fit(s, j, around.start, &[guess], effort) else { continue };
                if found.fit.sse < 2.0 * least {
                    (shape, last) = (found.fit.shape, s);
                }
                pool.push(found);
            }
        }
    }
    beam(&pool, 4, 0)
}

/// Candidates of the coarse look, fitted at full resolution, best first.
fn refit(bench: &mut Bench<'_>, seen: &[Candidate]) -> Vec<Candidate> {
    let effort = Effort::of(3);
    let fitted: Vec<Candidate> =
        seen.iter().filter_map(|c| bench.fit(c.s, c.j, c.start, &[c.fit.shape], effort)).collect();
    beam(&fitted, usize::MAX, 0)
}

/// The best `count` candidates looked at along their ridges; all of them, the best first.
fn ridge(bench: &mut Bench<'_>, held: Vec<Candidate>, count: usize, reach: f64, steps: i32) -> Vec<Candidate> {
    let mut all = held.clone();
    for c in held.iter().take(count) {
        all.extend(along(bench, c, reach, steps));
    }
    beam(&all, 10, 0)
}

/// Random steps for the best of the candidates, in heats of (how many, steps for each), all of them best first
/// afterwards.
pub(super) fn race(
    bench: &mut Bench<'_>,
    mut held: Vec<Candidate>,
    heats: &[(usize, usize)],
    rng: &mut ChaCha8Rng,
) -> Vec<Candidate> {
    for (count, steps) in heats {
        held.sort_by(|a, b| a.fit.sse.total_cmp(&b.fit.sse));
        for c in held.iter_mut().take(*count) {
            *c = climb(bench, *c, *steps, false, rng);
        }
        held = beam(&held, usize::MAX, 0);
    }
    held
}
