//! The next test: the smallest bump of OP that tells the two likeliest answers apart, found by simulating both.

use std::sync::Arc;

use super::candidate::{Candidate, Linear};
use super::decide::Decision;
use super::effects;
use super::enough::EnoughNote;
use super::judged::Findings;
use super::plain::PlainPass;
use super::problem::Problem;
use super::schedule::Found;
use super::search::Search;
use super::types::{NONE, NextTest, Stage, UNKNOWN};
use crate::core::guard;
use crate::core::signal::stats;
use crate::core::sim::slips::FirstSlip;
use crate::core::sim::steps::Path;

/// Probability that is asked for.
const WANTED: f64 = 0.95;
/// Sizes that are tried, in bands s (or tenths of the span where nothing sticks).
const SIZES: [f64; 8] = [1.1, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0];
/// Holds of a test: OP up, back, down, back.
const HOLDS: f64 = 4.0;
/// Largest bump that is proposed, spans of OP in the record.
const MOST: f64 = 2.0;
/// Least probability of both answers together: where something else is likelier, telling them apart settles nothing.
const LIKELY: f64 = 0.5;
/// Least probability of the second: below it there is nothing to tell apart.
const RIVAL: f64 = 0.05;

/// The two likeliest answers beside "something else", where a bump of OP may tell them apart: one of them at least acts in
/// the plant, as what comes from outside does not come back with the bump.
fn contenders<'a>(answers: impl Iterator<Item = (&'a str, f64)>) -> Option<[&'a str; 2]> {
    let mut all: Vec<(&str, f64)> = answers.filter(|(id, _)| *id != UNKNOWN).collect();
    all.sort_by(|a, b| b.1.total_cmp(&a.1));
    let [(first, p), (second, q), ..] = all[..] else { return None };
    let in_plant = |id: &str| {
        let mut parts = effects::parts(id).filter_map(effects::by_id);
        parts.any(|e| matches!(e.stage, Stage::Valve | Stage::Process))
    };
    (p + q >= LIKELY && q >= RIVAL && (in_plant(first) || in_plant(second))).then_some([first, second])
}

/// The test for the two likeliest answers; `None` where either cannot be simulated, where no bump tells them apart, where the
/// base is worse than PV's mean or good enough, and where the guard of bump tests forbids it.
#[must_use]
pub(super) fn next_test(
    problem: &Problem,
    found: &Found,
    findings: &Findings,
    decision: &Decision,
) -> Option<NextTest> {
    let deviation = problem.normalised.deviation;
    let floor = findings.floor.noise_floor.map(|floor| floor / deviation);
    if findings.relative_gap > 1.0 || EnoughNote::of(findings.relative_gap, floor).is_some() {
        return None;
    }
    let others = decision.alternatives.iter().map(|a| (a.id.as_str(), a.probability));
    let cause = (decision.cause.id.as_str(), decision.cause.probability);
    let [name, rival] = contenders(core::iter::once(cause).chain(others))?;
    let search_of = |id: &str| match found.searches.iter().find(|l| l.structure.id_in(problem) == id) {
        None if id == NONE => Some(&found.base),
        search => search,
    };
    let (first, second) = (search_of(name)?, search_of(rival)?);
    let best = first.best.first()?;
    let settles = best.theta.lag + 3.0 * libm::exp(best.theta.log_tau).min(problem.period);
    let hold = settles.ceil() as usize + 2;
    let duration_s = hold as f64 * problem.point_s;
    let pv_span = stats::span(&problem.normalised.pv);
    let unit = if best.theta.s > 0.0 { best.theta.s } else { 0.1 };
    // What the base leaves of PV is there in the test, too.
    let left = findings.base.rmse / deviation;
    let hidden = guard::hidden_below(left * left, hold as f64 / 3.0);
    for size in SIZES.map(|s| s * unit).into_iter().filter(|size| *size <= MOST) {
        let answers = [first, second].map(|search| answer(problem, search, size, hold));
        let [Some(a), Some(b)] = answers else { continue };
        let most = |x: &[f64]| x.iter().fold(0.0_f64, |most, x| most.max(x.abs()));
        let travel = most(&a).max(most(&b));
        if guard::excess(travel, pv_span, HOLDS * duration_s).is_some() {
            return None;
        }
        let apart: Vec<f64> = a.iter().zip(&b).map(|(x, y)| x - y).collect();
        // The better of two known courses (matched filter), of as many points as count as independent.
        let counted = apart.len().min((HOLDS * guard::INDEPENDENT) as usize) as f64 / apart.len().max(1) as f64;
        let p = normal_below(0.5 * (counted * stats::dot(&apart, &apart)).sqrt() / left.max(1e-12));
        if p >= WANTED && most(&apart) > hidden {
            return Some(NextTest {
                signal: "op".to_owned(),
                size: size * problem.normalised.span,
                duration_s,
                separates: [name.to_owned(), rival.to_owned()],
                p,
                total_s: HOLDS * duration_s,
                moves_pv: travel * deviation,
            });
        }
    }
    None
}

/// PV's answer to OP up, back, down and back, `hold` points each, from rest with the stem in the middle of its band.
fn answer(problem: &Problem, search: &Search, size: f64, hold: usize) -> Option<Vec<f64>> {
    let best = search.best.first()?;
    let mut test = problem.clone();
    let lead = problem.blocks.from.max(1);
    let mut op = vec![0.0; lead];
    for level in [size, 0.0, -size, 0.0] {
        op.extend(core::iter::repeat_n(level, hold));
    }
    test.normalised.pv = vec![0.0; op.len()];
    test.normalised.path = Arc::new(Path::new(op, 1));
    let fs = 0.5 * (best.theta.s + best.theta.j);
    let plan = search.structure.plan(&best.theta);
    let mut place: Candidate = *best;
    place.theta.first = FirstSlip { direction: 1.0, threshold: fs };
    // Loads and the record's own start have no part in the test.
    let own = usize::from(plan.zero);
    let Linear { others, count, .. } = &mut place.linear;
    others[..count.saturating_sub(own)].fill(0.0);
    let (course, _) = PlainPass::new(&test, search.sign).simulate(&search.structure, &place)?;
    let rest = course[lead - 1];
    Some(course[lead..].iter().map(|x| x - rest).collect())
}

/// The normal distribution's share below `x`.
fn normal_below(x: f64) -> f64 {
    0.5 * libm::erfc(-x * core::f64::consts::FRAC_1_SQRT_2)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_likeliest_two_are_separated_and_no_others() {
        let said = |all: &[(&'static str, f64)]| contenders(all.iter().copied());
        assert_eq!(
            said(&[("unknown", 0.3), ("extra_lag", 0.2), ("static_nonlinearity", 0.4)]),
            Some(["static_nonlinearity", "extra_lag"])
        );
        assert_eq!(said(&[("extra_lag", 0.6), ("none", 0.3)]), Some(["extra_lag", "none"]));
        // What comes from outside does not come back with a bump of OP.
        assert_eq!(said(&[("sinusoid", 0.6), ("none", 0.3)]), None);
        assert_eq!(said(&[("step_load", 0.6), ("ramp", 0.3)]), None);
        assert_eq!(said(&[("unknown", 0.7), ("extra_lag", 0.2), ("backlash", 0.1)]), None);
        assert_eq!(said(&[("extra_lag", 0.97), ("backlash", 0.02)]), None);
    }
}
