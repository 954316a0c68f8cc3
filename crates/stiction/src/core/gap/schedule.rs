//! The rounds of a diagnosis: the base first, then every effect with the same work, then the likely ones with more of it,
//! and what each found for all that are not far behind.
//!
//! Between rounds the executor is asked whether to go on; a search that it ends early has done whole rounds only, so the
//! evaluations it reports name it. What the budget leaves is shared evenly by the searches of a round.

use std::sync::Mutex;

use super::candidate::{Candidate, MAX_PARAMS, Parameters};
use super::effects::{ALL, Effect, Unit, Way};
use super::express::rms;
use super::own_looks;
use super::plain::PlainPass;
use super::problem::Problem;
use super::search::{
    Effort, FIRST, MIDDLE, NARROW, SMALL, Search, WIDE, by_differences, exchange, has_others, has_own_search,
    local_search,
};
use super::settle::clamped;
use super::slips::{Length, Places, frictionless, search_slips};
use super::structure::Structure;
use super::types::{AT_FLOOR, Ended, Executor};
use crate::core::ident::class::Class;
use crate::core::ident::random::{normal, seeded_rng};
use crate::core::ident::residual;
use crate::core::sim::slips::Law;

/// Rounds of the estimate's search that are asked for.
const SLIP_ROUNDS: Length = Length::Rounds(3);
/// Relative gain in squared error below which a search has not improved.
const NO_GAIN: f64 = 0.003;
/// Responses that a search for the base is given at least: without a base nothing can be said.
const BASE_AT_LEAST: u64 = 10_000;
/// Squared error over the best one from which an effect gets no other starts, and from which it is out of the running, so
/// that it does not try what others find.
const BEHIND: f64 = 4.0;
const FAR_BEHIND: f64 = 9.0;
/// Searches for the right slips at most beyond the first, of the base and of the effects.
const AGAIN: u64 = 1;
/// Shares of the budget that the base has at most, and of what it leaves that the effects' own first looks have.
const OF_BASE: f64 = 0.4;
const OF_LOOKS: f64 = 0.5;
/// Effects, the best by what they leave, that are searched again at a time.
const LIKELY: usize = 3;
/// Times at most that each of these is searched again with the parameters at hand and then beside them, while it gains.
const MOST_AGAIN: u64 = 2;
/// Responses that the search for the right slips of one effect computes, about.
const LOOK_AGAIN: u64 = 30_000;
/// Error over the floor at which a white base is the answer and a narrow search for each effect is enough.
const CALM: f64 = 1.04;
/// The same whatever colour the rest has.
const SETTLED: f64 = 1.02;

/// Work done, and who does it.
pub struct Work<'c> {
    /// The executor.
    pub executor: &'c dyn Executor,
    /// Evaluations at which the search at hand ends.
    pub budget: u64,
    /// Evaluations done.
    pub done: u64,
    /// Whether the executor ended all work.
    pub stopped: bool,
    /// Whether a search ended because its budget was spent.
    pub spent: bool,
    /// Seed.
    pub seed: u64,
    /// Evaluations at which the executor was asked last: it is asked once, for a search that is ended there by its count
    /// must end at the same round.
    pub asked: Option<u64>,
}

