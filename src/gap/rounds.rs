//! The rounds of a diagnosis: the base first, then every effect with the same work, then the likely ones with more of it,
//! and what each found for all that are not far behind.
//!
//! Between rounds the crew is asked whether to go on; a search that it ends early has done whole rounds only, so the
//! evaluations it reports name it. What the budget leaves is shared evenly by the lanes of a round.

use std::sync::Mutex;

use super::coarse;
use super::effects::{ALL, Clues, Effect, Start, Way};
use super::express::rms;
use super::kernel::{Kernel, Scored};
use super::plan::{Gene, MAX_PARAMS, Plan, Recipe};
use super::scene::{Scene, View};
use super::search::{Effort, Lane, MIDDLE, NARROW, SMALL, WIDE, cross, frictionless, hunt};
use super::slips::{FOLLOW, right_slips, right_slips_of_starts};
use super::types::{Crew, Stage};
use crate::ident::class::Class;
use crate::ident::residual;
use crate::sim::slips::Law;

/// Rounds in which findings are shared.
const SHARED_ROUNDS: usize = 4;
/// Places kept of each measure of the first look, for the base and for an effect's own look.
const KEPT: usize = 14;
const OWN_KEPT: usize = 6;
/// Places of the first look, of each of two measures, at which a load's own clues are read, and starts taken from each.
const PLACES: usize = 10;
const STARTS: usize = 3;
/// Relative gain in squared error below which a lane has not improved.
const NO_GAIN: f64 = 0.003;
/// Responses that a search for the base is given at least: without a base nothing can be said.
const BASE_AT_LEAST: u64 = 10_000;
/// Squared error over the best one from which an effect is out of the running, so that it does not try what others find.
const FAR_BEHIND: f64 = 9.0;
/// Searches for the right slips at most beyond the first, of the base and of the effects.
const AGAIN: u64 = 2;
/// Shares of the budget that the base has at most, and of what it leaves that the effects' own first looks have.
const OF_BASE: f64 = 0.4;
const OF_LOOKS: f64 = 0.5;
/// Responses that one such look computes, about.
const LOOK: f64 = 2_500.0;
/// Share of what the first round leaves that the search for slips of another kind has.
const OF_OTHER_SLIPS: f64 = 0.6;
/// Effects for which that is worth its while.
const LIKELY: usize = 4;
/// Responses that the search for the right slips of one effect computes, about.
const LOOK_AGAIN: u64 = 30_000;
/// Error over the floor at which a white base is the answer and the effects need only a glance.
const CALM: f64 = 1.04;

/// Work done, and who does it.
pub struct Work<'c> {
    /// The crew.
    pub crew: &'c dyn Crew,
    /// Evaluations at which the search at hand ends.
    pub budget: u64,
    /// Evaluations done.
    pub done: u64,
    /// Whether the crew ended all work.
    pub stopped: bool,
    /// Whether a search ended because its budget was spent.
    pub spent: bool,
    /// Seed.
    pub seed: u64,
    /// Evaluations at which the crew was asked last: it is asked once, for a search that is ended there by its count
    /// must end at the same round.
    pub asked: Option<u64>,
}

impl Work<'_> {
    /// Runs jobs and gives their results in order.
    pub fn all<T: Send>(&self, jobs: usize, job: impl Fn(usize) -> T + Sync) -> Vec<T> {
        let slots: Vec<Mutex<Option<T>>> = (0..jobs).map(|_| Mutex::new(None)).collect();
        self.crew.run(jobs, &|i| {
            let made = job(i);
            if let Ok(mut slot) = slots[i].lock() {
                *slot = Some(made);
            }
        });
        slots.into_iter().filter_map(|slot| slot.into_inner().ok().flatten()).collect()
    }

    /// Responses that are left of the budget.
    const fn left(&self) -> u64 {
        self.budget.saturating_sub(self.done)
    }

    /// Responses that each of so many lanes may compute, so that the budget is kept.
    fn allowed(&self, lanes: usize) -> u64 {
        self.left().div_ceil(lanes.max(1) as u64)
    }

    /// Responses that a share of what is left comes to.
    fn part(&self, share: f64) -> u64 {
        (share * self.left() as f64) as u64
    }

    /// Whether another round may begin.
    pub fn goes_on(&mut self) -> bool {
        if self.asked != Some(self.done) {
            self.stopped |= !self.crew.tick(self.done);
            self.asked = Some(self.done);
        }
        let spent = self.done >= self.budget;
        self.spent |= spent;
        !self.stopped && !spent
    }

    /// Gives another search as much as the first one had.
    pub const fn begin(&mut self, budget: u64) {
        self.budget = self.done.saturating_add(budget);
    }
}

