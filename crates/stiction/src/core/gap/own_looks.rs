//! Looks for slips of its own, for an effect that makes other slips than the base or another signal of them: from each of
//! its starts, since slips are right only where its parameters nearly are.

use super::candidate::{Candidate, MAX_PARAMS, Parameters};
use super::effects::{Clues, Effect, Start};
use super::evaluator::Evaluator;
use super::plain::PlainPass;
use super::plan::Plan;
use super::problem::{Problem, View};
use super::search::{AT_FIRST, Search, of_every_size, of_other_slips};
use super::settle::NEAR;
use super::slips::{Length, search_slips};
use super::structure::Structure;
use super::types::Stage;

/// Places of the first look, of each of two measures, at which a load's own clues are read, and starts taken from each.
const PLACES: usize = 10;
const STARTS: usize = 3;
/// Responses that one look computes, about.
const LOOK: f64 = 3000.0;

/// Places of the base's first look with what a load's own clues say of the residual there: the residual of the wrong
/// slips hides it. The places are the best by what is fast and by differences, where a slow load weighs little.
fn with_own_clues(problem: &Problem, search: &Search, thetas: &[Parameters]) -> (Vec<Parameters>, u64) {
    let Some(effect) = search.structure.each().next() else { return (Vec::new(), 0) };
    let base = Structure::base(search.structure.law);
    let mut evaluator = Evaluator::new(problem, search.sign);
    let mut out = Vec::new();
    for view in View::ALL {
        let seen: Vec<_> = thetas.iter().filter_map(|g| evaluator.fit(&base, g, view, NEAR)).collect();
        for place in of_every_size(seen, PLACES) {
            let Some(place) = evaluator.fit(&base, &place.theta, View::Plain, NEAR) else { continue };
            let Some((prediction, valve)) = free_run(problem, search.sign, &base, &place.theta) else { continue };
            let starts = starts_at(problem, effect, &place, &prediction, &valve);
            out.extend(starts.into_iter().take(STARTS).map(|p| Parameters { p, ..place.theta }));
        }
    }
    (out, evaluator.evaluations)
}

/// Where an effect's clues say that its parameters may lie, given the base's run at a place.
pub(crate) fn starts_at(
    problem: &Problem,
    effect: &Effect,
    at: &Candidate,
    prediction: &[f64],
    valve: &[f64],
) -> Vec<[f64; MAX_PARAMS]> {
    let residual: Vec<f64> = problem.normalised.pv.iter().zip(prediction).map(|(y, p)| y - p).collect();
    let low = valve.iter().copied().fold(f64::INFINITY, f64::min);
    let high = valve.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let clues = Clues { problem, residual: &residual, stem: [low, high], lag: at.theta.lag };
    let padded = |p: Start| core::array::from_fn(|i| p.get(i).copied().unwrap_or(0.0));
    (effect.starts)(&clues).into_iter().map(padded).collect()
}

/// Starts that each search may look from within so many responses.
pub(crate) fn most(searches: &[Search], responses: u64) -> usize {
    let looking = searches.iter().filter(|l| of_other_slips(l).iter().any(|part| !part.is_empty())).count();
    (responses as f64 / LOOK / looking.max(1) as f64) as usize
}

/// A look of its own for an effect that makes other slips of the same OP, or whose traces the wrong slips hide, from some
/// of its starts, and the responses computed; `looked` are the places of the base's.
pub(crate) fn first(
    problem: &Problem,
    search: &Search,
    looked: &[Parameters],
    most: usize,
    seed: u64,
) -> (Vec<Parameters>, u64) {
    if most > 0 && search.structure.each().any(|e| e.stage == Stage::Disturbance) {
        return with_own_clues(problem, search, looked);
    }
    let [some, _] = of_other_slips(search);
    look(problem, search, &some[..some.len().min(most)], seed)
}

/// The same from the starts that the first looks left out.
pub(crate) fn others(problem: &Problem, search: &Search, most: usize, seed: u64) -> (Vec<Parameters>, u64) {
    let [_, others] = of_other_slips(search);
    // Evenly from all of them, where there is no time for each.
    let every = others.len().div_ceil(most.max(1)).max(1);
    let some: Vec<_> = others.into_iter().step_by(every).collect();
    look(problem, search, &some, seed.wrapping_add(AT_FIRST as u64))
}

/// Looks for slips with the parameters of each start.
fn look(problem: &Problem, search: &Search, starts: &[[f64; MAX_PARAMS]], seed: u64) -> (Vec<Parameters>, u64) {
    let (mut thetas, mut count) = (Vec::new(), 0);
    for (i, p) in starts.iter().enumerate() {
        let alone = Search { starts: vec![*p], best: Vec::new(), ..search.clone() };
        let other = makes_other_slips(&search.structure.plan_of(p));
        let length = if other { Length::Rounds(1) } else { Length::Brief };
        let places = search_slips(problem, &alone, length, seed.wrapping_add(i as u64));
        thetas.extend(places.found);
        thetas.extend(places.scanned);
        count += places.evaluations;
    }
    (thetas, count)
}

/// Whether a stem answers OP with slips that no pair of bands gives, so that what the base's search met is of no use.
fn makes_other_slips(plan: &Plan) -> bool {
    plan.overshoot || plan.stroke.uneven != 0.0
}

/// The free run of a parameter vector, and its valve signal.
pub(crate) fn free_run(
    problem: &Problem,
    sign: f64,
    structure: &Structure,
    theta: &Parameters,
) -> Option<(Vec<f64>, Vec<f64>)> {
    let mut pass = PlainPass::new(problem, sign);
    let candidate = pass.evaluate(structure, theta, View::Plain)?;
    pass.simulate(structure, &candidate)
}

#[cfg(test)]
mod tests {
    use super::super::effects::ALL;
    use super::super::search::has_others;
    use super::*;
    use crate::core::sim::slips::Law;

    #[test]
    fn every_start_with_slips_of_its_own_is_looked_from_once() {
        let at = |alpha: f64| core::array::from_fn(|i| if i == 0 { alpha } else { 0.0 });
        let starts: Vec<[f64; MAX_PARAMS]> = (-9..=9).map(|k| at(0.07 * f64::from(k))).collect();
        let makes_uneven = |e: &&'static Effect| {
            let mut plan = Plan::base(Some(Law::He));
            (e.apply)(&at(0.3), &mut plan);
            plan.stroke.uneven != 0.0
        };
        let structure = Structure::with(Some(Law::He), ALL.into_iter().find(makes_uneven).unwrap());
        let search = |starts: &[[f64; MAX_PARAMS]]| Search {
            structure,
            sign: 1.0,
            starts: starts.to_vec(),
            best: Vec::new(),
            evaluations: 0,
            allowed: 0,
            stream: 0,
        };
        let [some, others] = of_other_slips(&search(&starts));
        assert_eq!((some.len(), has_others(&search(&starts))), (AT_FIRST, true));
        let mut both = [some, others].concat();
        both.sort_by(|a, b| a[0].total_cmp(&b[0]));
        // Even bands make the base's slips.
        let uneven: Vec<_> = starts.iter().copied().filter(|p| p[0] != 0.0).collect();
        assert_eq!(both, uneven);
        assert!(!has_others(&search(&starts[..AT_FIRST])));
        // Six thousand responses are two looks, for one search that looks.
        assert_eq!(most(&[search(&starts), search(&[[0.0; MAX_PARAMS]])], 6_000), 2);
    }
}