impl Work<'_> {
    /// Runs jobs and gives their results in order.
    ///
    /// # Panics
    /// The executor leaves out a job: another's result would take its place.
    pub(crate) fn all<T: Send>(&self, jobs: usize, job: impl Fn(usize) -> T + Sync) -> Vec<T> {
        let slots: Vec<Mutex<Option<T>>> = (0..jobs).map(|_| Mutex::new(None)).collect();
        self.executor.run(jobs, &|i| {
            let made = job(i);
            if let Ok(mut slot) = slots[i].lock() {
                *slot = Some(made);
            }
        });
        let made: Vec<T> = slots.into_iter().filter_map(|slot| slot.into_inner().ok().flatten()).collect();
        assert!(made.len() == jobs, "the executor ran {} of {jobs} jobs", made.len());
        made
    }

    /// Responses that are left of the budget.
    const fn left(&self) -> u64 {
        self.budget.saturating_sub(self.done)
    }

    /// Responses that each of so many searches may compute, so that the budget is kept.
    fn allowed(&self, searches: usize) -> u64 {
        self.left().div_ceil(searches.max(1) as u64)
    }

    /// Responses that a share of what is left comes to.
    fn part(&self, share: f64) -> u64 {
        (share * self.left() as f64) as u64
    }

    /// Whether another round may begin.
    pub(crate) fn goes_on(&mut self) -> bool {
        if self.asked != Some(self.done) {
            self.stopped |= !self.executor.tick(self.done);
            self.asked = Some(self.done);
        }
        let spent = self.done >= self.budget;
        self.spent |= spent;
        !self.stopped && !spent
    }

    /// Gives another search as much as the first one had.
    pub(crate) const fn begin(&mut self, budget: u64) {
        self.budget = self.done.saturating_add(budget);
    }
}

/// All that the rounds found.
#[derive(Debug)]
pub struct Found {
    /// The base.
    pub base: Search,
    /// The base's best place by differences, where a slow disturbance weighs little.
    pub by_moves: Option<Candidate>,
    /// All that the base's search for slips met.
    pub met: Vec<Parameters>,
    /// Base and one effect each.
    pub searches: Vec<Search>,
    /// Why the search ended.
    pub ended: Ended,
}

/// Effects of the catalogue that are simulated against this base.
#[must_use]
pub(crate) fn simulated(linear_base: bool) -> Vec<&'static Effect> {
    let wanted = |e: &&Effect| match e.way {
        Way::Simulated => !linear_base || !e.needs_friction,
        Way::AgainstLinear => linear_base,
        _ => false,
    };
    ALL.into_iter().filter(wanted).collect()
}

fn search(structure: Structure, sign: f64, starts: Vec<[f64; MAX_PARAMS]>, stream: u64) -> Search {
    Search { structure, sign, starts, best: Vec::new(), evaluations: 0, allowed: u64::MAX, stream: 1000 * stream }
}

/// The base, fitted, and all that its search for slips met; `None` where nothing in PV follows OP.
///
/// While it leaves more than noise, a scan of another part of the record with other chance says where to begin again, up
/// to [`AGAIN`] times: every effect starts from the base's slips.
#[must_use]
pub(crate) fn base(
    problem: &Problem,
    law: Option<Law>,
    floor: Option<f64>,
    work: &mut Work<'_>,
) -> Option<(Search, Vec<Parameters>)> {
    let enough = work.done.saturating_add(work.part(OF_BASE));
    let (mut base, thetas) = base_once(problem, law, work)?;
    for round in 0..AGAIN {
        if law.is_none() || is_settled(problem, &base, floor) || work.done >= enough || !work.goes_on() {
            break;
        }
        let seed = work.seed.wrapping_add((1 + round) << 32);
        let allowed = work.allowed(1);
        let found = work.all(1, |_| {
            let mut search = Search { allowed, ..base.clone() };
            look_again(problem, &mut search, false, seed);
            search
        });
        let Some(better) = found.into_iter().next() else { break };
        work.done += better.evaluations - base.evaluations;
        base = better;
    }
    Some((base, thetas))
}