/// All that the rounds found.
#[derive(Debug)]
pub struct Found {
    /// The base.
    pub base: Lane,
    /// Base and one effect each.
    pub lanes: Vec<Lane>,
}

/// Effects of the catalogue that are simulated against this base.
#[must_use]
pub fn simulated(linear_base: bool) -> Vec<&'static Effect> {
    let wanted = |e: &&Effect| match e.way {
        Way::Simulated => {
            !linear_base || e.id != "slip_overshoot" && e.id != "sliding_valve" && e.id != "asymmetric_stiction"
        }
        Way::AgainstLinear => linear_base,
        _ => false,
    };
    ALL.into_iter().filter(wanted).collect()
}

fn lane(recipe: Recipe, sign: f64, starts: Vec<[f64; MAX_PARAMS]>, stream: u64) -> Lane {
    Lane { recipe, sign, starts, best: Vec::new(), evaluations: 0, allowed: u64::MAX, stream: 1000 * stream }
}

/// The base, fitted, and the places of its first look; `None` where nothing in PV follows OP.
///
/// While it leaves more than noise, the search for the right slips that `analyze` makes says where to begin again, up to
/// [`AGAIN`] times with other chance: every effect starts from the base's slips.
#[must_use]
pub fn base(scene: &Scene, law: Option<Law>, floor: Option<f64>, work: &mut Work<'_>) -> Option<(Lane, Vec<Gene>)> {
    let enough = work.done.saturating_add(work.part(OF_BASE));
    let (mut base, genes) = base_once(scene, law, work)?;
    for round in 0..AGAIN {
        if law.is_none() || is_calm(scene, &base, floor) || work.done >= enough || !work.goes_on() {
            break;
        }
        let seed = work.seed.wrapping_add(round << 32);
        let looked = work.all(1, |_| right_slips(scene, &base, seed));
        let Some((places, count)) = looked.into_iter().next() else { break };
        work.done += count;
        let allowed = work.allowed(1);
        let found = work.all(1, |_| {
            let mut lane = Lane { allowed, ..base.clone() };
            hunt(scene, &mut lane, &places, &[], &NARROW, seed);
            lane
        });
        let Some(better) = found.into_iter().next() else { break };
        work.done += better.evaluations - base.evaluations;
        base = better;
    }
    Some((base, genes))
}

/// One search for the base.
fn base_once(scene: &Scene, law: Option<Law>, work: &mut Work<'_>) -> Option<(Lane, Vec<Gene>)> {
    let signs: Vec<f64> = scene.sign.map_or_else(|| vec![1.0, -1.0], |s| vec![s]);
    let seed = work.seed;
    let looked = work.all(signs.len(), |i| match law {
        Some(_) => coarse::look(scene, &Plan::base(law), [0.0; MAX_PARAMS], signs[i], (KEPT, coarse::FINE)),
        None => (frictionless(scene), 0),
    });
    work.done += looked.iter().map(|(_, n)| n).sum::<u64>();
    // Twice with other chance: the base must not lose by bad luck.
    let jobs = 2 * signs.len();
    let allowed = work.part(OF_BASE).div_ceil(jobs as u64).max(BASE_AT_LEAST);
    let lanes = work.all(jobs, |i| {
        let sign = i / 2;
        let mut lane = lane(Recipe::base(law), signs[sign], vec![[0.0; MAX_PARAMS]], 1 + i as u64);
        lane.allowed = allowed;
        if let Some((genes, _)) = looked.get(sign) {
            hunt(scene, &mut lane, genes, &[], &WIDE, seed);
        }
        lane
    });
    work.done += lanes.iter().map(|l| l.evaluations).sum::<u64>();
    let best = lanes.iter().min_by(|a, b| a.sse().total_cmp(&b.sse()))?.clone();
    if best.best.is_empty() {
        return None;
    }
    let mut base = Lane { evaluations: lanes.iter().map(|l| l.evaluations).sum(), ..best };
    for other in lanes.iter().filter(|l| l.sign == base.sign && l.stream != base.stream) {
        base.best.extend(other.best.iter().take(3).copied());
    }
    base.best.sort_by(|a, b| a.sse.total_cmp(&b.sse));
    let genes = looked.into_iter().zip(&signs).find(|(_, s)| **s == base.sign).map(|((g, _), _)| g)?;
    Some((base, genes))
}

