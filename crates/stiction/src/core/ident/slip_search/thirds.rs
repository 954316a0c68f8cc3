//! Refits bands and process to each third of the record, starting near the answer. The valve is simulated from the record's
//! beginning, because the stem's position depends on everything before.
//!
//! A valve has one size within a window, so the spread of the thirds measures what one model's likelihood cannot: a stem that
//! deviates from the law, a load, a process that changes with the operating point.

use super::candidate::{Candidate, apart};
use super::evaluator::Evaluator;
use super::interval::centred;
use super::local_search::{Nearness, neighbours, random_steps};
use crate::core::ident::random::seeded_rng;
use crate::core::ident::width::{THIRDS, Third};
use rand_chacha::ChaCha8Rng;

/// Largest distance in ln s between the answer and the sizes that a third's search also starts from.
const REACH: f64 = 0.7;
/// Number of such sizes on either side.
const SIZES: i32 = 7;
/// Rivals of the answer that it also starts from.
const RIVALS: usize = 6;
/// Error relative to the best one up to which a place is refined, places followed, random steps from each, rounds through
/// neighbours.
const WORTH: f64 = 1.1;
const FOLLOWED: usize = 2;
const STEPS: usize = 24;
const ROUNDS: usize = 2;
/// Fewest reversals of the stem in a third from which the bands can be fitted.
const LEAST_REVERSALS: usize = 2;

/// Bands of each third, by the error filtered with `1 - rho q^-1`, in spans and points; `None` for a third in which the stem
/// hardly reverses.
pub(crate) fn thirds(
    evaluator: &mut Evaluator<'_>,
    rho: f64,
    best: &Candidate,
    rivals: &[Candidate],
    seed: u64,
) -> [Option<Third>; THIRDS] {
    let (from, points) = (evaluator.problem.normalised.from.max(1), evaluator.points);
    let at = |k: usize| from + points.saturating_sub(from) * k / THIRDS;
    let mut rng = seeded_rng(seed, 6);
    let others: Vec<Candidate> = apart(rivals, RIVALS, 0).into_iter().filter(|c| c.law == best.law).collect();
    core::array::from_fn(|k| third(evaluator, rho, [at(k), at(k + 1)], best, &others, &mut rng))
}

fn third(
    evaluator: &mut Evaluator<'_>,
    rho: f64,
    [from, to]: [usize; 2],
    best: &Candidate,
    rivals: &[Candidate],
    rng: &mut ChaCha8Rng,
) -> Option<Third> {
    let mut part = Evaluator::new(evaluator.problem, best.law, best.class, to);
    part.slip(best.s, best.j, best.start)?;
    let inside = |point: u32| (from..to).contains(&(point as usize));
    let reversals = part.steps().list.iter().filter(|step| inside(step.point) && step.direction != 0.0).count();
    if reversals < LEAST_REVERSALS {
        return None;
    }
    let mut view = evaluator.problem.view_of(rho, to, &[[from, to]]);
    let home = part.settle(&mut view, best)?;
    let mut pool = vec![home];
    let mut least = home.sse();
    let bands = sizes(&home).map(|bands| (bands, home.start)).chain(rivals.iter().map(|c| ([c.s, c.j], c.start)));
    for (bands, start) in bands.collect::<Vec<_>>() {
        let Some(found) = part.fit(&mut view, bands, start, &home.fit, WORTH * least) else { continue };
        least = least.min(found.sse());
        pool.push(found);
    }
    let mut held = apart(&pool, FOLLOWED, 0);
    for c in &mut held {
        *c = random_steps(&mut part, &mut view, *c, STEPS, Nearness::USUAL, rng);
        *c = neighbours(&mut part, &mut view, *c, ROUNDS, Nearness::USUAL);
    }
    evaluator.evaluations += part.evaluations;
    (evaluator.law, evaluator.class) = (best.law, best.class);
    let found = held.into_iter().min_by(|a, b| a.sse().total_cmp(&b.sse()))?;
    let [s, j] = centred(&found);
    Some(Third { s, j, gain: found.fit.gain / best.fit.gain, dead_time: found.fit.lag() })
}

/// Bands of other sizes than a candidate's, with the same shape and with the same kinetic band.
fn sizes(of: &Candidate) -> impl Iterator<Item = [f64; 2]> + use<> {
    let (s, j) = (of.s, of.j);
    (-SIZES..=SIZES).filter(|k| *k != 0).flat_map(move |k| {
        let wide = (s * libm::exp(REACH * f64::from(k) / f64::from(SIZES))).min(1.0);
        let shapes = [j / s * wide, (j + wide - s).clamp(0.0, wide)];
        shapes.map(|j| [wide, j])
    })
}