/// One search for the base.
fn base_once(problem: &Problem, law: Option<Law>, work: &mut Work<'_>) -> Option<(Search, Vec<Parameters>)> {
    let signs: Vec<f64> = problem.sign.map_or_else(|| vec![1.0, -1.0], |s| vec![s]);
    let seed = work.seed;
    let structure = Structure::base(law);
    let nowhere = vec![[0.0; MAX_PARAMS]];
    let places = work.all(signs.len(), |i| match law {
        Some(_) => search_slips(problem, &search(structure, signs[i], nowhere.clone(), 0), SLIP_ROUNDS, seed),
        None => Places { scanned: frictionless(problem), ..Places::default() },
    });
    work.done += places.iter().map(|p| p.evaluations).sum::<u64>();
    // Twice with other chance: the base must not lose by bad luck.
    let jobs = 2 * signs.len();
    let allowed = work.part(OF_BASE).div_ceil(jobs as u64).max(BASE_AT_LEAST);
    let searches = work.all(jobs, |i| {
        let sign = i / 2;
        let mut search = search(structure, signs[sign], nowhere.clone(), 1 + i as u64);
        search.allowed = allowed;
        if let Some(places) = places.get(sign) {
            // The one begins where the search for slips ends, the other where its coarse scans do.
            let from_slips = i % 2 == 0 && law.is_some();
            let (from, effort) = if from_slips { (&places.found, &NARROW) } else { (&places.scanned, &WIDE) };
            local_search(problem, &mut search, from, &problem.stated, effort, seed);
        }
        search
    });
    work.done += searches.iter().map(|l| l.evaluations).sum::<u64>();
    let best = searches.iter().min_by(|a, b| a.sse().total_cmp(&b.sse()))?.clone();
    if best.best.is_empty() {
        return None;
    }
    let mut base = Search { evaluations: searches.iter().map(|l| l.evaluations).sum(), ..best };
    for other in searches.iter().filter(|l| l.sign == base.sign && l.stream != base.stream) {
        base.best.extend(other.best.iter().take(3).copied());
    }
    base.best.sort_by(|a, b| a.sse.total_cmp(&b.sse));
    let places = places.into_iter().zip(&signs).find(|(_, s)| **s == base.sign).map(|(p, _)| p)?;
    // Under a load the right slips may be those of a part of the record, or only have been looked at.
    Some((base, places.found.into_iter().chain(places.scanned).collect()))
}

/// Whether a search is at the floor and leaves white noise that does not follow OP.
#[must_use]
pub(crate) fn is_calm(problem: &Problem, search: &Search, floor: Option<f64>) -> bool {
    let Some(left) = residual_of(problem, search).filter(|left| reaches(problem, left, floor, CALM)) else {
        return false;
    };
    residual::whiteness_where(&left, &problem.normalised.mean, &problem.train).is_noise()
}

/// Whether nothing is left to be found: white noise at the floor, or so little above it that no effect gains what its
/// margin asks for, whatever colour it has.
fn is_settled(problem: &Problem, search: &Search, floor: Option<f64>) -> bool {
    let left = residual_of(problem, search);
    left.is_some_and(|left| reaches(problem, &left, floor, SETTLED)) || is_calm(problem, search, floor)
}

/// Whether an effect leaves so little that the others need no more starts.
fn is_explained(problem: &Problem, search: &Search, floor: Option<f64>) -> bool {
    residual_of(problem, search).is_some_and(|left| reaches(problem, &left, floor, AT_FLOOR))
}

/// Whether what is left is within a factor of the floor, white or not.
fn reaches(problem: &Problem, left: &[f64], floor: Option<f64>, within: f64) -> bool {
    floor.is_some_and(|floor| rms(left, &problem.train) * problem.normalised.deviation <= within * floor)
}

/// What a search's best candidate leaves of PV at each point, deviations.
#[must_use]
pub(crate) fn residual_of(problem: &Problem, search: &Search) -> Option<Vec<f64>> {
    let place = search.best.first()?;
    let (prediction, _) = PlainPass::new(problem, search.sign).simulate(&search.structure, place)?;
    Some(problem.normalised.pv.iter().zip(&prediction).map(|(y, p)| y - p).collect())
}

