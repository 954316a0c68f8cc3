//! The second look at an answer whose residual is not noise: other classes of process, places farther along the ridge,
//! staircases of other steps. A residual that is white and unlike OP ends it, for there is nothing left to find.

use rand_chacha::ChaCha8Rng;

use super::bank::{BINS, bin_edge};
use super::candidate::{Bench, Candidate, Effort, Question};
use super::choice::ModelChoice;
use super::class::{Class, Limits};
use super::fit::Target;
use super::hunt::{along, race};
use super::order::demote;
use super::residual::whiteness;
use super::search::{Stratum, beam, ridge_jumps};

/// Rounds at most.
const ROUNDS: usize = 3;
/// Share of the error that another class must remove to be taken.
const TAKEN: f64 = 0.03;
/// How far along the ridge, share of s, and in how many steps.
const REACH: f64 = 0.3;
const STEPS: i32 = 40;
/// Most cells to either side.
const CELLS: i32 = 100;
/// Filters of the search in ranges of dead time, without and with an integrator.
const RHO: f64 = 0.8;
const INTEGRATING_RHO: f64 = 0.9;
/// Values of j looked at from each place of the ridge.
const JUMPS: i32 = 16;

/// Share of PV's variance below which what is left is rounding, whatever it looks like.
const ROUNDING: f64 = 1e-9;

/// Whether a candidate leaves nothing but noise.
pub fn is_done(bench: &mut Bench<'_>, of: &Candidate) -> bool {
    if of.fit.sse < ROUNDING * bench.target.y.len() as f64 {
        return true;
    }
    let residual = bench.residual(of);
    let from = bench.target.from.min(bench.question.mean.len());
    let tests = whiteness(&residual, &bench.question.mean[from..]);
    tests.white && !tests.follows_op
}

/// Looks again where the best of the finalists (by the plain error, settled) leaves more than noise; the bench and the
/// finalists end in the class that is returned, and the first of them is never worse for it.
pub fn review(
    bench: &mut Bench<'_>,
    finalists: &mut Vec<Candidate>,
    strata: &[Stratum; BINS],
    model: ModelChoice,
    rng: &mut ChaCha8Rng,
) -> Class {
    for round in 0..ROUNDS {
        let Some(best) = finalists.first().copied() else { break };
        if is_done(bench, &best) {
            break;
        }
        let best = other_class(bench, best, model);
        let mut held = vec![best];
        if round == 0 {
            let (found, class) = by_dead_time(bench, &best, strata, rng);
            held.extend(take_over(bench, &best, &found, class, model));
        } else {
            held.extend(valley(bench, &best));
        }
        held.sort_by(|a, b| a.fit.sse.total_cmp(&b.fit.sse));
        let best = held[0];
        let held = race(bench, beam(&held, 8, 0), &[(8, 25), (3, 50), (1, 60)], rng);
        let raced = bench.class;
        let Some(found) = held.first().and_then(|c| bench.settle(c)) else { break };
        let found = other_class(bench, if found.fit.sse < best.fit.sse { found } else { best }, model);
        let (simple, _) = demote(bench, Some(found), model);
        let better = found.fit.sse < 0.98 * finalists[0].fit.sse;
        *finalists = simple.into_iter().collect();
        if bench.class == raced {
            finalists.extend(held.into_iter().skip(1));
        }
        if !better && round > 1 {
            break;
        }
    }
    bench.class
}

/// The candidate in the class that suits its slips best; its own unless another one is clearly better.
pub(super) fn other_class(bench: &mut Bench<'_>, own: Candidate, model: ModelChoice) -> Candidate {
    let classes: &[Class] = match model {
        ModelChoice::Fopdt => &[Class::First, Class::Integrating],
        ModelChoice::Sopdt => &[Class::Second, Class::LagIntegrating],
        ModelChoice::Auto => &[Class::First, Class::Integrating, Class::Second, Class::LagIntegrating],
    };
    let home = bench.class;
    let mut best = (own, home);
    for class in classes {
        bench.class = *class;
        // Its own class once more, from other shapes: two lags have minima of their own.
        let settled = reshaped(bench, &own, home);
        if let Some(settled) = settled.filter(|c| c.fit.sse < (1.0 - TAKEN) * best.0.fit.sse) {
            best = (settled, *class);
        }
    }
    bench.class = best.1;
    best.0
}

