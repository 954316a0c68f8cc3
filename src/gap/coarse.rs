//! The first look: very many slip sequences, each against a bank of lags and all dead times at once, by three measures.
//!
//! By PV itself, by its differences, and by what is faster than a period: a wrong slip weighs little in the second, a
//! slow disturbance in the third. The best of each measure are kept, and the best of every size of the bands, since a
//! model that lacks an effect often prefers slips of quite another size than the right ones.
//!
//! The look sees the whole record; it only says where the fits to the training blocks begin.

use super::problem::Problem;
use super::structure::{MAX_PARAMS, Parameters, Plan};
use crate::ident::bank::{BINS, Bank, Glance, bin_edge};
use crate::ident::candidate::{MIN_SLIPS, Question, freedom};
use crate::signal::detrend::{box_means, high_pass};
use crate::sim::actuator::lag_path;
use crate::sim::slips::{FirstSlip, Sequence};

/// Sizes of s on a logarithmic scale from [`LEAST`] spans to one span.
const SIZES: usize = 90;
const LEAST: f64 = 0.02;
/// j over s, of stems that stop short of OP.
const SHARES: [f64; 7] = [0.03, 0.1, 0.2, 0.35, 0.55, 0.75, 0.95];
/// Turns of the stem below which several starts are looked at.
const FEW_REVERSALS: usize = 10;
/// Measures: PV, its differences, its fast part.
const VIEWS: usize = 3;
/// Classes of size of which the best are kept, for short and for long dead times.
const CLASSES: usize = 8;
/// Ranges of dead time that count as short.
const SHORT: usize = 3;
/// Boxes of the bank in a period, for the base and for the many looks of the effects.
pub const FINE: f64 = 32.0;
pub const ROUGH: f64 = 16.0;

/// One sequence with the process that the bank liked best.
#[derive(Debug, Clone, Copy)]
struct Seen {
    theta: Parameters,
    share: f64,
}

/// Genes worth a fit for valves of this plan (all but the process), and sequences looked at.
/// `each` are kept of every measure overall, and one of every size and kind of dead time.
#[must_use]
pub fn look(
    problem: &Problem,
    plan: &Plan,
    p: [f64; MAX_PARAMS],
    sign: f64,
    (each, per_period): (usize, f64),
) -> (Vec<Parameters>, u64) {
    let Some(law) = plan.law else { return (Vec::new(), 0) };
    let question = led(problem, plan);
    let width = problem.period.round() as usize;
    let fast = Question { pv: high_pass(&question.pv, width), ..question.clone() };
    let (mut plain_bank, mut fast_bank) = (Bank::new(&question, per_period), Bank::new(&fast, per_period));
    let points = plain_bank.points;
    let whole = question.mean.len() / points * points;
    let path = &question.path[..whole * question.per_point];
    let fast_width = (width / points).max(2);
    let mut sequence = Sequence::default();
    let mut pools: [Vec<Seen>; VIEWS] = [Vec::new(), Vec::new(), Vec::new()];
    let mut count = 0;
    let mut before: Option<([[f64; 2]; 2], FirstSlip)> = None;
    let behind = plan.follows() || plan.bend != 0.0;
    for size in 0..SIZES {
        let s = libm::pow(LEAST, 1.0 - size as f64 / (SIZES - 1) as f64);
        for share in SHARES {
            let j = share * s;
            let starts = question.starts(0.5 * (s + j), 3);
            for (which, start) in starts.into_iter().enumerate() {
                let first = question.first_slip(start);
                let same = |[sc, jc]: [[f64; 2]; 2]| sc[0] <= s && s < sc[1] && jc[0] <= j && j < jc[1];
                if before.is_some_and(|(cells, at)| at == first && same(cells)) {
                    continue;
                }
                sequence.run_in(plan.stroke, law, path, question.per_point * points, [s, j], first);
                if sequence.slips < MIN_SLIPS || (which > 0 && sequence.reversals >= FEW_REVERSALS) {
                    continue;
                }
                before = Some(([sequence.s_cell, sequence.j_cell], first));
                count += 1;
                let mut free = freedom(&sequence, [s, j], sign, question.limits, question.landing);
                if behind {
                    put_behind(plan, &mut sequence, 0.5 * (s - j), points as f64);
                    free.fd = [0.0; 2];
                }
                let at = high_pass(&sequence.at, fast_width);
                let direction = high_pass(&sequence.direction, fast_width);
                let slow = plain_bank.look(&sequence.at, &sequence.direction, &free, &[sign]);
                let quick = fast_bank.look(&at, &direction, &free, &[sign]);
                let (Some([level, moves]), Some([part, _])) = (slow.first(), quick.first()) else { continue };
                for (pool, glances) in pools.iter_mut().zip([level, moves, part]) {
                    // Short and long dead times apart: the wrong slips often go with a long one.
                    let (short, long) = glances.split_at(SHORT);
                    for glances in [short, long] {
                        let best = glances.iter().min_by(|a, b| a.share.total_cmp(&b.share));
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
        keep(pool, each, long_from, &mut out);
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
#[must_use]
pub fn led(problem: &Problem, plan: &Plan) -> Question {
    let mut question = problem.question.clone();
    if plan.positioner > 0.0 {
        let plain = &problem.question;
        question.per_point = lag_path(&plain.path, plain.per_point, plan.positioner, &mut question.path);
        question.mean = box_means(&question.path, question.per_point);
        question.records = Question::records_of(&question.path);
    }
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

/// Keeps the best `each` overall and one of every class of size, apart from each other.
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
            (o.s / g.s - 1.0).abs() < 0.04 && (o.j - g.j).abs() < 0.15 * g.s && (o.lag - g.lag).abs() < 3.0
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::Record;
    use crate::sim::slips::Law;

    fn problem() -> Problem {
        let op: Vec<f64> = (0..400).map(|k| 50.0 + 5.0 * libm::sin(f64::from(k) * 0.09)).collect();
        let pv: Vec<f64> = (0..400).map(|k| libm::sin(f64::from(k) * 0.09 - 1.0)).collect();
        Problem::new(&Record::uniform(1.0, op, pv), None, 1, vec![false; 400])
    }

    #[test]
    fn what_follows_the_stem_is_looked_at_behind_it() {
        let problem = problem();
        let first = FirstSlip { direction: 1.0, threshold: problem.question.path[0] + 0.02 };
        let run = || {
            let mut sequence = Sequence::default();
            sequence.run(Law::He, &problem.question.path, 1, 0.3, 0.1, first);
            sequence
        };
        let plain = run();
        let mut behind = run();
        let plan = Plan { play: 0.2, ..Plan::base(Some(Law::He)) };
        put_behind(&plan, &mut behind, 0.1, 1.0);
        assert!(behind.direction.iter().all(|d| *d == 0.0));
        let stem: Vec<f64> = plain.at.iter().zip(&plain.direction).map(|(at, d)| at - 0.1 * d).collect();
        let width = |x: &[f64]| {
            let late = &x[100..];
            late.iter().fold(f64::MIN, |m, v| m.max(*v)) - late.iter().fold(f64::MAX, |m, v| m.min(*v))
        };
        assert!((width(&stem) - width(&behind.at) - 0.2).abs() < 1e-9);
    }
}