/// The starts of every effect's search.
fn searches_of(problem: &Problem, base: &Search, effects: &[&'static Effect]) -> Vec<Search> {
    let Some(best) = base.best.first() else { return Vec::new() };
    let run = PlainPass::new(problem, base.sign).simulate(&base.structure, best);
    let Some((prediction, valve)) = run else { return Vec::new() };
    let own = |e: &Effect| own_looks::starts_at(problem, e, best, &prediction, &valve);
    let structure = |e: &'static Effect| Structure::with(base.structure.law, e);
    effects.iter().enumerate().map(|(i, e)| search(structure(e), base.sign, own(e), 10 + i as u64)).collect()
}

/// Base and effects, as far as the budget goes.
#[must_use]
pub(crate) fn run(
    problem: &Problem,
    base_law: Option<Law>,
    without: &[String],
    floor: Option<f64>,
    work: &mut Work<'_>,
) -> Option<Found> {
    let (mut base, thetas) = base(problem, base_law, floor, work)?;
    let calm = is_settled(problem, &base, floor);
    let effects: Vec<&'static Effect> =
        simulated(base_law.is_none()).into_iter().filter(|e| !without.iter().any(|w| w == e.id)).collect();
    let by_moves = if calm || base_law.is_none() { None } else { by_moves(problem, &base, &thetas, work) };
    let mut searches = searches_of(problem, &base, &effects);
    // Against a base without friction nobody else looks for slips: the search for He's base is made for it.
    let sticking = searches.iter().position(|l| l.structure.each().any(|e| e.way == Way::AgainstLinear));
    if let (Some(at), true) = (sticking, work.goes_on())
        && let Some((found, _)) = self::base(problem, Some(Law::He), floor, work)
    {
        searches[at] =
            Search { sign: found.sign, best: found.best, evaluations: found.evaluations, ..searches[at].clone() };
    }
    if work.goes_on() {
        let mut from = exchange(core::slice::from_ref(&base), 4);
        if !calm {
            from.extend(&thetas);
        }
        let seed = work.seed;
        let most = if calm { 0 } else { own_looks::most(&searches, work.part(OF_LOOKS)).max(1) };
        let own = work.all(searches.len(), |i| own_looks::first(problem, &searches[i], &thetas, most, seed));
        work.done += own.iter().map(|(_, n)| n).sum::<u64>();
        let effort = if calm { &NARROW } else { &FIRST };
        let own = |i: usize| own.get(i).map_or(&[][..], |(thetas, _)| thetas);
        share(problem, &mut searches, effort, work, &|_| from.clone(), &own);
        if !calm && !searches.iter().any(|search| is_explained(problem, search, floor)) {
            from_other_starts(problem, &mut searches, work);
        }
    }
    let gains = !calm && search_again(problem, &mut searches, floor, work);
    let exchanged = !calm && work.goes_on() && exchange_round(problem, &mut base, &mut searches, work);
    let best = searches.iter().min_by(|a, b| a.sse().total_cmp(&b.sse()));
    let ended = if work.stopped {
        Ended::Stopped
    } else if work.spent {
        Ended::Budget
    } else if is_calm(problem, &base, floor) {
        Ended::Noise
    } else if best.is_some_and(|search| is_calm(problem, search, floor)) {
        Ended::Explained
    } else if gains || exchanged {
        Ended::Complete
    } else {
        Ended::Agreement
    };
    Some(Found { base, by_moves, met: thetas, searches, ended })
}

/// The base's best place by differences, from its own and from all that its search for slips met.
fn by_moves(problem: &Problem, base: &Search, thetas: &[Parameters], work: &mut Work<'_>) -> Option<Candidate> {
    let from: Vec<Parameters> = base.best.iter().map(|b| b.theta).chain(thetas.iter().copied()).collect();
    let (found, evaluations) = by_differences(problem, base, &from, work.seed);
    work.done += evaluations;
    found
}

/// A round in which the base and every search that is not far behind try what the others found. Says whether one gained.
fn exchange_round(problem: &Problem, base: &mut Search, searches: &mut Vec<Search>, work: &mut Work<'_>) -> bool {
    let best = searches.iter().map(Search::sse).fold(base.sse(), f64::min);
    // What holds a better one as a special case has only been searched badly.
    let better = |l: &Search| searches.iter().any(|o| holds(l, o) && o.sse() <= FAR_BEHIND * best);
    let kept: Vec<bool> = searches.iter().map(|l| l.sse() <= FAR_BEHIND * best || better(l)).collect();
    let mut kept = kept.into_iter();
    let (near, far): (Vec<Search>, Vec<Search>) = searches.drain(..).partition(|_| kept.next().unwrap_or(true));
    let mut all = vec![base.clone()];
    all.extend(near);
    let before: Vec<f64> = all.iter().map(Search::sse).collect();
    let thetas = exchange(&all, 2);
    let held: Vec<Vec<Parameters>> = all.iter().map(|l| special_cases(l, &all)).collect();
    share(problem, &mut all, &SMALL, work, &|_| thetas.clone(), &|i| &held[i]);
    let gains = before.iter().zip(&all).any(|(b, a)| a.sse() < (1.0 - NO_GAIN) * b);
    *base = all.remove(0);
    searches.extend(all.into_iter().chain(far));
    gains
}

/// Whether a search's effect holds another's as a special case.
fn holds(search: &Search, other: &Search) -> bool {
    search.structure.each().any(|e| e.holds.is_some_and(|id| other.structure.id() == id))
}

/// The best places, as they are, of what a search's effect holds as a special case.
fn special_cases(search: &Search, all: &[Search]) -> Vec<Parameters> {
    let others = all.iter().filter(|other| holds(search, other));
    others.flat_map(|other| other.best.iter().take(2)).map(|b| b.theta).collect()
}

/// More work for the searches at these places. Says which of them gained from it.
fn go_on(searches: &mut [Search], at: &[usize], work: &mut Work<'_>, job: &(dyn Fn(&mut Search) + Sync)) -> Vec<usize> {
    let allowed = work.allowed(at.len());
    let made = work.all(at.len(), |i| {
        let mut search = Search { allowed, ..searches[at[i]].clone() };
        job(&mut search);
        search
    });
    let mut gained = Vec::new();
    for (at, search) in at.iter().zip(made) {
        let before = &mut searches[*at];
        work.done += search.evaluations - before.evaluations;
        if search.sse() < (1.0 - NO_GAIN) * before.sse() {
            gained.push(*at);
        }
        *before = search;
    }
    gained
}

/// Other searches for slips, with the parameters found so far and beside them, for each of the most likely structures that
/// gains by one of the two, while none explains everything. Says whether one gained.
fn search_again(problem: &Problem, searches: &mut [Search], floor: Option<f64>, work: &mut Work<'_>) -> bool {
    let mut gains = false;
    let mut given_up: Vec<usize> = Vec::new();
    for again in 0..MOST_AGAIN {
        let seed = work.seed.wrapping_add((AGAIN + 1 + 2 * again) << 32);
        let (mut asked, mut gained) = (Vec::new(), Vec::new());
        for beside in [false, true] {
            let at = likely(problem, searches, floor, &given_up, work);
            let seed = seed.wrapping_add(u64::from(beside) << 32);
            gained.extend(go_on(searches, &at, work, &|search| look_again(problem, search, beside, seed)));
            asked.extend(at);
        }
        given_up.extend(asked.into_iter().filter(|at| !gained.contains(at)));
        gains |= !gained.is_empty();
    }
    gains
}

/// The searches, the best by what they leave, that are worth another look; none where one of them explains everything.
fn likely(
    problem: &Problem,
    searches: &[Search],
    floor: Option<f64>,
    given_up: &[usize],
    work: &mut Work<'_>,
) -> Vec<usize> {
    let mut order: Vec<usize> = (0..searches.len()).collect();
    order.sort_by(|a, b| searches[*a].sse().total_cmp(&searches[*b].sse()));
    order.truncate(LIKELY.min((work.left() / LOOK_AGAIN) as usize));
    if order.first().is_none_or(|best| is_settled(problem, &searches[*best], floor)) || !work.goes_on() {
        return Vec::new();
    }
    order.retain(|at| !given_up.contains(at));
    order
}

/// Another search for slips with other chance and the parameters found so far, or `beside` them, and a local search from
/// where it leads.
pub(crate) fn look_again(problem: &Problem, search: &mut Search, beside: bool, seed: u64) {
    let (mut from, mut evaluations) = (Vec::new(), 0);
    let mut look = |search: &Search, length: Length, seed: u64| {
        let places = search_slips(problem, search, length, seed);
        from.extend(places.found.into_iter().chain(places.scanned));
        evaluations += places.evaluations;
    };
    let others = if beside { parameters_beside(problem, search, seed) } else { Vec::new() };
    for (i, p) in others.iter().enumerate() {
        let alone = Search { starts: vec![*p], best: Vec::new(), ..search.clone() };
        look(&alone, Length::Rounds(1), seed + i as u64);
    }
    if others.is_empty() {
        look(search, SLIP_ROUNDS, seed);
    }
    let effort = if search.structure.each().next().is_some() { &FIRST } else { &MIDDLE };
    local_search(problem, search, &[], &from, effort, seed);
    search.evaluations += evaluations;
}

/// Parameters beside the best ones, of an effect that makes other slips or another signal of them: where they are a little
/// off, so are the slips, and the search for these finds what is wrong everywhere a little. None where that search finds
/// them itself.
fn parameters_beside(problem: &Problem, search: &Search, seed: u64) -> Vec<[f64; MAX_PARAMS]> {
    /// How far beside, as a share of a parameter's range.
    const FAR: [f64; 3] = [0.02, 0.06, 0.15];
    let Some(best) = search.best.first() else { return Vec::new() };
    let plan = search.structure.plan(&best.theta);
    let free: Vec<usize> =
        search.structure.params().enumerate().filter(|(_, p)| p.unit != Unit::Choice).map(|(i, _)| i).collect();
    if free.is_empty() || plan.class() != Class::First || !has_own_search(&plan, &search.structure) {
        return Vec::new();
    }
    let mut rng = seeded_rng(seed, 98);
    let near = |far: f64| {
        let mut theta = best.theta;
        for (at, param) in search.structure.params().enumerate().filter(|(i, _)| free.contains(i)) {
            let [low, high] = param.bounds(problem);
            theta.p[at] += far * (high - low) * normal(&mut rng);
        }
        clamped(&search.structure, theta, problem).p
    };
    FAR.into_iter().map(near).collect()
}

/// Looks of their own from the starts that the first ones left out, and a local search from where they lead.
fn from_other_starts(problem: &Problem, searches: &mut [Search], work: &mut Work<'_>) {
    let most = own_looks::most(searches, work.part(OF_LOOKS));
    let near = BEHIND * searches.iter().map(Search::sse).fold(f64::INFINITY, f64::min);
    let at: Vec<usize> =
        (0..searches.len()).filter(|i| searches[*i].sse() <= near && has_others(&searches[*i])).collect();
    if most == 0 || at.is_empty() || !work.goes_on() {
        return;
    }
    let seed = work.seed;
    go_on(searches, &at, work, &|search| {
        let (from, evaluations) = own_looks::others(problem, search, most, seed);
        local_search(problem, search, &[], &from, &NARROW, seed);
        search.evaluations += evaluations;
    });
}

/// One round for every search.
pub(crate) fn share<'g>(
    problem: &Problem,
    searches: &mut Vec<Search>,
    effort: &Effort,
    work: &mut Work<'_>,
    thetas: &(dyn Fn(&Search) -> Vec<Parameters> + Sync),
    own: &(dyn Fn(usize) -> &'g [Parameters] + Sync),
) {
    let before: u64 = searches.iter().map(|l| l.evaluations).sum();
    let (seed, allowed) = (work.seed, work.allowed(searches.len()));
    *searches = work.all(searches.len(), |i| {
        let mut search = Search { allowed, ..searches[i].clone() };
        let thetas = thetas(&search);
        local_search(problem, &mut search, &thetas, own(i), effort, seed);
        search
    });
    work.done += searches.iter().map(|l| l.evaluations).sum::<u64>() - before;
}
