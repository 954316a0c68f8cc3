//! The search for one structure: many places looked at once, the best improved by random steps to neighbouring cells of
//! slip sequences, first by differences of the free run's error, then by the error itself.
//!
//! All structures get the same work; what one finds, every other one tries with its own parameters ([`cross`]).

use rand_chacha::ChaCha8Rng;

use super::effects::Unit;
use super::evaluator::{Candidate, Evaluator};
use super::moves::clamped;
use super::problem::{Problem, View};
use super::scan::scan;
use super::structure::{MAX_PARAMS, Parameters, Structure};
use crate::ident::candidate::{Landing, Question};
use crate::ident::search::{generator, moved, normal, uniform};
use crate::sim::slips::FirstSlip;

/// Cost over the best one from which a step is not worth refining.
const HOPELESS: f64 = 2.5;
/// Random steps from a place that a look along a parameter found, of each view.
const SCAN_STEPS: usize = 40;
/// Places that a search keeps.
const KEPT: usize = 6;

/// What a structure's search has found so far.
#[derive(Debug, Clone)]
pub struct Search {
    /// The structure.
    pub structure: Structure,
    /// Sign of the gain.
    pub sign: f64,
    /// Parameter values worth a look.
    pub starts: Vec<[f64; MAX_PARAMS]>,
    /// The best places by the plain error, best first.
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
    pub fn sse(&self) -> f64 {
        self.best.first().map_or(f64::INFINITY, |b| b.sse)
    }
}

/// Genes for a base that has no friction: an even look at time constants and lags.
#[must_use]
pub fn frictionless(problem: &Problem) -> Vec<Parameters> {
    let mut out = Vec::new();
    for tau in [0.01, 0.05, 0.2, 1.0] {
        for lag in [0.01, 0.05, 0.12, 0.25] {
            out.push(Parameters {
                s: 0.0,
                j: 0.0,
                first: FirstSlip { direction: 1.0, threshold: 0.0 },
                fd: 0.0,
                log_tau: libm::log((tau * problem.period).max(0.3)),
                lag: problem.question.limits.lag[0] + lag * problem.period,
                p: [0.0; MAX_PARAMS],
            });
        }
    }
    out
}

/// How much work a round is: how many places and steps for each, view by view.
#[derive(Debug, Clone, Copy)]
pub struct Effort {
    /// By differences, then by the fast part: places and steps, first and later.
    pub views: [(usize, usize); 2],
    /// By the error itself.
    pub plain: [(usize, usize); 3],
    /// Places from which each parameter is looked along.
    pub scans: usize,
}

/// For the base, and for an effect that may be the cause.
pub const WIDE: Effort = Effort { views: [(9, 40), (3, 100)], plain: [(12, 40), (5, 120), (2, 350)], scans: 2 };
/// Every effect's first.
pub const MIDDLE: Effort = Effort { views: [(5, 30), (2, 60)], plain: [(8, 40), (3, 120), (1, 200)], scans: 2 };
/// From places that another search has found.
pub const NARROW: Effort = Effort { views: [(2, 30), (1, 60)], plain: [(4, 50), (2, 150), (1, 200)], scans: 0 };
/// From what the other searches have found.
pub const SMALL: Effort = Effort { views: [(2, 20), (1, 30)], plain: [(3, 30), (1, 100), (1, 100)], scans: 0 };

