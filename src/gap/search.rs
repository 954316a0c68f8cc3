//! The search for one recipe: many places looked at once, the best improved by random steps to neighbouring cells of
//! slip sequences, first by differences of the free run's error, then by the error itself.
//!
//! All recipes get the same work; what one finds, every other one tries with its own parameters ([`cross`]).

use rand_chacha::ChaCha8Rng;

use super::effects::Unit;
use super::kernel::{Kernel, Scored};
use super::moves::clamped;
use super::plan::{Gene, MAX_PARAMS, Recipe};
use super::scan::scan;
use super::scene::{Scene, View};
use crate::ident::candidate::{Landing, Question};
use crate::ident::search::{generator, moved, normal, uniform};
use crate::sim::slips::FirstSlip;

/// Cost over the best one from which a step is not worth refining.
const HOPELESS: f64 = 2.5;
/// Random steps from a place that a look along a parameter found, of each view.
const SCAN_STEPS: usize = 40;
/// Places that a lane keeps.
const KEPT: usize = 6;

/// What a recipe's search has found so far.
#[derive(Debug, Clone)]
pub struct Lane {
    /// The recipe.
    pub recipe: Recipe,
    /// Sign of the gain.
    pub sign: f64,
    /// Parameter values worth a look.
    pub starts: Vec<[f64; MAX_PARAMS]>,
    /// The best places by the plain error, best first.
    pub best: Vec<Scored>,
    /// Responses computed.
    pub evaluations: u64,
    /// Responses that its next round may compute.
    pub allowed: u64,
    /// Where its random steps are drawn from: differs with every round.
    pub stream: u64,
}

impl Lane {
    /// Least squared error on the fitted blocks.
    #[must_use]
    pub fn sse(&self) -> f64 {
        self.best.first().map_or(f64::INFINITY, |b| b.sse)
    }
}

