//! The local search for one model structure: starts evaluated side by side, the best improved by random steps to
//! neighbouring cells of slip sequences, first by differences of the free run's error, then by the error itself.
//!
//! All structures get the same work; what one finds, every other one tries with its own parameters ([`exchange`]).

use rand_chacha::ChaCha8Rng;

use super::candidate::{Candidate, MAX_PARAMS, Parameters};
use super::effects::Unit;
use super::evaluator::Evaluator;
use super::plan::Plan;
use super::problem::{Problem, View};
use super::settle::{FAR, LAST, NEAR, clamped, fitted_to};
use super::structure::Structure;
use super::types::Stage;
use crate::core::ident::class::Class;
use crate::core::ident::normalised::NormalisedRecord;
use crate::core::ident::random::{moved, normal, seeded_rng, uniform};
use crate::core::sim::slips::FirstSlip;

/// Cost over the best one from which a step's process is not settled.
const HOPELESS: f64 = 1.005;
/// Candidates that a search keeps.
const KEPT: usize = 6;
/// Cells beside the best one that are asked, over each edge, and how far beyond an edge, as a share of s.
const CELLS: usize = 4;
const OVER: f64 = 1e-7;
/// Rounds of them at most.
const CELL_ROUNDS: usize = 6;
/// Rounds of parabolas along each parameter, between climbs and at the end.
const PARABOLAS: usize = 2;
const LAST_PARABOLAS: usize = 6;

/// What the search for a structure has found so far.
#[derive(Debug, Clone)]
pub struct Search {
    /// The structure.
    pub structure: Structure,
    /// Sign of the gain.
    pub sign: f64,
    /// Parameter values from which it begins.
    pub starts: Vec<[f64; MAX_PARAMS]>,
    /// The best candidates by the plain error, best first.
    pub best: Vec<Candidate>,
    /// Responses computed.
    pub evaluations: u64,
    /// Responses that its next round may compute.
    pub allowed: u64,
    /// Where its random steps are drawn from: differs with every round.
    pub stream: u64,
}

impl Search {
    /// Least squared error on the fitted blocks.
    #[must_use]
    pub(crate) fn sse(&self) -> f64 {
        self.best.first().map_or(f64::INFINITY, |b| b.sse)
    }
}

/// Starts from which is looked at first; from the others only where no effect explains the record by then.
pub(crate) const AT_FIRST: usize = 3;
/// Starts that are tried at every place which another search found.
const AT_ALL_PLACES: usize = 7;

/// How much work a round is: how many candidates and steps for each, view by view.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Effort {
    /// By differences: candidates and steps, first and later.
    pub moves: [(usize, usize); 2],
    /// By the error itself.
    pub plain: [(usize, usize); 3],
    /// Candidates from which each parameter is scanned over its range.
    pub scans: usize,
}

/// For the base.
pub(crate) const WIDE: Effort = Effort { moves: [(12, 60), (4, 160)], plain: [(14, 60), (6, 160), (3, 400)], scans: 0 };
/// For the base from other slips.
pub(crate) const MIDDLE: Effort = Effort { moves: [(8, 40), (3, 100)], plain: [(8, 50), (4, 120), (2, 240)], scans: 0 };
/// For every effect at first, and for a likely one from other slips.
pub(crate) const FIRST: Effort = Effort { moves: [(5, 30), (2, 50)], plain: [(6, 30), (2, 80), (1, 120)], scans: 1 };
/// From candidates that another search has found.
pub(crate) const NARROW: Effort = Effort { moves: [(2, 30), (1, 60)], plain: [(4, 40), (2, 100), (1, 150)], scans: 0 };
/// From what the other searches have found.
pub(crate) const SMALL: Effort = Effort { moves: [(2, 20), (1, 30)], plain: [(3, 30), (1, 60), (1, 80)], scans: 0 };