/// A candidate of the class `home` settled in the bench's class.
pub(super) fn into_class(bench: &mut Bench<'_>, own: &Candidate, home: Class) -> Option<Candidate> {
    if bench.class == home { bench.settle(own) } else { reshaped(bench, own, home) }
}

/// A candidate of the class `home` settled in the bench's class, from the best of a few shapes around its own.
fn reshaped(bench: &mut Bench<'_>, own: &Candidate, home: Class) -> Option<Candidate> {
    let tau = home.time_constants(&own.fit.shape).first().copied().unwrap_or(bench.question.period);
    let (lag, limits) = (home.lag(&own.fit.shape), bench.question.limits);
    let shapes = [0.25, 1.0, 3.0].map(|by| bench.class.clamp(bench.class.start(tau * by, lag), &limits));
    let fitted = shapes.iter().filter_map(|shape| bench.fit(own.s, own.j, own.start, &[*shape], Effort::of(4)));
    let fitted = fitted.min_by(|a, b| a.fit.sse.total_cmp(&b.fit.sse))?;
    bench.settle(&fitted).filter(|c| c.fit.gain != 0.0)
}

/// What was found in another class, in the class that suits the best of it and `best` together; the bench goes there.
fn take_over(
    bench: &mut Bench<'_>,
    best: &Candidate,
    found: &[Candidate],
    class: Class,
    model: ModelChoice,
) -> Vec<Candidate> {
    let home = bench.class;
    bench.class = class;
    let mut order: Vec<Candidate> = found.iter().filter_map(|c| bench.settle(c)).collect();
    order = beam(&order, 4, 0);
    let mut leader = (*best, home);
    for c in order.iter().take(2) {
        bench.class = class;
        let suited = other_class(bench, *c, model);
        if suited.fit.sse < leader.0.fit.sse {
            leader = (suited, bench.class);
        }
    }
    bench.class = leader.1;
    let mut all = vec![leader.0];
    all.extend(into_class(bench, best, home));
    for c in &order {
        all.extend(into_class(bench, c, class));
    }
    all
}

/// The best of every range of dead time, searched apart and by differences of the error: with the dead time held there
/// is no ridge. In a class without a second lag, which might make up for wrong slips; that class comes with it.
fn by_dead_time(
    bench: &mut Bench<'_>,
    best: &Candidate,
    strata: &[Stratum; BINS],
    rng: &mut ChaCha8Rng,
) -> (Vec<Candidate>, Class) {
    let question = bench.question;
    let longest = bench.class.time_constants(&best.fit.shape).first().copied().unwrap_or(f64::INFINITY);
    let (tau, lag) = (longest.min(question.period), bench.class.lag(&best.fit.shape));
    let integrates = bench.class.integrates() || longest > question.mean.len() as f64;
    let class = if integrates { Class::Integrating } else { Class::First };
    let target = Target::new(&question.pv, if integrates { INTEGRATING_RHO } else { RHO }, question.from);
    let [low, high] = question.limits.lag;
    let mut all = Vec::new();
    for bin in 0..BINS {
        let edge = |k: usize| low + (high - low) * bin_edge(k);
        let limits = Limits { lag: [edge(bin), edge(bin + 1)], ..question.limits };
        let narrow = Question { limits, ..question.clone() };
        let mut inner = Bench::new(&narrow, bench.law, class, &target, bench.sign);
        // The boxes of the coarse look are wider than the shortest ranges.
        let near = &strata[bin.saturating_sub(1)..(bin + 2).min(BINS)];
        let seen = near.iter().flatten().flat_map(|kept| beam(kept, 3, 0));
        let seen = seen.map(|c| (c.s, c.j, c.start, class.start(libm::exp(c.fit.shape[0]), c.fit.shape[1])));
        let middle = 0.5 * (limits.lag[0] + limits.lag[1]);
        let s = best.s - (middle - lag) * question.rate;
        let start = question.moved_start(best.start, lag - middle);
        let along = ridge_jumps([best.s, best.j], s, question.landing).map(|j| (s, j, start, class.start(tau, middle)));
        let mut fitted = Vec::new();
        for (s, j, start, shape) in seen.chain(along).filter(|c| c.0 > 1e-4) {
            fitted.extend(inner.fit(s, j, start, &[class.clamp(shape, &limits)], Effort::of(3)));
        }
        let fitted = beam(&fitted, 10, 0);
        let held = race(&mut inner, fitted, &[(8, 24), (4, 40), (2, 80)], rng);
        bench.fitter.evaluations += inner.fitter.evaluations;
        all.extend(held.into_iter().take(2));
    }
    (all, class)
}

