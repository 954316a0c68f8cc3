//! The next test: the smallest bump of OP that tells the two best answers apart, found by simulating both.

use std::sync::Arc;

use super::candidate::{Candidate, Linear};
use super::decide::Decision;
use super::judged::Findings;
use super::plain::PlainPass;
use super::problem::Problem;
use super::schedule::Found;
use super::search::Search;
use super::types::{NONE, NextTest, UNKNOWN};
use crate::guard;
use crate::signal::stats;
use crate::sim::slips::FirstSlip;
use crate::sim::steps::Path;

/// Probability that is asked for.
const WANTED: f64 = 0.95;
/// Sizes that are tried, in bands s (or tenths of the span where nothing sticks).
const SIZES: [f64; 8] = [1.1, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0];
/// Holds of a test: OP up, back, down, back.
const HOLDS: f64 = 4.0;
/// Largest bump that is proposed, spans of OP in the record.
const MOST: f64 = 2.0;

/// The test for the two likeliest answers that can be simulated, named or not; `None` where there are no two, where the base
/// is worse than PV's mean, or where no bump tells them apart that OP may be asked and that keeps PV and its duration within
/// the guard of bump tests.
#[must_use]
pub(super) fn next_test(
    problem: &Problem,
    found: &Found,
    findings: &Findings,
    decision: &Decision,
) -> Option<NextTest> {
    if findings.relative_gap > 1.0 {
        return None;
    }
    let lane_of = |id: &str| {
        if id == NONE { Some(&found.base) } else { found.searches.iter().find(|l| l.structure.id_in(problem) == id) }
    };
    // What the recorder or the noise did is settled elsewhere.
    if decision.cause.id != UNKNOWN && lane_of(&decision.cause.id).is_none() {
        return None;
    }
    let ids = core::iter::once(&decision.cause.id).chain(decision.alternatives.iter().map(|a| &a.id));
    let mut known = ids.filter_map(|id| Some((id, lane_of(id)?)));
    let ((name, first), (rival, second)) = (known.next()?, known.next()?);
    let best = first.best.first()?;
    let noise = findings.floor.noise_floor.unwrap_or(findings.base.rmse) / problem.normalised.deviation;
    let settles = best.theta.lag + 3.0 * libm::exp(best.theta.log_tau).min(problem.period);
    let hold = settles.ceil() as usize + 2;
    let duration_s = hold as f64 * problem.point_s;
    let pv_span = stats::span(&problem.normalised.pv);
    let unit = if best.theta.s > 0.0 { best.theta.s } else { 0.1 };
    for size in SIZES.map(|s| s * unit).into_iter().filter(|size| *size <= MOST) {
        let answers = [first, second].map(|search| answer(problem, search, size, hold));
        let [Some(a), Some(b)] = answers else { continue };
        let travel = a.iter().chain(&b).fold(0.0_f64, |most, x| most.max(x.abs()));
        if guard::excess(travel, pv_span, HOLDS * duration_s).is_some() {
            return None;
        }
        let apart: Vec<f64> = a.iter().zip(&b).map(|(x, y)| x - y).collect();
        // The better of two known courses in white noise (matched filter).
        let p = normal_below(0.5 * stats::dot(&apart, &apart).sqrt() / noise.max(1e-12));
        if p >= WANTED {
            return Some(NextTest {
                signal: "op",
                size: size * problem.normalised.span,
                duration_s,
                separates: [name.clone(), rival.clone()],
                p,
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
