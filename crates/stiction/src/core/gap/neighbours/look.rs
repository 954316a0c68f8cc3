//! The neighbours that tell most of PV: judged under the noise model, and each fitted together with the base.

use std::sync::Arc;

use super::super::budget::{Known, acting_load};
use super::super::candidate::MAX_PARAMS;
use super::super::effects::neighbour::EFFECT;
use super::super::neighbour::{Load, Neighbour};
use super::super::problem::{Problem, period_of};
use super::super::schedule::{Found, Work, look_again};
use super::super::search::{FIRST, Search, exchange, local_search};
use super::super::signatures;
use super::super::structure::Structure;
use super::super::types::{Compared, Fit};
use super::scan::{Hit, Scan};
use crate::core::record::Record;

/// p-value up to which a neighbour is fitted.
const RARE: f64 = 0.05;
/// Signals that are fitted at most, the share of the best one's telling that they have at least, and that of their own present
/// and future.
const FITTED: usize = 4;
const NEAR: f64 = 0.5;
const LEADS: f64 = 0.9;
/// Fits that are searched again, and how often.
const AGAIN: usize = 2;
const TIMES: u64 = 2;
/// Where the random steps of these searches are drawn from.
const STREAM: u64 = 400;

/// What the neighbours came to, and their fits.
#[derive(Debug)]
pub(in crate::core::gap) struct Offered {
    /// For documents.
    pub compared: Compared,
    /// The signals that were judged.
    pub loads: Vec<Load>,
    /// Best first, each with the problem that has its signal; one for each neighbour.
    pub fits: Vec<(Problem, Search)>,
}

/// Scans the neighbours and fits the best of them; `None` where there are none.
pub(in crate::core::gap) fn look(
    record: &Record,
    problem: &Problem,
    found: &Found,
    base: Option<&Fit>,
    neighbours: &[Neighbour],
    work: &mut Work<'_>,
) -> Option<Offered> {
    let (mut compared, loads) =
        judged(record, problem, neighbours, base.map_or(&[], core::slice::from_ref), work.seed)?;
    let fits = fitted(problem, found, loads.clone(), work);
    compared.fitted = fits.iter().filter_map(|(own, _)| Some(own.neighbour.as_ref()?.name.clone())).collect();
    Some(Offered { compared, loads, fits })
}

/// Compares a record with neighbours without a search for its base, so that OP stands for the stem; nothing is fitted together.
/// `None` where there are no neighbours. `period` is that of the oscillation, points.
#[must_use]
pub fn compare(record: &Record, neighbours: &[Neighbour], period: Option<f64>, seed: u64) -> Option<Compared> {
    let traces = signatures::traces(record, period.unwrap_or_else(|| period_of(record).0), &[]);
    let problem = Problem::new(record, period, seed, traces.masked.clone()).fitted_where(&traces.measured);
    judged(record, &problem, neighbours, &[], seed).map(|(compared, _)| compared)
}

/// What the scan tells, which signals are rare enough to be judged, and which of them the noise model has in both halves.
fn judged(
    record: &Record,
    problem: &Problem,
    neighbours: &[Neighbour],
    models: &[Fit],
    seed: u64,
) -> Option<(Compared, Vec<Load>)> {
    if neighbours.is_empty() {
        return None;
    }
    let scan = Scan::new(problem, neighbours);
    let hits = scan.hits();
    let p_value = scan.p_value(seed);
    let loads = p_value.filter(|p| *p <= RARE).map_or_else(Vec::new, |p| chosen(neighbours, &hits, p));
    let known = Known { models, from: problem.blocks.from, loads: &loads, ..Known::default() };
    let compared = Compared {
        offered: neighbours.len(),
        best: hits.first().map(|hit| neighbours[hit.neighbour].name.clone()),
        share: hits.first().map(|hit| hit.share),
        p_value,
        acts: (!loads.is_empty()).then(|| acting_load(record, &known)).flatten(),
        fitted: Vec::new(),
    };
    Some((compared, loads))
}

/// The signals that tell nearly as much as the best one, each from its past, as loads.
fn chosen(neighbours: &[Neighbour], hits: &[Hit], p_value: f64) -> Vec<Load> {
    let most = hits.first().map_or(0.0, |hit| hit.share);
    let acts = |hit: &&Hit| hit.share >= NEAR * most && hit.share >= LEADS * hit.future;
    let load = |hit: &Hit| {
        let neighbour = &neighbours[hit.neighbour];
        let signal = if hit.from_op { &neighbour.op } else { &neighbour.pv };
        Load::new(&neighbour.name, hit.from_op, signal, p_value)
    };
    hits.iter().filter(acts).take(FITTED).map(load).collect()
}

/// Lags and delays from which a fit begins.
fn starts(problem: &Problem) -> Vec<[f64; MAX_PARAMS]> {
    let mut out = Vec::new();
    for lag in [0.01, 0.06, 0.2] {
        for delay in [0.0, 0.06, 0.14, 0.25, 0.4] {
            let mut start = [0.0; MAX_PARAMS];
            (start[0], start[1]) = (libm::log(lag * problem.period), (delay * problem.period).max(1.0));
            out.push(start);
        }
    }
    out
}

/// The searches from these places, best first, the best of each neighbour.
fn fitted(problem: &Problem, found: &Found, chosen: Vec<Load>, work: &mut Work<'_>) -> Vec<(Problem, Search)> {
    if chosen.is_empty() || !work.goes_on() {
        return Vec::new();
    }
    let base = &found.base;
    let mut from = exchange(core::slice::from_ref(base), 4);
    from.extend(found.by_moves.iter().map(|place| place.theta).chain(found.met.iter().copied()));
    let seed = work.seed;
    let made = work.all(chosen.len(), |i| {
        let mut own = problem.clone();
        own.neighbour = Some(Arc::new(chosen[i].clone()));
        let mut search = Search {
            structure: Structure::with(base.structure.law, &EFFECT),
            starts: starts(problem),
            best: Vec::new(),
            evaluations: 0,
            allowed: u64::MAX,
            stream: 1000 * (STREAM + i as u64),
            ..base.clone()
        };
        local_search(&own, &mut search, &from, &[], &FIRST, seed);
        (own, search)
    });
    let mut fits = sorted(made, work);
    for time in 0..TIMES {
        if !work.goes_on() {
            break;
        }
        let count = AGAIN.min(fits.len());
        let rest = fits.split_off(count);
        let mut again = work.all(count, |i| {
            let (own, search) = &fits[i];
            let mut search = Search { evaluations: 0, ..search.clone() };
            look_again(own, &mut search, time % 2 == 1, seed.wrapping_add((STREAM + time) << 32));
            (own.clone(), search)
        });
        again.extend(rest.into_iter().map(|(own, search)| (own, Search { evaluations: 0, ..search })));
        fits = sorted(again, work);
    }
    let mut names: Vec<String> = Vec::new();
    fits.retain(|(own, search)| {
        let name = own.neighbour.as_ref().map(|load| load.name.clone()).unwrap_or_default();
        let is_new = !names.contains(&name) && !search.best.is_empty();
        names.push(name);
        is_new
    });
    fits
}

/// Best first; what they computed counts as work.
fn sorted(mut fits: Vec<(Problem, Search)>, work: &mut Work<'_>) -> Vec<(Problem, Search)> {
    work.done += fits.iter().map(|(_, search)| search.evaluations).sum::<u64>();
    fits.sort_by(|(_, a), (_, b)| a.sse().total_cmp(&b.sse()));
    fits
}
