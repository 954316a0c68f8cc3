//! The second look at an answer whose residual is not noise: other classes of process, places farther along the ridge,
//! staircases of other steps. A residual that is white and unlike OP ends it, for there is nothing left to find.

use rand_chacha::ChaCha8Rng;

use super::candidate::{Bench, Candidate, Effort};
use super::choice::ModelChoice;
use super::class::Class;
use super::hunt::{along, race};
use super::order::demote;
use super::residual::whiteness;
use super::search::beam;

/// Rounds at most.
const ROUNDS: usize = 3;
/// Share of the error that another class must remove to be taken.
const TAKEN: f64 = 0.03;
/// How far along the ridge, share of s, and in how many steps.
const REACH: f64 = 0.3;
const STEPS: i32 = 40;
/// Values of j looked at from each place of the ridge.
const JUMPS: i32 = 16;

/// Whether a candidate leaves nothing but noise.
pub fn is_done(bench: &mut Bench<'_>, of: &Candidate) -> bool {
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
    model: ModelChoice,
    rng: &mut ChaCha8Rng,
) -> Class {
    for _ in 0..ROUNDS {
        let Some(best) = finalists.first().copied() else { break };
        if is_done(bench, &best) {
            break;
        }
        let best = other_class(bench, best, model);
        let mut held = vec![best];
        held.extend(valley(bench, &best));
        let held = race(bench, beam(&held, 6, 0), &[(6, 25), (3, 50), (1, 60)], rng);
        let Some(found) = held.first().and_then(|c| bench.settle(c)) else { break };
        let found = if found.fit.sse < best.fit.sse { found } else { best };
        let (simple, _) = demote(bench, Some(found), model);
        let better = found.fit.sse < 0.98 * finalists[0].fit.sse;
        *finalists = simple.into_iter().chain(held.into_iter().skip(1)).collect();
        if !better {
            break;
        }
    }
    bench.class
}

/// The candidate in the class that suits its slips best; its own unless another one is clearly better.
fn other_class(bench: &mut Bench<'_>, own: Candidate, model: ModelChoice) -> Candidate {
    let classes: &[Class] = match model {
        ModelChoice::Fopdt => &[Class::First, Class::Integrating],
        ModelChoice::Sopdt => &[Class::Second, Class::LagIntegrating],
        ModelChoice::Auto => &[Class::First, Class::Integrating, Class::Second, Class::LagIntegrating],
    };
    let home = bench.class;
    let tau = home.time_constants(&own.fit.shape).first().copied().unwrap_or(bench.question.period);
    let lag = home.lag(&own.fit.shape);
    let mut best = (own, home);
    for class in classes.iter().filter(|c| **c != home) {
        bench.class = *class;
        let limits = bench.question.limits;
        let shapes = [0.25, 1.0, 3.0].map(|by| class.clamp(class.start(tau * by, lag), &limits));
        let fitted = shapes.iter().filter_map(|shape| bench.fit(own.s, own.j, own.start, &[*shape], Effort::of(4)));
        let fitted = fitted.min_by(|a, b| a.fit.sse.total_cmp(&b.fit.sse));
        let settled = fitted.and_then(|c| bench.settle(&c)).filter(|c| c.fit.gain != 0.0);
        if let Some(settled) = settled.filter(|c| c.fit.sse < (1.0 - TAKEN) * best.0.fit.sse) {
            best = (settled, *class);
        }
    }
    bench.class = best.1;
    best.0
}

/// The best places along the ridge around a candidate, each with the jump that suits it best.
fn valley(bench: &mut Bench<'_>, around: &Candidate) -> Vec<Candidate> {
    let ridge = along(bench, around, REACH, STEPS);
    let mut pool = ridge.clone();
    for c in ridge.iter().take(4) {
        for k in 0..JUMPS {
            let j = c.s * libm::pow(0.03, f64::from(k) / f64::from(JUMPS - 1));
            let effort = Effort { steps: 1, hopeless: 3.0 * c.fit.sse, wanted: 1.5 * c.fit.sse };
            pool.extend(bench.fit(c.s, j, c.start, &[c.fit.shape], effort).filter(|c| c.fit.gain != 0.0));
        }
    }
    beam(&pool, 6, 0)
}