/// Whether a lane is at the floor and leaves white noise that does not follow OP.
#[must_use]
pub fn is_calm(scene: &Scene, lane: &Lane, floor: Option<f64>) -> bool {
    let Some(left) = residual_of(scene, lane).filter(|left| reaches(scene, left, floor)) else { return false };
    let from = scene.blocks.from;
    let whiteness = residual::whiteness(&left[from..], &scene.question.mean[from..]);
    whiteness.white && !whiteness.follows_op
}

/// Whether what is left is at the floor, white or not.
fn reaches(scene: &Scene, left: &[f64], floor: Option<f64>) -> bool {
    floor.is_some_and(|floor| rms(left, &scene.train) * scene.deviation <= CALM * floor)
}

/// What a lane's best place leaves of PV at each point, deviations.
#[must_use]
pub fn residual_of(scene: &Scene, lane: &Lane) -> Option<Vec<f64>> {
    let mut kernel = Kernel::new(scene, lane.sign);
    let (prediction, _) = kernel.simulate(&lane.recipe, lane.best.first()?)?;
    Some(scene.question.pv.iter().zip(&prediction).map(|(y, p)| y - p).collect())
}

/// The starts of every effect's lane.
fn lanes_of(scene: &Scene, base: &Lane, effects: &[&'static Effect]) -> Vec<Lane> {
    let mut kernel = Kernel::new(scene, base.sign);
    let Some(best) = base.best.first() else { return Vec::new() };
    let Some((prediction, valve)) = kernel.simulate(&base.recipe, best) else { return Vec::new() };
    let own = |e: &Effect| starts_at(scene, e, best, &prediction, &valve);
    let recipe = |e: &'static Effect| Recipe::with(base.recipe.law, e);
    effects.iter().enumerate().map(|(i, e)| lane(recipe(e), base.sign, own(e), 10 + i as u64)).collect()
}

/// Base and effects, as far as the budget goes.
#[must_use]
pub fn run(
    scene: &Scene,
    base_law: Option<Law>,
    without: &[String],
    floor: Option<f64>,
    work: &mut Work<'_>,
) -> Option<Found> {
    let (mut base, genes) = base(scene, base_law, floor, work)?;
    let calm = is_calm(scene, &base, floor);
    let effects: Vec<&'static Effect> =
        simulated(base_law.is_none()).into_iter().filter(|e| !without.iter().any(|w| w == e.id)).collect();
    let mut lanes = lanes_of(scene, &base, &effects);
    // Against a base without friction nobody else looks for slips: the search for He's base is made for it.
    let sticking = lanes.iter().position(|l| l.recipe.each().any(|e| e.way == Way::AgainstLinear));
    if let (Some(at), true) = (sticking, work.goes_on())
        && let Some((found, _)) = self::base(scene, Some(Law::He), floor, work)
    {
        lanes[at] = Lane { sign: found.sign, best: found.best, evaluations: found.evaluations, ..lanes[at].clone() };
    }
    if work.goes_on() {
        let mut from = cross(core::slice::from_ref(&base), 4);
        if !calm {
            from.extend(&genes);
        }
        let seed = work.seed;
        let looking = lanes.iter().filter(|l| plans_of(l).any(|plan| looks(&plan, &l.recipe))).count();
        let each = (work.part(OF_LOOKS) as f64 / LOOK / looking.max(1) as f64).max(1.0) as usize;
        let own = work.all(lanes.len(), |i| own_look(scene, &lanes[i], &genes, if calm { 0 } else { each }, seed));
        work.done += own.iter().map(|(_, n)| n).sum::<u64>();
        let effort = if calm { &NARROW } else { &MIDDLE };
        let own = |i: usize| own.get(i).map_or(&[][..], |(genes, _)| genes);
        share(scene, &mut lanes, effort, work, &|_| from.clone(), &own);
    }
    if !calm {
        look_for_other_slips(scene, &mut lanes, floor, work);
    }
    for round in 0..SHARED_ROUNDS as u64 {
        if calm || !work.goes_on() {
            break;
        }
        let found = round < AGAIN && look_again(scene, &mut lanes, floor, round, work);
        if !cross_pollinate(scene, &mut base, &mut lanes, work) && !found {
            break;
        }
    }
    Some(Found { base, lanes })
}

/// A round in which the base and every lane that is not far behind try what the others found. Says whether one gained.
fn cross_pollinate(scene: &Scene, base: &mut Lane, lanes: &mut Vec<Lane>, work: &mut Work<'_>) -> bool {
    let best = lanes.iter().map(Lane::sse).fold(base.sse(), f64::min);
    let (near, far): (Vec<Lane>, Vec<Lane>) = lanes.drain(..).partition(|l| l.sse() <= FAR_BEHIND * best);
    let mut all = vec![base.clone()];
    all.extend(near);
    let before: Vec<f64> = all.iter().map(Lane::sse).collect();
    let genes = cross(&all, 2);
    share(scene, &mut all, &SMALL, work, &|_| genes.clone(), &|_| &[]);
    let gains = before.iter().zip(&all).any(|(b, a)| a.sse() < (1.0 - NO_GAIN) * b);
    *base = all.remove(0);
    lanes.extend(all.into_iter().chain(far));
    gains
}

/// The search for the right slips of every stem that makes others than the base can, from all of its starts: much work,
/// done where nothing explains everything yet.
fn look_for_other_slips(scene: &Scene, lanes: &mut [Lane], floor: Option<f64>, work: &mut Work<'_>) {
    let at: Vec<usize> =
        (0..lanes.len()).filter(|i| plans_of(&lanes[*i]).any(|plan| makes_other_slips(&plan))).collect();
    let responses = work.part(OF_OTHER_SLIPS) / at.len().max(1) as u64;
    let explains = |lane: &Lane| residual_of(scene, lane).is_some_and(|left| reaches(scene, &left, floor));
    if at.is_empty() || responses < FOLLOW / 2 || !work.goes_on() || lanes.iter().any(explains) {
        return;
    }
    let seed = work.seed;
    go_on(lanes, &at, work, &|lane| {
        let (genes, count) = right_slips_of_starts(scene, lane, responses, seed);
        hunt(scene, lane, &[], &genes, &MIDDLE, seed);
        lane.evaluations += count;
    });
}

/// More work for the lanes at these places. Says whether one of them gained from it.
fn go_on(lanes: &mut [Lane], at: &[usize], work: &mut Work<'_>, job: &(dyn Fn(&mut Lane) + Sync)) -> bool {
    let allowed = work.allowed(at.len());
    let made = work.all(at.len(), |i| {
        let mut lane = Lane { allowed, ..lanes[at[i]].clone() };
        job(&mut lane);
        lane
    });
    let mut gains = false;
    for (at, lane) in at.iter().zip(made) {
        let before = &mut lanes[*at];
        work.done += lane.evaluations - before.evaluations;
        gains |= lane.sse() < (1.0 - NO_GAIN) * before.sse();
        *before = lane;
    }
    gains
}

/// The plans of all starts of a lane.
fn plans_of(lane: &Lane) -> impl Iterator<Item = Plan> {
    lane.starts.iter().map(|p| lane.recipe.plan_of(p))
}

/// The search for the right slips, made for each of the most likely effects while none of them explains everything.
/// Says whether one of them gained from it.
fn look_again(scene: &Scene, lanes: &mut [Lane], floor: Option<f64>, round: u64, work: &mut Work<'_>) -> bool {
    let mut order: Vec<usize> = (0..lanes.len()).collect();
    order.sort_by(|a, b| lanes[*a].sse().total_cmp(&lanes[*b].sse()));
    order.truncate(LIKELY.min((work.left() / LOOK_AGAIN) as usize));
    if order.first().is_none_or(|best| is_calm(scene, &lanes[*best], floor)) || !work.goes_on() {
        return false;
    }
    let seed = work.seed.wrapping_add((AGAIN + round) << 32);
    go_on(lanes, &order, work, &|lane| {
        let (places, count) = right_slips(scene, lane, seed);
        hunt(scene, lane, &places, &places, &WIDE, seed);
        lane.evaluations += count;
    })
}

/// Places of the base's first look with what a load's own clues say of the residual there: the residual of the wrong
/// slips hides it. The places are the best by what is fast and by differences, where a slow load weighs little.
fn with_own_clues(scene: &Scene, lane: &Lane, genes: &[Gene]) -> (Vec<Gene>, u64) {
    let Some(effect) = lane.recipe.each().next() else { return (Vec::new(), 0) };
    let base = Recipe::base(lane.recipe.law);
    let mut kernel = Kernel::new(scene, lane.sign);
    let mut out = Vec::new();
    for view in [View::Moves, View::Fast] {
        let mut seen: Vec<_> = genes.iter().filter_map(|g| kernel.evaluate(&base, g, view)).collect();
        seen.sort_by(|a, b| a.sse.total_cmp(&b.sse));
        for place in seen.iter().take(PLACES) {
            let Some(place) = kernel.evaluate(&base, &place.gene, View::Plain) else { continue };
            let Some((prediction, valve)) = kernel.simulate(&base, &place) else { continue };
            let starts = starts_at(scene, effect, &place, &prediction, &valve);
            out.extend(starts.into_iter().take(STARTS).map(|p| Gene { p, ..place.gene }));
        }
    }
    (out, kernel.evaluations)
}

/// Where an effect's clues say that its parameters may lie, given the base's run at a place.
fn starts_at(scene: &Scene, effect: &Effect, at: &Scored, prediction: &[f64], valve: &[f64]) -> Vec<[f64; MAX_PARAMS]> {
    let residual: Vec<f64> = scene.question.pv.iter().zip(prediction).map(|(y, p)| y - p).collect();
    let low = valve.iter().copied().fold(f64::INFINITY, f64::min);
    let high = valve.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let clues = Clues { scene, residual: &residual, stem: [low, high], lag: at.gene.lag };
    let padded = |p: Start| core::array::from_fn(|i| p.get(i).copied().unwrap_or(0.0));
    (effect.starts)(&clues).into_iter().map(padded).collect()
}

/// A look of its own for an effect that makes other slips of the same OP, or whose traces the wrong slips hide; `looked`
/// are the places of the base's, `most` the starts from which is looked.
fn own_look(scene: &Scene, lane: &Lane, looked: &[Gene], most: usize, seed: u64) -> (Vec<Gene>, u64) {
    let (mut genes, mut count) = (Vec::new(), 0);
    if most == 0 {
        return (genes, count);
    }
    if lane.recipe.each().any(|e| e.stage == Stage::Disturbance) {
        return with_own_clues(scene, lane, looked);
    }
    // Evenly from all of them, where there is no time for each.
    let every = lane.starts.len().div_ceil(most);
    for (i, p) in lane.starts.iter().enumerate().step_by(every.max(1)) {
        let plan = lane.recipe.plan_of(p);
        if !looks(&plan, &lane.recipe) {
            continue;
        }
        if plan.class() != Class::First {
            // Another process is looked for by the search that knows it, once.
            let (found, n) = if i == 0 && most > 1 { right_slips(scene, lane, seed) } else { (Vec::new(), 0) };
            genes.extend(found);
            count += n;
            continue;
        }
        let (found, n) = coarse::look(scene, &plan, *p, lane.sign, (OWN_KEPT, coarse::ROUGH));
        genes.extend(found);
        count += n;
    }
    (genes, count)
}

/// Whether a stem answers OP with slips that no pair of bands gives, so that a look at the base's is of no use.
fn makes_other_slips(plan: &Plan) -> bool {
    plan.overshoot || plan.stroke.uneven != 0.0
}

/// Whether a plan makes other slips than the base, or another signal of the same slips.
fn looks(plan: &Plan, recipe: &Recipe) -> bool {
    let same_slips = plan.valve_alone() == Plan::base(recipe.law);
    recipe.law.is_some() && !makes_other_slips(plan) && (!same_slips || plan.follows() || plan.bend != 0.0)
}

/// One round for every lane.
pub fn share<'g>(
    scene: &Scene,
    lanes: &mut Vec<Lane>,
    effort: &Effort,
    work: &mut Work<'_>,
    genes: &(dyn Fn(&Lane) -> Vec<Gene> + Sync),
    own: &(dyn Fn(usize) -> &'g [Gene] + Sync),
) {
    let before: u64 = lanes.iter().map(|l| l.evaluations).sum();
    let (seed, allowed) = (work.seed, work.allowed(lanes.len()));
    let made = work.all(lanes.len(), |i| {
        let mut lane = Lane { allowed, ..lanes[i].clone() };
        let genes = genes(&lane);
        hunt(scene, &mut lane, &genes, own(i), effort, seed);
        lane
    });
    if made.len() == lanes.len() {
        *lanes = made;
    }
    work.done += lanes.iter().map(|l| l.evaluations).sum::<u64>() - before;
}