/// The best places along the ridge around a candidate, each with the jump that suits it best.
fn valley(bench: &mut Bench<'_>, around: &Candidate) -> Vec<Candidate> {
    let ridge = along(bench, around, REACH, STEPS);
    let mut pool = ridge.clone();
    for (jump, earlier) in [(0, false), (3, false), (0, true), (3, true)] {
        pool.extend(cell_by_cell(bench, around, jump, earlier));
    }
    for c in ridge.iter().take(4) {
        for k in 0..JUMPS {
            let j = c.s * libm::pow(0.03, f64::from(k) / f64::from(JUMPS - 1));
            let effort = Effort { steps: 1, hopeless: 3.0 * c.fit.sse, wanted: 1.5 * c.fit.sse };
            let j = bench.question.landing.jump(c.s, j);
            pool.extend(bench.fit(c.s, j, c.start, &[c.fit.shape], effort).filter(|c| c.fit.gain != 0.0));
        }
    }
    beam(&pool, 6, 0)
}

/// Every cell along the ridge around a candidate, with the jump that [`ridge_jumps`] names: with little noise the right
/// cell shows only when it is met exactly. The first slip stays, or comes `earlier` with all others where the lag grows.
/// Where there are more than [`CELLS`] to a side, some are skipped.
fn cell_by_cell(bench: &mut Bench<'_>, around: &Candidate, jump: usize, earlier: bool) -> Vec<Candidate> {
    let rate = bench.question.rate.max(1e-6);
    let slot = bench.class.shape_len() - 1;
    let least_step = REACH * around.s / f64::from(CELLS);
    let mut pool = Vec::new();
    for up in [false, true] {
        let (mut at, mut shape, mut last) = (*around, around.fit.shape, around.s);
        for _ in 0..CELLS {
            let s = if up {
                (at.s_cell[1] * (1.0 + 1e-9) + 1e-12).max(at.s + least_step)
            } else {
                (at.s_cell[0] * (1.0 - 1e-9) - 1e-12).min(at.s - least_step)
            };
            if !s.is_finite() || s < 1e-4 || (s / around.s - 1.0).abs() > REACH || s > 1.0 {
                break;
            }
            let mut guess = shape;
            guess[slot] -= (s - last) / rate;
            let guess = bench.class.clamp(guess, &bench.question.limits);
            let j = ridge_jumps([around.s, around.j], s, bench.question.landing)[jump];
            let later = if earlier { around.fit.shape[slot] - guess[slot] } else { 0.0 };
            let start = bench.question.moved_start(around.start, later);
            let Some(found) = bench.fit(s, j, start, &[guess], Effort::of(1)) else { break };
            if found.fit.sse < 4.0 * around.fit.sse {
                (shape, last) = (found.fit.shape, s);
                pool.push(found);
            }
            at = found;
        }
    }
    beam(&pool, 4, 0)
}