/// Looks at all thetas with all of the search's starts, and at `own` as they are, then improves the best; each way in which
/// the effect may enter by itself, since the steps of one lead nowhere in another.
pub fn hunt(
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
        let mut rng = generator(seed, 100 + search.stream + 500 * i as u64);
        let of_form = |p: &[f64; MAX_PARAMS]| form_of(&search.structure, p) == *form;
        let before: Vec<Candidate> = search.best.iter().filter(|b| of_form(&b.theta.p)).copied().collect();
        let mut starts: Vec<[f64; MAX_PARAMS]> = search.starts.iter().copied().filter(of_form).collect();
        starts.extend(before.iter().take(2).map(|b| b.theta.p));
        let own = own.iter().filter(|theta| of_form(&theta.p));
        let with_starts = thetas.iter().flat_map(|theta| starts.iter().map(|p| Parameters { p: *p, ..*theta }));
        let from: Vec<Parameters> = with_starts.chain(own.copied()).collect();
        let found = hunt_form(&mut evaluator, &search.structure, &from, &before, effort, &mut rng);
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

/// Which of its alternatives an effect enters by, parameter by parameter.
pub type Form = [bool; MAX_PARAMS];

/// Which of the alternatives that a structure knows these parameters choose.
#[must_use]
pub fn form_of(structure: &Structure, p: &[f64; MAX_PARAMS]) -> Form {
    let mut form = [false; MAX_PARAMS];
    for ((slot, param), value) in form.iter_mut().zip(structure.params()).zip(p) {
        *slot = param.unit == Unit::Choice && *value > 0.5;
    }
    form
}

/// The search for one form: the best places, best first.
fn hunt_form(
    evaluator: &mut Evaluator<'_>,
    structure: &Structure,
    from: &[Parameters],
    before: &[Candidate],
    effort: &Effort,
    rng: &mut ChaCha8Rng,
) -> Vec<Candidate> {
    let mut pools: [Vec<Candidate>; 3] = [Vec::new(), Vec::new(), Vec::new()];
    for theta in from.iter().flat_map(|theta| fitted_to(structure, *theta, evaluator.problem)) {
        for (pool, view) in pools.iter_mut().zip(View::ALL) {
            pool.extend(evaluator.evaluate(structure, &theta, view));
        }
    }
    let [plain, moves, fast] = pools;
    let mut held: Vec<Candidate> = Vec::new();
    let [(wide, few), (narrow, some)] = effort.views;
    for (pool, view) in [(moves, View::Moves), (fast, View::Fast)] {
        let chosen = of_every_size(pool, wide);
        let mut found: Vec<Candidate> = chosen.into_iter().map(|c| evaluator.improve(structure, c, view, 3)).collect();
        for (count, steps) in [(wide, few), (narrow, some)] {
            found = climbs(evaluator, structure, apart(found, count), view, steps, rng);
        }
        held.extend(found.iter().filter_map(|c| evaluator.evaluate(structure, &c.theta, View::Plain)));
    }
    held.extend(of_every_size(plain, effort.plain[0].0));
    held = held.into_iter().map(|c| evaluator.improve(structure, c, View::Plain, 3)).collect();
    held.extend(before);
    for (round, (count, steps)) in effort.plain.into_iter().enumerate() {
        if round == 1 {
            let far = scans(evaluator, structure, &held[..effort.scans.min(held.len())], rng);
            held.extend(far);
        }
        held = climbs(evaluator, structure, apart(held.clone(), count), View::Plain, steps, rng)
            .into_iter()
            .chain(held)
            .collect();
        held = apart(held, KEPT.max(count));
    }
    if let Some(first) = held.first().copied() {
        let settled = settle(evaluator, structure, first);
        held.insert(0, settled);
    }
    apart(held, KEPT)
}

/// Places from looks along every parameter, climbed by differences and then by the error.
fn scans(
    evaluator: &mut Evaluator<'_>,
    structure: &Structure,
    from: &[Candidate],
    rng: &mut ChaCha8Rng,
) -> Vec<Candidate> {
    let thetas: Vec<Parameters> = from.iter().flat_map(|place| scan(evaluator, structure, place, rng)).collect();
    let mut out = Vec::new();
    for theta in thetas {
        let Some(seen) = evaluator.evaluate(structure, &theta, View::Moves) else { continue };
        let seen = evaluator.improve(structure, seen, View::Moves, 2);
        let climbed = climb(evaluator, structure, seen, View::Moves, SCAN_STEPS, rng);
        let Some(seen) = evaluator.evaluate(structure, &climbed.theta, View::Plain) else { continue };
        let seen = evaluator.improve(structure, seen, View::Plain, 3);
        out.push(climb(evaluator, structure, seen, View::Plain, SCAN_STEPS, rng));
    }
    out
}

/// The best half overall, the rest from all sizes of s in turn: the right size may begin badly.
fn of_every_size(pool: Vec<Candidate>, wanted: usize) -> Vec<Candidate> {
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

/// A theta moved to where its structure may stand; for a stem that may overshoot also the same way back and as far beyond.
fn fitted_to(structure: &Structure, mut theta: Parameters, problem: &Problem) -> Vec<Parameters> {
    if structure.plan(&theta).landing() == Landing::Beyond {
        // The base is among its models: it must never do worse.
        let mut out = vec![clamped(structure, theta, problem)];
        if theta.j < theta.s {
            // The slips stay: fd turns.
            theta.j = theta.s * (1.0 + 0.5 * (1.0 - theta.j / theta.s.max(1e-9)));
            theta.fd = 0.5 * (theta.s - theta.j);
            out.push(clamped(structure, theta, problem));
        }
        return out;
    }
    if theta.j > theta.s {
        theta.j = theta.s;
        theta.fd = 0.0;
    }
    vec![clamped(structure, theta, problem)]
}

/// The best places that stand apart, best first.
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
    from.into_iter().map(|c| climb(evaluator, structure, c, view, steps, rng)).collect()
}

/// Random steps, never to a worse place.
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
        let Some(mut found) = evaluator.evaluate(structure, &theta, view) else { continue };
        if found.sse < HOPELESS * best.sse {
            found = evaluator.improve_fresh(structure, found, view);
        }
        if found.sse <= best.sse {
            best = found;
        }
    }
    best
}