/// Genes for a base that has no friction: an even look at time constants and lags.
#[must_use]
pub fn frictionless(scene: &Scene) -> Vec<Gene> {
    let mut out = Vec::new();
    for tau in [0.01, 0.05, 0.2, 1.0] {
        for lag in [0.01, 0.05, 0.12, 0.25] {
            out.push(Gene {
                s: 0.0,
                j: 0.0,
                first: FirstSlip { direction: 1.0, threshold: 0.0 },
                fd: 0.0,
                log_tau: libm::log((tau * scene.period).max(0.3)),
                lag: scene.question.limits.lag[0] + lag * scene.period,
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
/// From what the other lanes have found.
pub const SMALL: Effort = Effort { views: [(2, 20), (1, 30)], plain: [(3, 30), (1, 100), (1, 100)], scans: 0 };

/// Looks at all genes with all of the lane's starts, and at `own` as they are, then improves the best; each way in which
/// the effect may enter by itself, since the steps of one lead nowhere in another.
pub fn hunt(scene: &Scene, lane: &mut Lane, genes: &[Gene], own: &[Gene], effort: &Effort, seed: u64) {
    lane.stream += 1;
    let mut forms: Vec<Form> = Vec::new();
    let found_before = lane.best.iter().map(|b| &b.gene);
    for p in lane.starts.iter().chain(found_before.chain(own).map(|gene| &gene.p)) {
        let form = form_of(&lane.recipe, p);
        if !forms.contains(&form) {
            forms.push(form);
        }
    }
    let mut held: Vec<Scored> = Vec::new();
    let mut firsts: Vec<Scored> = Vec::new();
    for (i, form) in forms.iter().enumerate() {
        let mut kernel = Kernel::new(scene, lane.sign);
        kernel.limit = lane.allowed / forms.len().max(1) as u64;
        let mut rng = generator(seed, 100 + lane.stream + 500 * i as u64);
        let of_form = |p: &[f64; MAX_PARAMS]| form_of(&lane.recipe, p) == *form;
        let before: Vec<Scored> = lane.best.iter().filter(|b| of_form(&b.gene.p)).copied().collect();
        let mut starts: Vec<[f64; MAX_PARAMS]> = lane.starts.iter().copied().filter(of_form).collect();
        starts.extend(before.iter().take(2).map(|b| b.gene.p));
        let own = own.iter().filter(|gene| of_form(&gene.p));
        let with_starts = genes.iter().flat_map(|gene| starts.iter().map(|p| Gene { p: *p, ..*gene }));
        let from: Vec<Gene> = with_starts.chain(own.copied()).collect();
        let found = hunt_form(&mut kernel, &lane.recipe, &from, &before, effort, &mut rng);
        lane.evaluations += kernel.evaluations;
        firsts.extend(found.first());
        held.extend(found);
    }
    // The best of each form stays, for the rounds to come.
    lane.best = apart(held, KEPT);
    for first in firsts {
        let form = form_of(&lane.recipe, &first.gene.p);
        if !lane.best.iter().any(|b| form_of(&lane.recipe, &b.gene.p) == form) {
            lane.best.push(first);
        }
    }
}

/// Which of its alternatives an effect enters by, parameter by parameter.
pub type Form = [bool; MAX_PARAMS];

/// Which of the alternatives that a recipe knows these parameters choose.
#[must_use]
pub fn form_of(recipe: &Recipe, p: &[f64; MAX_PARAMS]) -> Form {
    let mut form = [false; MAX_PARAMS];
    for ((slot, param), value) in form.iter_mut().zip(recipe.params()).zip(p) {
        *slot = param.unit == Unit::Choice && *value > 0.5;
    }
    form
}

/// The search for one form: the best places, best first.
fn hunt_form(
    kernel: &mut Kernel<'_>,
    recipe: &Recipe,
    from: &[Gene],
    before: &[Scored],
    effort: &Effort,
    rng: &mut ChaCha8Rng,
) -> Vec<Scored> {
    let mut pools: [Vec<Scored>; 3] = [Vec::new(), Vec::new(), Vec::new()];
    for gene in from.iter().flat_map(|gene| fitted_to(recipe, *gene, kernel.scene)) {
        for (pool, view) in pools.iter_mut().zip(View::ALL) {
            pool.extend(kernel.evaluate(recipe, &gene, view));
        }
    }
    let [plain, moves, fast] = pools;
    let mut held: Vec<Scored> = Vec::new();
    let [(wide, few), (narrow, some)] = effort.views;
    for (pool, view) in [(moves, View::Moves), (fast, View::Fast)] {
        let chosen = of_every_size(pool, wide);
        let mut found: Vec<Scored> = chosen.into_iter().map(|c| kernel.improve(recipe, c, view, 3)).collect();
        for (count, steps) in [(wide, few), (narrow, some)] {
            found = climbs(kernel, recipe, apart(found, count), view, steps, rng);
        }
        held.extend(found.iter().filter_map(|c| kernel.evaluate(recipe, &c.gene, View::Plain)));
    }
    held.extend(of_every_size(plain, effort.plain[0].0));
    held = held.into_iter().map(|c| kernel.improve(recipe, c, View::Plain, 3)).collect();
    held.extend(before);
    for (round, (count, steps)) in effort.plain.into_iter().enumerate() {
        if round == 1 {
            let far = scans(kernel, recipe, &held[..effort.scans.min(held.len())], rng);
            held.extend(far);
        }
        held = climbs(kernel, recipe, apart(held.clone(), count), View::Plain, steps, rng)
            .into_iter()
            .chain(held)
            .collect();
        held = apart(held, KEPT.max(count));
    }
    if let Some(first) = held.first().copied() {
        let settled = settle(kernel, recipe, first);
        held.insert(0, settled);
    }
    apart(held, KEPT)
}

/// Places from looks along every parameter, climbed by differences and then by the error.
fn scans(kernel: &mut Kernel<'_>, recipe: &Recipe, from: &[Scored], rng: &mut ChaCha8Rng) -> Vec<Scored> {
    let genes: Vec<Gene> = from.iter().flat_map(|place| scan(kernel, recipe, place, rng)).collect();
    let mut out = Vec::new();
    for gene in genes {
        let Some(seen) = kernel.evaluate(recipe, &gene, View::Moves) else { continue };
        let seen = kernel.improve(recipe, seen, View::Moves, 2);
        let climbed = climb(kernel, recipe, seen, View::Moves, SCAN_STEPS, rng);
        let Some(seen) = kernel.evaluate(recipe, &climbed.gene, View::Plain) else { continue };
        let seen = kernel.improve(recipe, seen, View::Plain, 3);
        out.push(climb(kernel, recipe, seen, View::Plain, SCAN_STEPS, rng));
    }
    out
}

/// The best half overall, the rest from all sizes of s in turn: the right size may begin badly.
fn of_every_size(pool: Vec<Scored>, wanted: usize) -> Vec<Scored> {
    let mut chosen = apart(pool.clone(), wanted / 2);
    let class = |c: &Scored| (-2.0 * libm::log(c.gene.s.max(1e-3))).floor() as i64;
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

/// A gene moved to where its recipe may stand; for a stem that may overshoot also the same way back and as far beyond.
fn fitted_to(recipe: &Recipe, mut gene: Gene, scene: &Scene) -> Vec<Gene> {
    if recipe.plan(&gene).landing() == Landing::Beyond {
        // The base is among its models: it must never do worse.
        let mut out = vec![clamped(recipe, gene, scene)];
        if gene.j < gene.s {
            // The slips stay: fd turns.
            gene.j = gene.s * (1.0 + 0.5 * (1.0 - gene.j / gene.s.max(1e-9)));
            gene.fd = 0.5 * (gene.s - gene.j);
            out.push(clamped(recipe, gene, scene));
        }
        return out;
    }
    if gene.j > gene.s {
        gene.j = gene.s;
        gene.fd = 0.0;
    }
    vec![clamped(recipe, gene, scene)]
}

/// The best places that stand apart, best first.
fn apart(mut pool: Vec<Scored>, wanted: usize) -> Vec<Scored> {
    pool.sort_by(|a, b| a.sse.total_cmp(&b.sse));
    let mut chosen: Vec<Scored> = Vec::new();
    for c in pool {
        if chosen.len() == wanted {
            break;
        }
        let near = |o: &Scored| {
            let same = (o.gene.s / c.gene.s - 1.0).abs() <= 0.012 && (o.gene.j - c.gene.j).abs() <= 0.05 * c.gene.s;
            let p = o.gene.p.iter().zip(&c.gene.p).all(|(a, b)| (a - b).abs() <= 0.05 * (a.abs() + b.abs()));
            (same || c.gene.s == 0.0) && p && (o.gene.lag - c.gene.lag).abs() < 1.0
        };
        if !chosen.iter().any(near) {
            chosen.push(c);
        }
    }
    chosen
}

fn climbs(
    kernel: &mut Kernel<'_>,
    recipe: &Recipe,
    from: Vec<Scored>,
    view: View,
    steps: usize,
    rng: &mut ChaCha8Rng,
) -> Vec<Scored> {
    from.into_iter().map(|c| climb(kernel, recipe, c, view, steps, rng)).collect()
}

/// Random steps, never to a worse place.
fn climb(
    kernel: &mut Kernel<'_>,
    recipe: &Recipe,
    start: Scored,
    view: View,
    steps: usize,
    rng: &mut ChaCha8Rng,
) -> Scored {
    let mut best = start;
    for _ in 0..steps {
        let gene = clamped(recipe, step(kernel.scene, recipe, &best, rng), kernel.scene);
        let same_process = gene.lag == best.gene.lag && gene.log_tau == best.gene.log_tau;
        if same_process && best.covers(&gene) {
            continue;
        }
        let Some(mut found) = kernel.evaluate(recipe, &gene, view) else { continue };
        if found.sse < HOPELESS * best.sse {
            found = kernel.improve_fresh(recipe, found, view);
        }
        if found.sse <= best.sse {
            best = found;
        }
    }
    best
}

/// Gauss-Newton until nothing helps any more, the lag hopping over the kinks at whole points.
fn settle(kernel: &mut Kernel<'_>, recipe: &Recipe, from: Scored) -> Scored {
    let mut best = kernel.improve(recipe, from, View::Plain, 10);
    for _ in 0..3 {
        let before = best.sse;
        for hop in [-0.6, 0.6, -1.4, 1.4, -3.0, 3.0] {
            let gene = clamped(recipe, Gene { lag: best.gene.lag + hop, ..best.gene }, kernel.scene);
            if let Some(found) = kernel.evaluate(recipe, &gene, View::Plain).filter(|f| f.sse < 1.3 * best.sse) {
                let found = kernel.improve(recipe, found, View::Plain, 5);
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
fn step(scene: &Scene, recipe: &Recipe, from: &Scored, rng: &mut ChaCha8Rng) -> Gene {
    let question = &scene.question;
    let mut gene = from.gene;
    let has_friction = from.slips > 0;
    let params = recipe.params().count();
    let kind = if has_friction { uniform(rng) } else { 1.0 };
    let heavy = |rng: &mut ChaCha8Rng| libm::pow(10.0, -2.3 * uniform(rng));
    if kind < 0.45 {
        let sigma = 0.1 * heavy(rng);
        let (s, j) = (gene.s, gene.j);
        let pick = uniform(rng);
        if pick < 0.7 {
            gene.s = moved(s, from.cells[0], sigma * s, rng);
        }
        if pick > 0.4 {
            gene.j = moved(j, from.cells[1], 4.0 * sigma * s, rng);
        }
        if uniform(rng) < 0.06 {
            gene.j *= [0.5, 2.0, 2.0 / 3.0, 1.5][(4.0 * uniform(rng)) as usize];
        }
        gene.fd += 0.5 * (gene.s - s - gene.j + j);
        if uniform(rng) < 0.15 {
            gene.lag += normal(rng);
        }
    } else if kind < 0.6 {
        // An earlier slip and a longer lag look alike.
        let more = 3.0 * uniform(rng) * normal(rng);
        let s = gene.s - more * question.rate;
        if uniform(rng) < 0.5 {
            gene.j = gene.j / gene.s * s;
        }
        (gene.s, gene.lag) = (s, gene.lag + more);
    } else if kind < 0.72 {
        gene.first = another_start(question, gene.first, rng);
        if uniform(rng) < 0.4 {
            gene.s = moved(gene.s, from.cells[0], 0.01 * gene.s, rng);
        }
    }
    let alone = kind >= 0.72;
    if params > 0 && (alone || uniform(rng) < 0.2) {
        let which = ((params as f64) * uniform(rng)) as usize;
        if let Some(param) = recipe.params().nth(which).filter(|p| p.unit != Unit::Choice) {
            let [low, high] = param.bounds(scene);
            let value = &mut gene.p[which];
            if uniform(rng) < 0.08 {
                *value = low + (high - low) * uniform(rng);
            } else {
                *value += 0.25 * (high - low) * heavy(rng) * normal(rng);
            }
        }
    } else if alone {
        gene.lag += 2.0 * heavy(rng) * normal(rng) * (1.0 + 0.02 * scene.period);
        gene.log_tau += heavy(rng) * normal(rng);
    }
    gene
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

/// Every lane's best places, for every other lane to try with its own parameters.
#[must_use]
pub fn cross(lanes: &[Lane], each: usize) -> Vec<Gene> {
    let mut out: Vec<Gene> = Vec::new();
    for lane in lanes {
        for scored in lane.best.iter().take(each) {
            let gene = Gene { p: [0.0; MAX_PARAMS], ..scored.gene };
            let near = |o: &Gene| {
                (o.s / gene.s - 1.0).abs() < 1e-3
                    && (o.j - gene.j).abs() < 1e-3 * gene.s
                    && (o.lag - gene.lag).abs() < 0.3
            };
            if !out.iter().any(near) {
                out.push(gene);
            }
        }
    }
    out
}
