//! The coarse scan: very many slip sequences, each against a bank of time constants and all dead times at once, by two
//! measures.
//!
//! By PV itself and by its differences, in which a wrong slip and a slow disturbance weigh little. The best of each
//! measure are kept, and the best of every size of the bands and of short and long dead times, since a model that lacks
//! an effect often prefers slips of quite another size than the right ones. The scan sees all points of its part of the
//! record; it only says where the fits to the training blocks begin.

use super::problem::Problem;
use super::settle::clamped;
use super::structure::{MAX_PARAMS, Parameters, Plan, Structure};
use crate::ident::bank::{BINS, Bank, Glance, bin_edge};
use crate::ident::candidate::{Landing, MIN_SLIPS, Question, freedom};
use crate::ident::random::{seeded_rng, uniform};
use crate::signal::detrend::box_means;
use crate::sim::actuator::lag_path;
use crate::sim::slips::{FirstSlip, Sequence};

/// Settings of the coarse scan.
#[derive(Debug, Clone, Copy)]
pub struct Settings {
    /// Sizes of s on a logarithmic scale.
    pub sizes: usize,
    /// Shares j / s at each size.
    pub shares: usize,
    /// Boxes of the bank in a period.
    pub boxes: f64,
    /// Candidates of each measure that are kept overall.
    pub kept: usize,
    /// Share of the record that is seen: a shorter one knows fewer slips and has wider cells.
    pub part: f64,
}

/// For the base, whose slips all others start from.
pub const FINE: Settings = Settings { sizes: 80, shares: 7, boxes: 24.0, kept: 14, part: 1.0 };
/// For one set of an effect's parameters.
pub const ROUGH: Settings = Settings { sizes: 30, shares: 4, boxes: 16.0, kept: 5, part: 0.7 };

/// Least s, spans of OP.
const LEAST: f64 = 0.02;
/// Turns of the stem below which several positions before the record are tried, and how many.
const FEW_REVERSALS: usize = 10;
const STARTS: usize = 3;
/// Classes of size of which the best are kept, for short and for long dead times, and ranges of dead time that count as
/// short.
const CLASSES: usize = 8;
const SHORT: usize = 3;

/// One sequence with the process that the bank liked best.
#[derive(Debug, Clone, Copy)]
struct Seen {
    theta: Parameters,
    share: f64,
}

/// Parameter vectors worth a fit (all but the process), and sequences tried, for valves of this structure with
/// parameters `p`.
#[must_use]
pub fn coarse_scan(
    problem: &Problem,
    structure: &Structure,
    p: [f64; MAX_PARAMS],
    sign: f64,
    settings: Settings,
    seed: u64,
) -> (Vec<Parameters>, u64) {
    let plan = structure.plan_of(&p);
    let Some(law) = plan.law else { return (Vec::new(), 0) };
    let question = part_of(behind_positioner(problem, &plan), settings.part);
    let mut bank = Bank::new(&question, settings.boxes);
    let whole = question.mean.len() / bank.points * bank.points;
    let path = &question.path[..whole * question.per_point];
    let per_box = question.per_point * bank.points;
    let mut rng = seeded_rng(seed, 7);
    let (shift, turn) = (uniform(&mut rng), uniform(&mut rng));
    let mut sequence = Sequence::default();
    let mut pools: [Vec<Seen>; 2] = [Vec::new(), Vec::new()];
    let mut count = 0;
    let mut before: Option<([[f64; 2]; 2], FirstSlip)> = None;
    for size in 0..settings.sizes {
        let s = libm::pow(LEAST, 1.0 - (size as f64 + shift) / settings.sizes as f64);
        for share in 0..settings.shares {
            let share = (share as f64 + turn) / settings.shares as f64;
            let j = plan.landing().jump(s, share * s);
            for (which, start) in question.starts(0.5 * (s + j), STARTS).into_iter().enumerate() {
                let first = question.first_slip(start);
                let same = |[sc, jc]: [[f64; 2]; 2]| sc[0] <= s && s < sc[1] && jc[0] <= j && j < jc[1];
                if before.is_some_and(|(cells, at)| at == first && same(cells)) {
                    continue;
                }
                sequence.run_in(plan.stroke, law, path, per_box, [s, j], first);
                if sequence.slips < MIN_SLIPS || which > 0 && sequence.reversals >= FEW_REVERSALS {
                    continue;
                }
                before = Some(([sequence.s_cell, sequence.j_cell], first));
                count += 1;
                let mut free = freedom(&sequence, [s, j], sign, question.limits, plan.landing());
                if plan.follows() || plan.bend != 0.0 {
                    put_behind(&plan, &mut sequence, 0.5 * (s - j), bank.points as f64);
                    free.fd = [0.0; 2];
                }
                let glances = bank.look(&sequence.at, &sequence.direction, &free, &[sign]);
                let Some(views) = glances.first() else { continue };
                for (pool, bins) in pools.iter_mut().zip(views) {
                    // Short and long dead times apart: the wrong slips often go with a long one.
                    let (short, long) = bins.split_at(SHORT);
                    for bins in [short, long] {
                        let best = bins.iter().min_by(|a, b| a.share.total_cmp(&b.share));
                        pool.extend(best.and_then(|g| seen(problem, [s, j, free.fd_default], first, g, p)));
                    }
                }
            }
        }
    }
    let mut out: Vec<Parameters> = Vec::new();
    let [least, most] = question.limits.lag;
    let long_from = least + bin_edge(SHORT.min(BINS)) * (most - least);
    for pool in &mut pools {
        keep(pool, settings.kept, long_from, &mut out);
    }
    (out, count)
}