/// Evaluates all of `thetas` with all starts of a search, and `own` as they are, then improves the best; each way in which
/// the effect may act by itself, since the steps of one lead nowhere in another.
pub(crate) fn local_search(
    problem: &Problem,
    search: &mut Search,
    thetas: &[Parameters],
    own: &[Parameters],
    effort: &Effort,
    seed: u64,
) {
    search.stream += 1;
    let mut forms: Vec<Form> = Vec::new();
    let found_before = search.best.iter().map(|b| &b.theta);
    for p in search.starts.iter().chain(found_before.chain(own).map(|theta| &theta.p)) {
        let form = form_of(&search.structure, p);
        if !forms.contains(&form) {
            forms.push(form);
        }
    }
    let mut held: Vec<Candidate> = Vec::new();
    let mut firsts: Vec<Candidate> = Vec::new();
    for (i, form) in forms.iter().enumerate() {
        let mut evaluator = Evaluator::new(problem, search.sign);
        evaluator.limit = search.allowed / forms.len().max(1) as u64;
        let mut rng = seeded_rng(seed, 100 + search.stream + 500 * i as u64);
        let of_form = |p: &[f64; MAX_PARAMS]| form_of(&search.structure, p) == *form;
        let before: Vec<Candidate> = search.best.iter().filter(|b| of_form(&b.theta.p)).copied().collect();
        let mut starts = for_all_places(search);
        starts.retain(of_form);
        starts.extend(before.iter().take(2).map(|b| b.theta.p));
        let own = own.iter().filter(|theta| of_form(&theta.p));
        let with_starts = thetas.iter().flat_map(|theta| starts.iter().map(|p| Parameters { p: *p, ..*theta }));
        let from: Vec<Parameters> = with_starts.chain(own.copied()).collect();
        let found = search_form(&mut evaluator, &search.structure, &from, &before, effort, &mut rng);
        search.evaluations += evaluator.evaluations;
        firsts.extend(found.first());
        held.extend(found);
    }
    // The best of each form stays, for the rounds to come.
    search.best = apart(held, KEPT);
    for first in firsts {
        let form = form_of(&search.structure, &first.theta.p);
        if !search.best.iter().any(|b| form_of(&search.structure, &b.theta.p) == form) {
            search.best.push(first);
        }
    }
}

/// Starts whose slips are not the base's, in the order in which they are tried: some evenly from all of them, then the
/// others.
pub(crate) fn of_other_slips(search: &Search) -> [Vec<[f64; MAX_PARAMS]>; 2] {
    let every = search.starts.len().div_ceil(AT_FIRST).max(1);
    let mut parts = [Vec::new(), Vec::new()];
    for (i, p) in search.starts.iter().enumerate() {
        let plan = search.structure.plan_of(p);
        // Another process is looked for by the search that knows it, once.
        let is_again = plan.class() != Class::First && i > 0;
        if !is_again && has_own_search(&plan, &search.structure) {
            parts[usize::from(i % every != 0)].push(*p);
        }
    }
    parts
}

/// Starts that are tried at places which other searches found: all, or some evenly where the others get looks of their own.
fn for_all_places(search: &Search) -> Vec<[f64; MAX_PARAMS]> {
    let every = if has_others(search) { search.starts.len().div_ceil(AT_ALL_PLACES).max(1) } else { 1 };
    search.starts.iter().copied().step_by(every).collect()
}

/// Whether the first looks left starts out.
pub(crate) fn has_others(search: &Search) -> bool {
    let [_, others] = of_other_slips(search);
    !others.is_empty() && search.structure.each().all(|e| e.stage != Stage::Disturbance)
}

/// Whether a plan makes other slips than the base, or another signal of the same slips.
pub(crate) fn has_own_search(plan: &Plan, structure: &Structure) -> bool {
    structure.law.is_some() && plan.searchable() != Plan::base(structure.law)
}

/// Which of its alternatives an effect acts by, parameter by parameter.
pub type Form = [bool; MAX_PARAMS];

/// Which of the alternatives that a structure knows these parameters choose.
#[must_use]
pub(crate) fn form_of(structure: &Structure, p: &[f64; MAX_PARAMS]) -> Form {
    let mut form = [false; MAX_PARAMS];
    for ((slot, param), value) in form.iter_mut().zip(structure.params()).zip(p) {
        *slot = param.unit == Unit::Choice && *value > 0.5;
    }
    form
}

