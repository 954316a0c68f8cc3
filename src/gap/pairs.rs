//! Two effects at once, on demand: built from the best single ones.

use super::effects;
use super::kernel::Scored;
use super::plan::{MAX_PARAMS, Recipe};
use super::rounds::{Found, Work, share};
use super::scene::Scene;
use super::search::{Lane, NARROW, cross, form_of};
use super::types::EffectResult;
use super::weigh::Scales;

/// Single effects that are paired, and rounds that each pair gets.
const SINGLES: usize = 6;
const ROUNDS: usize = 2;

/// Pairs of the best single effects, best first, and their lanes.
pub fn run(scene: &Scene, found: &Found, scales: &Scales<'_>, work: &mut Work<'_>) -> (Vec<EffectResult>, Vec<Lane>) {
    let mut singles: Vec<&Lane> = found.lanes.iter().filter(|l| !l.best.is_empty()).collect();
    singles.sort_by(|a, b| a.sse().total_cmp(&b.sse()));
    singles.truncate(SINGLES);
    let mut lanes: Vec<Lane> = Vec::new();
    for (i, a) in singles.iter().enumerate() {
        for b in &singles[i + 1..] {
            lanes.extend(paired(a, b, 200 + lanes.len() as u64));
        }
    }
    let mut all: Vec<Lane> = singles.iter().map(|l| (*l).clone()).collect();
    all.push(found.base.clone());
    for _ in 0..ROUNDS {
        if !work.goes_on() {
            break;
        }
        let mut from = all.clone();
        from.extend(lanes.iter().cloned());
        let genes = cross(&from, 2);
        share(scene, &mut lanes, &NARROW, work, &|_| genes.clone(), &|_| &[]);
    }
    let mut out: Vec<EffectResult> = lanes.iter().filter_map(|lane| scales.weigh(lane)).collect();
    out.sort_by(|a, b| b.lead.total_cmp(&a.lead));
    (out, lanes)
}

/// The two effects in alphabetical order, starting from what each found alone.
fn paired(a: &Lane, b: &Lane, stream: u64) -> Option<Lane> {
    let (a, b) = if a.recipe.id() <= b.recipe.id() { (a, b) } else { (b, a) };
    let (first, second) = (a.recipe.each().next()?, b.recipe.each().next()?);
    if first.params.len() + second.params.len() > MAX_PARAMS {
        return None;
    }
    // Both switch the law, or both take the second lag: one would undo the other.
    let clash = |x: &str, y: &str| [x, y].contains(&first.id) && [x, y].contains(&second.id);
    if clash("extra_lag", "inverse_response") || clash("sliding_valve", "slip_overshoot") {
        return None;
    }
    let mut starts = Vec::new();
    for x in starts_of(a) {
        for y in starts_of(b) {
            let mut p = [0.0; MAX_PARAMS];
            let (left, right) = p.split_at_mut(first.params.len());
            left.copy_from_slice(&x.gene.p[..first.params.len()]);
            right[..second.params.len()].copy_from_slice(&y.gene.p[..second.params.len()]);
            starts.push(p);
        }
    }
    let recipe = Recipe { law: a.recipe.law, effects: [Some(first), Some(second)] };
    Some(Lane { recipe, starts, best: Vec::new(), evaluations: 0, stream: 1000 * stream, ..a.clone() })
}

/// Two best places of a lane, and the best of every other form of its effect.
fn starts_of(lane: &Lane) -> impl Iterator<Item = &Scored> {
    let form = |s: &Scored| form_of(&lane.recipe, &s.gene.p);
    let new = move |i: usize| lane.best[..i].iter().all(|before| form(before) != form(&lane.best[i]));
    lane.best.iter().enumerate().filter(move |(i, _)| *i < 2 || new(*i)).map(|(_, place)| place)
}

/// Whether a pair beats every single effect by the margin and closes more on held-out blocks.
#[must_use]
pub fn beats(pair: &EffectResult, singles: &[EffectResult], without: &[&str]) -> bool {
    let known = singles.iter().filter(|e| !without.contains(&e.id.as_str()));
    let best = known.max_by(|a, b| a.evidence.total_cmp(&b.evidence));
    best.is_none_or(|b| {
        pair.evidence > b.evidence.max(0.0) + effects::MARGIN
            && pair.closed_pct.unwrap_or(0.0) > b.closed_pct.unwrap_or(0.0)
    })
}
