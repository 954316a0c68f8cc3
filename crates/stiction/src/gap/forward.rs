//! Forward in time: fitted to the first part of a record, run freely over the rest.

use super::candidate::Parameters;
use super::express::{above_floor, fit};
use super::problem::Problem;
use super::schedule::Work;
use super::search::{NARROW, Search, local_search};
use super::types::Forward;

/// Share of the record that is fitted.
const FIRST: f64 = 0.6;
/// Fewest points of the rest.
const LEAST: usize = 40;

/// Gaps of base and cause on the rest; `None` where the rest is too short or a model finds no place.
pub fn forward(
    problem: &Problem,
    base: &Search,
    cause: &Search,
    floor: Option<f64>,
    work: &mut Work<'_>,
) -> Option<Forward> {
    let from = problem.blocks.from;
    let cut = from + (FIRST * (problem.n() - from) as f64) as usize;
    if problem.n() - cut < LEAST || cut - from < LEAST {
        return None;
    }
    let held_out: Vec<bool> = (0..problem.n()).map(|k| k >= cut).collect();
    let part = problem.held_out_by(&held_out);
    let seed = work.seed;
    let searches = work.all(2, |i| {
        let source = if i == 0 { base } else { cause };
        let thetas: Vec<Parameters> = source.best.iter().map(|b| b.theta).collect();
        let starts = source.best.iter().take(2).map(|b| b.theta.p).collect();
        let mut search = Search { best: Vec::new(), evaluations: 0, allowed: u64::MAX, starts, ..source.clone() };
        local_search(&part, &mut search, &thetas, &[], &NARROW, seed);
        search
    });
    work.done += searches.iter().map(|l| l.evaluations).sum::<u64>();
    let gap = |search: &Search| fit(&part, search, floor, &|_| {}).map(|f| above_floor(f.rmse, floor));
    let [before, after] = [searches.first()?, searches.get(1)?].map(gap);
    Some(Forward { gap_before: before?, gap_after: after? })
}