/// The stem's signal behind what follows it, with this fd; no direction is left in it.
fn put_behind(plan: &Plan, sequence: &mut Sequence, fd: f64, points: f64) {
    for (at, direction) in sequence.at.iter_mut().zip(&mut sequence.direction) {
        *at -= fd * *direction;
        *direction = 0.0;
    }
    plan.follow(&mut sequence.at, points);
    sequence.at.iter_mut().for_each(|v| *v = plan.bent(*v));
}

/// The record behind the plan's positioner.
pub fn behind_positioner(problem: &Problem, plan: &Plan) -> Question {
    let mut question = problem.question.clone();
    if plan.positioner > 0.0 {
        let plain = &problem.question;
        question.per_point = lag_path(&plain.path, plain.per_point, plan.positioner, &mut question.path);
        question.mean = box_means(&question.path, question.per_point);
        question.records = Question::records_of(&question.path);
    }
    question
}

/// The first part of a record.
fn part_of(mut question: Question, part: f64) -> Question {
    let end = ((part * question.pv.len() as f64) as usize).clamp(1, question.pv.len());
    question.path.truncate(end * question.per_point);
    question.mean.truncate(end);
    question.still.truncate(end);
    question.pv.truncate(end);
    question
}

fn seen(
    problem: &Problem,
    [s, j, fd]: [f64; 3],
    first: FirstSlip,
    glance: &Glance,
    p: [f64; MAX_PARAMS],
) -> Option<Seen> {
    let limits = problem.question.limits;
    let log_tau = libm::log(glance.tau.clamp(limits.tau[0], limits.tau[1]));
    let lag = glance.lag.clamp(limits.lag[0], limits.lag[1]);
    (glance.share < 1.0).then_some(Seen { theta: Parameters { s, j, first, fd, log_tau, lag, p }, share: glance.share })
}

/// Keeps the best `each` overall and one of every class of size and kind of dead time, apart from each other.
fn keep(pool: &mut [Seen], each: usize, long_from: f64, out: &mut Vec<Parameters>) {
    pool.sort_by(|a, b| a.share.total_cmp(&b.share));
    let class = |g: &Parameters| {
        let place = 1.0 - libm::log(g.s) / libm::log(LEAST);
        let size = ((place * CLASSES as f64) as usize).min(CLASSES - 1);
        2 * size + usize::from(g.lag >= long_from)
    };
    let mut held: Vec<Parameters> = Vec::new();
    let mut of_class = [0; 2 * CLASSES];
    let mut overall = 0;
    for seen in pool.iter() {
        let g = seen.theta;
        let near = |o: &Parameters| {
            (o.s / g.s - 1.0).abs() < 0.03 && (o.j - g.j).abs() < 0.1 * g.s && (o.lag - g.lag).abs() < 3.0
        };
        if held.iter().any(near) {
            continue;
        }
        let slot = &mut of_class[class(&g)];
        if overall < each || *slot < 1 {
            *slot += 1;
            overall += 1;
            held.push(g);
        }
    }
    out.extend(held);
}

/// Starts for a model without friction: an even look at time constants and lags.
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

/// The parameter vector where its structure may stand; for a stem that may overshoot also the same way back and as far
/// beyond.
#[must_use]
pub fn fitted_to(structure: &Structure, mut theta: Parameters, problem: &Problem) -> Vec<Parameters> {
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