/// The search for one form: the best candidates, best first.
fn search_form(
    evaluator: &mut Evaluator<'_>,
    structure: &Structure,
    from: &[Parameters],
    before: &[Candidate],
    effort: &Effort,
    rng: &mut ChaCha8Rng,
) -> Vec<Candidate> {
    // The plain pass costs ten times as much.
    let plain = from.first().is_some_and(|theta| structure.plan(theta).level != 0.0);
    let share = |steps: usize| if plain { steps / 3 } else { steps };
    let mut pools: [Vec<Candidate>; 2] = [Vec::new(), Vec::new()];
    for theta in from.iter().flat_map(|theta| fitted_to(structure, *theta, evaluator.problem)) {
        for (pool, view) in pools.iter_mut().zip(View::ALL) {
            pool.extend(evaluator.fit(structure, &theta, view, &[]));
        }
    }
    let [plain, moves] = pools;
    let [(wide, few), (narrow, some)] = effort.moves;
    let chosen = of_every_size(moves, wide);
    let mut found: Vec<Candidate> =
        chosen.into_iter().filter_map(|c| evaluator.fit(structure, &c.theta, View::Moves, FAR)).collect();
    for (count, steps) in [(wide, few), (narrow, some)] {
        found = climbs(evaluator, structure, apart(found, count), View::Moves, share(steps), rng);
    }
    let mut held: Vec<Candidate> = Vec::new();
    held.extend(found.iter().filter_map(|c| evaluator.fit(structure, &c.theta, View::Plain, NEAR)));
    let chosen = of_every_size(plain, effort.plain[0].0);
    held.extend(chosen.into_iter().filter_map(|c| evaluator.fit(structure, &c.theta, View::Plain, FAR)));
    held.extend(before);
    for (round, (count, steps)) in effort.plain.into_iter().enumerate() {
        if round == 1 {
            let far = scans(evaluator, structure, &held[..effort.scans.min(held.len())], rng);
            held.extend(far);
        }
        held = climbs(evaluator, structure, apart(held.clone(), count), View::Plain, share(steps), rng)
            .into_iter()
            .chain(held)
            .collect();
        held = apart(held, KEPT.max(count));
    }
    if let Some(first) = held.first().copied() {
        let settled = settled(evaluator, structure, first);
        held.insert(0, settled);
    }
    // The coefficients of everything linear, as documents have them.
    let complete = apart(held, KEPT);
    complete.into_iter().filter_map(|c| evaluator.plain_pass(structure, &c.theta, View::Plain)).collect()
}

/// The best place by differences that steps from these lead to, with the linear part that PV itself asks for; and the
/// responses computed.
pub(crate) fn by_differences(
    problem: &Problem,
    search: &Search,
    from: &[Parameters],
    seed: u64,
) -> (Option<Candidate>, u64) {
    let mut evaluator = Evaluator::new(problem, search.sign);
    let mut rng = seeded_rng(seed, 99);
    let structure = &search.structure;
    let seen: Vec<Candidate> = from.iter().filter_map(|t| evaluator.fit(structure, t, View::Moves, &[])).collect();
    let mut found: Vec<Candidate> = of_every_size(seen, WIDE.moves[0].0)
        .into_iter()
        .filter_map(|c| evaluator.fit(structure, &c.theta, View::Moves, FAR))
        .collect();
    for (count, steps) in WIDE.moves {
        found = climbs(&mut evaluator, structure, apart(found, count), View::Moves, steps, &mut rng);
    }
    let best = apart(found, 1).into_iter().next();
    let place = best.and_then(|b| evaluator.plain_pass(structure, &b.theta, View::Plain));
    (place, evaluator.evaluations)
}

/// The best of the neighbouring cells, its parameters settled and taken off the lattice.
fn settled(evaluator: &mut Evaluator<'_>, structure: &Structure, from: Candidate) -> Candidate {
    let mut best = evaluator.settle_parameters(structure, from, View::Plain, LAST_PARABOLAS);
    best = cells(evaluator, structure, best);
    best = evaluator.settle_parameters(structure, best, View::Plain, LAST_PARABOLAS);
    evaluator.refine(structure, best)
}

