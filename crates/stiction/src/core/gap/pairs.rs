//! Two effects at once, where none alone explains the record: the one that leaves least, and each of the next best beside it.

use super::candidate::{Candidate, MAX_PARAMS};
use super::problem::Problem;
use super::schedule::{Found, Work, share};
use super::search::{NARROW, Search, exchange, form_of};
use super::structure::Structure;
use super::types::EffectNote;
use super::weigh::{Scales, sort_by_lead};

/// Effects that are tried beside the first.
const SECONDS: usize = 5;

/// The first effect with each of the others, best first, and their searches.
pub(crate) fn run(
    problem: &Problem,
    found: &Found,
    scales: &Scales<'_>,
    work: &mut Work<'_>,
) -> (Vec<EffectNote>, Vec<Search>) {
    let mut singles: Vec<Search> = found.searches.iter().filter(|l| !l.best.is_empty()).cloned().collect();
    singles.sort_by(|a, b| a.sse().total_cmp(&b.sse()));
    let Some((first, others)) = singles.split_first() else { return (Vec::new(), Vec::new()) };
    let beside = others.iter().enumerate().filter_map(|(i, other)| paired(first, other, 200 + i as u64));
    let mut searches: Vec<Search> = beside.take(SECONDS).collect();
    singles.truncate(1 + SECONDS);
    singles.push(found.base.clone());
    let thetas = exchange(&singles, 2);
    if work.goes_on() {
        share(problem, &mut searches, &NARROW, work, &|_| thetas.clone(), &|_| &[]);
    }
    let mut out: Vec<EffectNote> = searches.iter().filter_map(|search| scales.weigh(search)).collect();
    sort_by_lead(&mut out);
    (out, searches)
}

/// The two effects in alphabetical order, starting from what each found alone.
fn paired(a: &Search, b: &Search, stream: u64) -> Option<Search> {
    let (a, b) = if a.structure.id() <= b.structure.id() { (a, b) } else { (b, a) };
    let (first, second) = (a.structure.each().next()?, b.structure.each().next()?);
    if first.params.len() + second.params.len() > MAX_PARAMS {
        return None;
    }
    if first.clashes.contains(&second.id) {
        return None;
    }
    let mut starts = Vec::new();
    for x in starts_of(a) {
        for y in starts_of(b) {
            let mut p = [0.0; MAX_PARAMS];
            let (left, right) = p.split_at_mut(first.params.len());
            left.copy_from_slice(&x.theta.p[..first.params.len()]);
            right[..second.params.len()].copy_from_slice(&y.theta.p[..second.params.len()]);
            starts.push(p);
        }
    }
    let structure = Structure { law: a.structure.law, effects: [Some(first), Some(second)] };
    Some(Search { structure, starts, best: Vec::new(), evaluations: 0, stream: 1000 * stream, ..a.clone() })
}

/// Two best places of a search, and the best of every other form of its effect.
fn starts_of(search: &Search) -> impl Iterator<Item = &Candidate> {
    let form = |s: &Candidate| form_of(&search.structure, &s.theta.p);
    let new = move |i: usize| search.best[..i].iter().all(|before| form(before) != form(&search.best[i]));
    search.best.iter().enumerate().filter(move |(i, _)| *i < 2 || new(*i)).map(|(_, place)| place)
}
