//! Forward in time: fitted to the first part of a record, run freely over the rest.

use super::candidate::Parameters;
use super::express::fit;
use super::problem::Problem;
use super::schedule::Work;
use super::search::{NARROW, Search, local_search};
use super::types::Fit;

/// Share of the record that is fitted.
const FIRST: f64 = 0.6;
/// Fewest points of the rest.
const LEAST: usize = 40;

/// Models that were fitted to the first part.
pub struct FirstPart {
    /// First point of the rest.
    pub rest: usize,
    /// A fit for each search, its error that of the rest.
    pub fits: Vec<Fit>,
}

/// The best of each search, fitted to the first part; `None` where the rest is too short or a model finds no place.
pub(crate) fn fitted_to_first_part(
    problem: &Problem,
    searches: &[&Search],
    floor: Option<f64>,
    work: &mut Work<'_>,
) -> Option<FirstPart> {
    let from = problem.blocks.from;
    let rest = from + (FIRST * (problem.n() - from) as f64) as usize;
    if problem.n() - rest < LEAST || rest - from < LEAST {
        return None;
    }
    let held_out: Vec<bool> = (0..problem.n()).map(|k| k >= rest).collect();
    let fits = refitted(problem, &held_out, searches, floor, work)?;
    Some(FirstPart { rest, fits })
}

/// The best of each search, fitted again with other points held out; `None` where there is no time for all, or a model finds
/// no place.
pub(crate) fn refitted(
    problem: &Problem,
    held_out: &[bool],
    searches: &[&Search],
    floor: Option<f64>,
    work: &mut Work<'_>,
) -> Option<Vec<Fit>> {
    let part = problem.held_out_by(held_out);
    let seed = work.seed;
    let fitted = work.all(searches.len(), |i| {
        let source = searches[i];
        let thetas: Vec<Parameters> = source.best.iter().map(|b| b.theta).collect();
        let starts = source.best.iter().take(2).map(|b| b.theta.p).collect();
        let mut search = Search { best: Vec::new(), evaluations: 0, allowed: u64::MAX, starts, ..source.clone() };
        local_search(&part, &mut search, &thetas, &[], &NARROW, seed);
        search
    });
    work.done += fitted.iter().map(|l| l.evaluations).sum::<u64>();
    if fitted.len() < searches.len() {
        return None;
    }
    fitted.iter().map(|search| fit(&part, search, floor, &|_| {})).collect()
}