/// The best of the cells of (s, j) and of the first slips beside a candidate, until none is better.
fn cells(evaluator: &mut Evaluator<'_>, structure: &Structure, from: Candidate) -> Candidate {
    let mut best = from;
    if best.slips == 0 {
        return best;
    }
    for _ in 0..CELL_ROUNDS {
        let before = best.sse;
        for [up_s, up_j] in [[1, 0], [-1, 0], [0, 1], [0, -1], [1, 1], [-1, -1], [1, -1], [-1, 1]] {
            let mut at = best;
            for _ in 0..CELLS {
                let s = over(at.cells[0], up_s, at.theta.s);
                let j = over(at.cells[1], up_j, at.theta.j);
                let (Some(s), Some(j)) = (s, j) else { break };
                let fd = at.theta.fd + 0.5 * (s - at.theta.s - j + at.theta.j);
                let theta = clamped(structure, Parameters { s, j, fd, ..at.theta }, evaluator.problem);
                let Some(next) = evaluator.fit(structure, &theta, View::Plain, &[]) else { break };
                at = next;
                best = taken(evaluator, structure, best, next);
            }
        }
        for first in nearby_starts(&evaluator.problem.normalised, best.theta.first) {
            let theta = Parameters { first, ..best.theta };
            if let Some(next) = evaluator.fit(structure, &theta, View::Plain, &[]) {
                best = taken(evaluator, structure, best, next);
            }
        }
        if before - best.sse <= 1e-6 * before {
            break;
        }
    }
    best
}

/// The better of a candidate and another one whose process is settled if that may help.
fn taken(evaluator: &mut Evaluator<'_>, structure: &Structure, best: Candidate, next: Candidate) -> Candidate {
    let mut next = next;
    if next.sse < HOPELESS * best.sse {
        next = evaluator.fit(structure, &next.theta, View::Plain, LAST).unwrap_or(next);
    }
    if next.sse < best.sse { next } else { best }
}

/// Just over an edge of a cell; `None` where it has none on that side.
fn over([low, high]: [f64; 2], up: i32, now: f64) -> Option<f64> {
    match up {
        0 => Some(now),
        1 => Some(high * (1.0 + OVER) + 1e-12).filter(|v| v.is_finite()),
        _ => Some(low * (1.0 - OVER) - 1e-12).filter(|v| *v > 0.0),
    }
}

/// First slips at the running extremes of OP beside the one at hand.
fn nearby_starts(normalised: &NormalisedRecord, first: FirstSlip) -> Vec<FirstSlip> {
    let direction = first.direction;
    let list = &normalised.extremes[usize::from(direction < 0.0)];
    let here = list.iter().take_while(|r| direction * (first.threshold - **r) >= 0.0).count();
    let at = |extreme: usize| {
        let threshold = match extreme {
            0 => list[0] - direction * 1e-9,
            r => 0.5 * (list[r - 1] + list[r]),
        };
        FirstSlip { direction, threshold }
    };
    let places =
        [here.checked_sub(1), Some(here + 1), here.checked_sub(2), Some(here + 2), here.checked_sub(4), Some(here + 4)];
    places.into_iter().flatten().filter(|r| *r < list.len()).map(at).collect()
}

/// Scans along every parameter over its whole range, climbed by differences and then by the error: what else the model
/// trades for it goes along, so that the scan stays in the valley.
fn scans(
    evaluator: &mut Evaluator<'_>,
    structure: &Structure,
    from: &[Candidate],
    rng: &mut ChaCha8Rng,
) -> Vec<Candidate> {
    /// Points along one parameter; the bands are shaken by so much at every other one, as a share: slips are right
    /// within less than a hundredth only.
    const POINTS: usize = 60;
    const SHAKEN: f64 = 0.01;
    /// Random steps from a place that was found.
    const STEPS: usize = 40;
    let mut found = Vec::new();
    for place in from {
        for (i, param) in structure.params().enumerate().filter(|(_, p)| p.unit != Unit::Choice) {
            let [low, high] = param.bounds(evaluator.problem);
            let mut seen: [Vec<Candidate>; 2] = [Vec::new(), Vec::new()];
            for k in 0..POINTS {
                let mut theta = place.theta;
                theta.p[i] = low + (high - low) * (k as f64 + 0.5) / POINTS as f64;
                let by = theta.p[i] - place.theta.p[i];
                structure.trade(&mut theta, i, by, evaluator.problem.normalised.rate);
                if k % 2 == 1 {
                    theta.s *= 1.0 + SHAKEN * normal(rng);
                }
                let theta = clamped(structure, theta, evaluator.problem);
                for (seen, view) in seen.iter_mut().zip(View::ALL) {
                    seen.extend(evaluator.fit(structure, &theta, view, LAST));
                }
            }
            for mut seen in seen {
                seen.sort_by(|a, b| a.sse.total_cmp(&b.sse));
                let far = |s: &&Candidate| (s.theta.p[i] - place.theta.p[i]).abs() > 0.02 * (high - low);
                found.extend(seen.iter().filter(far).take(1).copied());
            }
        }
    }
    let mut out = Vec::new();
    for place in found {
        let Some(seen) = evaluator.fit(structure, &place.theta, View::Moves, NEAR) else { continue };
        let climbed = climb(evaluator, structure, seen, View::Moves, STEPS, rng);
        let Some(seen) = evaluator.fit(structure, &climbed.theta, View::Plain, NEAR) else { continue };
        out.push(climb(evaluator, structure, seen, View::Plain, STEPS, rng));
    }
    out
}