/// Gauss-Newton until nothing helps any more, the lag hopping over the kinks at whole points.
fn settle(evaluator: &mut Evaluator<'_>, structure: &Structure, from: Candidate) -> Candidate {
    let mut best = evaluator.improve(structure, from, View::Plain, 10);
    for _ in 0..3 {
        let before = best.sse;
        for hop in [-0.6, 0.6, -1.4, 1.4, -3.0, 3.0] {
            let theta = clamped(structure, Parameters { lag: best.theta.lag + hop, ..best.theta }, evaluator.problem);
            if let Some(found) = evaluator.evaluate(structure, &theta, View::Plain).filter(|f| f.sse < 1.3 * best.sse) {
                let found = evaluator.improve(structure, found, View::Plain, 5);
                if found.sse < best.sse {
                    best = found;
                }
            }
        }
        if before - best.sse <= 1e-4 * before {
            break;
        }
    }
    best
}

/// Where the next random step goes.
fn step(problem: &Problem, structure: &Structure, from: &Candidate, rng: &mut ChaCha8Rng) -> Parameters {
    let question = &problem.question;
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
        let s = theta.s - more * question.rate;
        if uniform(rng) < 0.5 {
            theta.j = theta.j / theta.s * s;
        }
        (theta.s, theta.lag) = (s, theta.lag + more);
    } else if kind < 0.72 {
        theta.first = another_start(question, theta.first, rng);
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

/// The first slip at a neighbouring record of OP, or anywhere.
fn another_start(question: &Question, first: FirstSlip, rng: &mut ChaCha8Rng) -> FirstSlip {
    let mut direction = first.direction;
    let anywhere = uniform(rng) < 0.15;
    if anywhere {
        direction = if uniform(rng) < 0.5 { 1.0 } else { -1.0 };
    }
    let list = &question.records[usize::from(direction < 0.0)];
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

/// Every search's best places, for every other search to try with its own parameters.
#[must_use]
pub fn cross(searches: &[Search], each: usize) -> Vec<Parameters> {
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
