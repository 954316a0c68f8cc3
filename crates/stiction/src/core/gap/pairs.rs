//! Two effects at once, where none alone explains the record: built from the best single ones.

use super::candidate::{Candidate, MAX_PARAMS, Parameters};
use super::evaluator::Evaluator;
use super::problem::{Problem, View};
use super::schedule::{Found, Work, search_again, share};
use super::search::{NARROW, Search, exchange, form_of};
use super::settle::fitted_to;
use super::structure::Structure;
use super::types::EffectResult;
use super::weigh::{Scales, sort_by_lead};

/// Single effects that are paired, and pairs of these that are searched.
const SINGLES: usize = 6;
const SEARCHED: usize = 5;
/// Error over the floor beyond which, after its first round, no pair is looked for further: one that is named leaves next
/// to nothing.
const HOPELESS: f64 = 2.0;
/// Where the searches' rounds with other chance begin, behind those of single effects.
const AGAIN_FROM: u64 = 8;

/// Pairs of the best single effects, best first, and their searches: of those that leave least before any step.
pub(crate) fn run(
    problem: &Problem,
    found: &Found,
    scales: &Scales<'_>,
    work: &mut Work<'_>,
) -> (Vec<EffectResult>, Vec<Search>) {
    let mut singles: Vec<Search> = found.searches.iter().filter(|l| !l.best.is_empty()).cloned().collect();
    singles.sort_by(|a, b| a.sse().total_cmp(&b.sse()));
    singles.truncate(SINGLES);
    let mut searches: Vec<Search> = Vec::new();
    for (i, a) in singles.iter().enumerate() {
        for b in &singles[i + 1..] {
            searches.extend(paired(a, b, 200 + searches.len() as u64));
        }
    }
    singles.push(found.base.clone());
    let thetas = exchange(&singles, 2);
    if work.goes_on() {
        keep_best(problem, &mut searches, &thetas, work);
        share(problem, &mut searches, &NARROW, work, &|_| thetas.clone(), &|_| &[]);
    }
    if !is_hopeless(problem, &searches, scales.floor.noise_floor) {
        search_again(problem, &mut searches, scales.floor.noise_floor, AGAIN_FROM, work);
    }
    let mut out: Vec<EffectResult> = searches.iter().filter_map(|search| scales.weigh(search)).collect();
    sort_by_lead(&mut out);
    (out, searches)
}

/// Keeps the pairs that leave least where their searches begin.
fn keep_best(problem: &Problem, searches: &mut Vec<Search>, thetas: &[Parameters], work: &mut Work<'_>) {
    let looks = work.all(searches.len(), |i| {
        let search = &searches[i];
        let mut evaluator = Evaluator::new(problem, search.sign);
        let places = thetas.iter().flat_map(|theta| search.starts.iter().map(|p| Parameters { p: *p, ..*theta }));
        let fitted = places.flat_map(|theta| fitted_to(&search.structure, theta, problem));
        let errors = fitted.filter_map(|theta| evaluator.fit(&search.structure, &theta, View::Plain, &[]));
        let least = errors.map(|c| c.sse).fold(f64::INFINITY, f64::min);
        (least, evaluator.evaluations)
    });
    work.done += looks.iter().map(|(_, evaluations)| evaluations).sum::<u64>();
    let mut ranked: Vec<(f64, Search)> = looks.into_iter().map(|(least, _)| least).zip(searches.drain(..)).collect();
    ranked.sort_by(|a, b| a.0.total_cmp(&b.0));
    searches.extend(ranked.into_iter().take(SEARCHED).map(|(_, search)| search));
}

/// Whether no pair comes near the floor.
fn is_hopeless(problem: &Problem, searches: &[Search], floor: Option<f64>) -> bool {
    let n = problem.target(View::Plain).len().max(1) as f64;
    let least = searches.iter().map(Search::sse).fold(f64::INFINITY, f64::min);
    floor.is_some_and(|floor| (least / n).sqrt() * problem.normalised.deviation > HOPELESS * floor)
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