/// The best half overall, the rest from all sizes of s in turn: the right size may begin badly.
pub(crate) fn of_every_size(pool: Vec<Candidate>, wanted: usize) -> Vec<Candidate> {
    let mut chosen = apart(pool.clone(), wanted / 2);
    let class = |c: &Candidate| (-2.0 * libm::log(c.theta.s.max(1e-3))).floor() as i64;
    let mut rest = apart(pool, usize::MAX);
    while chosen.len() < wanted && !rest.is_empty() {
        let mut taken: Vec<i64> = Vec::new();
        rest.retain(|c| {
            let new = chosen.len() < wanted && !taken.contains(&class(c)) && !chosen.contains(c);
            if new {
                taken.push(class(c));
                chosen.push(*c);
            }
            !new
        });
        if taken.is_empty() {
            break;
        }
    }
    chosen
}

/// The best candidates that stand apart, best first.
fn apart(mut pool: Vec<Candidate>, wanted: usize) -> Vec<Candidate> {
    pool.sort_by(|a, b| a.sse.total_cmp(&b.sse));
    let mut chosen: Vec<Candidate> = Vec::new();
    for c in pool {
        if chosen.len() == wanted {
            break;
        }
        let near = |o: &Candidate| {
            let same =
                (o.theta.s / c.theta.s - 1.0).abs() <= 0.012 && (o.theta.j - c.theta.j).abs() <= 0.05 * c.theta.s;
            let p = o.theta.p.iter().zip(&c.theta.p).all(|(a, b)| (a - b).abs() <= 0.05 * (a.abs() + b.abs()));
            (same || c.theta.s == 0.0) && p && (o.theta.lag - c.theta.lag).abs() < 1.0
        };
        if !chosen.iter().any(near) {
            chosen.push(c);
        }
    }
    chosen
}

fn climbs(
    evaluator: &mut Evaluator<'_>,
    structure: &Structure,
    from: Vec<Candidate>,
    view: View,
    steps: usize,
    rng: &mut ChaCha8Rng,
) -> Vec<Candidate> {
    from.into_iter()
        .map(|c| {
            let climbed = climb(evaluator, structure, c, view, steps, rng);
            evaluator.settle_parameters(structure, climbed, view, PARABOLAS)
        })
        .collect()
}

/// Random steps, never to a worse candidate.
fn climb(
    evaluator: &mut Evaluator<'_>,
    structure: &Structure,
    start: Candidate,
    view: View,
    steps: usize,
    rng: &mut ChaCha8Rng,
) -> Candidate {
    let mut best = start;
    for _ in 0..steps {
        let theta = clamped(structure, step(evaluator.problem, structure, &best, rng), evaluator.problem);
        let same_process = theta.lag == best.theta.lag && theta.log_tau == best.theta.log_tau;
        if same_process && best.covers(&theta) {
            continue;
        }
        let Some(prepared) = evaluator.prepare(structure, &theta) else { continue };
        let place = evaluator.place_of(&prepared);
        let Some(mut found) = evaluator.at(structure, &prepared, place, view) else { continue };
        if found.sse < HOPELESS * best.sse {
            let settled = evaluator.settle_process(structure, &prepared, (place, Some(found)), view, LAST);
            found = settled.unwrap_or(found);
        }
        if found.sse <= best.sse {
            best = found;
        }
    }
    best
}

