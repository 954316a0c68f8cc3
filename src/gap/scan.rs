//! The coarse scan: very many slip sequences, each against a grid of time constants and dead times, by two measures.
//!
//! By PV itself and by its differences, in which a wrong slip and a slow disturbance weigh little. The best of each
//! measure are kept, and the best of every size of the bands and of short and long dead times, since a model that lacks
//! an effect often prefers slips of quite another size than the right ones. The scan sees all points that count; it only
//! says where the fits to the training blocks begin.

use super::evaluator::{Candidate, Evaluator, Place};
use super::problem::{Problem, View};
use super::structure::{MAX_PARAMS, Parameters, Structure};
use crate::ident::candidate::{Landing, MIN_SLIPS};
use crate::ident::evaluator::lattice_index;
use crate::ident::search::{generator, uniform};
use crate::sim::slips::FirstSlip;

/// Settings of the coarse scan.
#[derive(Debug, Clone, Copy)]
pub struct Settings {
    /// Sizes of s on a logarithmic scale.
    pub sizes: usize,
    /// Shares j / s at each size.
    pub shares: usize,
    /// Candidates of each measure that are kept overall.
    pub kept: usize,
}

/// For the base, whose slips all others start from.
pub const FINE: Settings = Settings { sizes: 90, shares: 7, kept: 14 };
/// For one set of an effect's parameters.
pub const ROUGH: Settings = Settings { sizes: 40, shares: 5, kept: 6 };

/// Least s, spans of OP.
const LEAST: f64 = 0.02;
/// Turns of the stem below which several positions before the record are tried, and how many.
const FEW_REVERSALS: usize = 10;
const STARTS: usize = 3;
/// Time constants of the grid, periods, and dead times, shares of their range.
const TAUS: [f64; 5] = [0.012, 0.05, 0.15, 0.5, 2.0];
const DELAYS: [f64; 6] = [0.0, 0.06, 0.15, 0.3, 0.5, 0.8];
/// Steps from the best place of the grid, along the lattice.
const STEPS: [i32; 3] = [12, 6, 3];
/// Classes of size of which the best are kept, for short and for long dead times, and where long ones begin.
const CLASSES: usize = 8;
const LONG: f64 = 0.25;

/// Parameter vectors worth a fit, and model responses computed, for valves of this structure with parameters `p`.
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
    if plan.law.is_none() {
        return (Vec::new(), 0);
    }
    let question = &problem.question;
    let mut evaluator = Evaluator::new(problem, sign);
    let mut rng = generator(seed, 7);
    let (shift, turn) = (uniform(&mut rng), uniform(&mut rng));
    let mut pools: [Vec<Candidate>; 2] = [Vec::new(), Vec::new()];
    let mut before: Option<Candidate> = None;
    for size in 0..settings.sizes {
        let s = libm::pow(LEAST, 1.0 - (size as f64 + shift) / settings.sizes as f64);
        for share in 0..settings.shares {
            let share = (share as f64 + turn) / settings.shares as f64;
            let j = plan.landing().jump(s, share * s);
            for (which, start) in question.starts(0.5 * (s + j), STARTS).into_iter().enumerate() {
                let first = question.first_slip(start);
                let theta = blank(s, j, first, p);
                if before.is_some_and(|c| c.covers(&theta)) {
                    continue;
                }
                let Some(prepared) = evaluator.prepare(structure, &theta) else { continue };
                if prepared.slips() < MIN_SLIPS || which > 0 && prepared.reversals() >= FEW_REVERSALS {
                    continue;
                }
                for (pool, view) in pools.iter_mut().zip(View::ALL) {
                    let found = best_of_grid(&mut evaluator, structure, &prepared, view);
                    before = found.or(before);
                    pool.extend(found);
                }
            }
        }
    }
    let [least, most] = question.limits.lag;
    let mut out: Vec<Parameters> = Vec::new();
    for pool in &mut pools {
        keep(pool, settings.kept, least + LONG * (most - least), &mut out);
    }
    (out, evaluator.evaluations)
}

fn blank(s: f64, j: f64, first: FirstSlip, p: [f64; MAX_PARAMS]) -> Parameters {
    Parameters { s, j, first, fd: 0.5 * (s - j), log_tau: 0.0, lag: 0.0, p }
}

/// The best process behind a valve signal: on the grid, then by steps along the lattice.
fn best_of_grid(
    evaluator: &mut Evaluator<'_>,
    structure: &Structure,
    prepared: &super::evaluator::Prepared,
    view: View,
) -> Option<Candidate> {
    let problem = evaluator.problem;
    let limits = problem.question.limits;
    let mut best: Option<(Place, Candidate)> = None;
    let taus: &[f64] = if prepared.has_lag() { &TAUS } else { &TAUS[..1] };
    let second = evaluator.place_of(prepared).tau[1];
    for tau in taus {
        let first = lattice_index((tau * problem.period).clamp(limits.tau[0], limits.tau[1]));
        for share in DELAYS {
            let delay = (limits.lag[0] + share * (limits.lag[1] - limits.lag[0])).floor() as i32;
            let other = if prepared.has_two_lags() { second - i32::from(second == first) } else { first };
            let place = Place { tau: [first, other], delay };
            let Some(found) = evaluator.at(structure, prepared, place, view) else { continue };
            if best.is_none_or(|(_, b)| found.sse < b.sse) {
                best = Some((place, found));
            }
        }
    }
    let (place, found) = best?;
    evaluator.settle_process(structure, prepared, (place, Some(found)), view, &STEPS)
}

/// Keeps the best `each` overall and one of every class of size and kind of dead time, apart from each other.
fn keep(pool: &mut [Candidate], each: usize, long_from: f64, out: &mut Vec<Parameters>) {
    pool.sort_by(|a, b| a.sse.total_cmp(&b.sse));
    let class = |g: &Parameters| {
        let place = 1.0 - libm::log(g.s) / libm::log(LEAST);
        let size = ((place * CLASSES as f64) as usize).min(CLASSES - 1);
        2 * size + usize::from(g.lag >= long_from)
    };
    let mut held: Vec<Parameters> = Vec::new();
    let mut of_class = [0; 2 * CLASSES];
    let mut overall = 0;
    for candidate in pool.iter() {
        let g = candidate.theta;
        let near =
            |o: &Parameters| (o.s / g.s - 1.0).abs() < 0.03 && (o.j - g.j).abs() < 0.1 * g.s && (o.lag - g.lag).abs() < 3.0;
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
    use super::settle::clamped;
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