/// Where the next random step goes.
fn step(problem: &Problem, structure: &Structure, from: &Candidate, rng: &mut ChaCha8Rng) -> Parameters {
    let normalised = &problem.normalised;
    let mut theta = from.theta;
    let has_friction = from.slips > 0;
    let params = structure.params().count();
    let kind = if has_friction { uniform(rng) } else { 1.0 };
    let heavy = |rng: &mut ChaCha8Rng| libm::pow(10.0, -2.3 * uniform(rng));
    if kind < 0.45 {
        let sigma = 0.1 * heavy(rng);
        let (s, j) = (theta.s, theta.j);
        let pick = uniform(rng);
        if pick < 0.7 {
            theta.s = moved(s, from.cells[0], sigma * s, rng);
        }
        if pick > 0.4 {
            theta.j = moved(j, from.cells[1], 4.0 * sigma * s, rng);
        }
        if uniform(rng) < 0.06 {
            theta.j *= [0.5, 2.0, 2.0 / 3.0, 1.5][(4.0 * uniform(rng)) as usize];
        }
        theta.fd += 0.5 * (theta.s - s - theta.j + j);
        if uniform(rng) < 0.15 {
            theta.lag += normal(rng);
        }
    } else if kind < 0.6 {
        // An earlier slip and a longer lag look alike.
        let more = 3.0 * uniform(rng) * normal(rng);
        let s = theta.s - more * normalised.rate;
        if uniform(rng) < 0.5 {
            theta.j = theta.j / theta.s * s;
        }
        (theta.s, theta.lag) = (s, theta.lag + more);
    } else if kind < 0.72 {
        theta.first = another_start(normalised, theta.first, rng);
        if uniform(rng) < 0.4 {
            theta.s = moved(theta.s, from.cells[0], 0.01 * theta.s, rng);
        }
    }
    let alone = kind >= 0.72;
    if params > 0 && (alone || uniform(rng) < 0.2) {
        let which = ((params as f64) * uniform(rng)) as usize;
        if let Some(param) = structure.params().nth(which).filter(|p| p.unit != Unit::Choice) {
            let [low, high] = param.bounds(problem);
            let value = &mut theta.p[which];
            if uniform(rng) < 0.08 {
                *value = low + (high - low) * uniform(rng);
            } else {
                *value += 0.25 * (high - low) * heavy(rng) * normal(rng);
            }
        }
    } else if alone {
        theta.lag += 2.0 * heavy(rng) * normal(rng) * (1.0 + 0.02 * problem.period);
        theta.log_tau += heavy(rng) * normal(rng);
    }
    theta
}

/// The first slip at a neighbouring extreme of OP, or anywhere.
fn another_start(normalised: &NormalisedRecord, first: FirstSlip, rng: &mut ChaCha8Rng) -> FirstSlip {
    let mut direction = first.direction;
    let anywhere = uniform(rng) < 0.15;
    if anywhere {
        direction = if uniform(rng) < 0.5 { 1.0 } else { -1.0 };
    }
    let list = &normalised.extremes[usize::from(direction < 0.0)];
    let here = list.iter().take_while(|r| direction * (first.threshold - **r) >= 0.0).count();
    let by = 1 + (3.0 * uniform(rng) * uniform(rng)) as usize;
    let at = if anywhere {
        (uniform(rng) * list.len() as f64) as usize
    } else {
        match uniform(rng) {
            u if u < 0.4 => here + by,
            u if u < 0.8 => here.saturating_sub(by),
            _ => here,
        }
    };
    let at = at.min(list.len() - 1);
    let threshold = match at {
        0 => list[0] - direction * 1e-9,
        r => list[r - 1] + uniform(rng) * (list[r] - list[r - 1]),
    };
    FirstSlip { direction, threshold }
}

/// Every search's best candidates, for every other search to try with its own parameters.
#[must_use]
pub(crate) fn exchange(searches: &[Search], each: usize) -> Vec<Parameters> {
    let mut out: Vec<Parameters> = Vec::new();
    for search in searches {
        for candidate in search.best.iter().take(each) {
            let theta = Parameters { p: [0.0; MAX_PARAMS], ..candidate.theta };
            let near = |o: &Parameters| {
                (o.s / theta.s - 1.0).abs() < 1e-3
                    && (o.j - theta.j).abs() < 1e-3 * theta.s
                    && (o.lag - theta.lag).abs() < 0.3
            };
            if !out.iter().any(near) {
                out.push(theta);
            }
        }
    }
    out
}
