//! How far each effect closes the gap: held-out free run before and after, with an interval from its blocks.

use std::collections::BTreeMap;

use super::candidate::Candidate;
use super::decide;
use super::effects::{self, Effect, Rest};
use super::express::{above_floor, fit, parameters};
use super::filter::Filtered;
use super::problem::{Problem, View};
use super::schedule::residual_of;
use super::search::Search;
use super::sizes::sized;
use super::structure::Structure;
use super::traces::Traces;
use super::types::{AT_FLOOR, EffectNote, Fit, Floor, Stage};
use crate::core::signal::stats;
use crate::core::sim::noise::Noise;

/// Resamples of the held-out blocks, and the share that the interval holds.
const RESAMPLES: usize = 400;
const LEVEL: f64 = 0.9;
/// Fewest fitted points a parameter: with less an effect may meet them all and say nothing.
const POINTS_A_PARAMETER: usize = 2;

/// The effect that leads most comes first.
pub(crate) fn sort_by_lead(effects: &mut [EffectNote]) {
    effects.sort_by(|a, b| b.lead.total_cmp(&a.lead));
}

/// What the weighing needs beside the searches.
#[derive(Debug, Clone, Copy)]
pub struct Scales<'a> {
    /// The record.
    pub problem: &'a Problem,
    /// Its floor.
    pub floor: &'a Floor,
    /// The base.
    pub base: &'a Fit,
    /// The base's search.
    pub search: &'a Search,
    /// Traces in PV.
    pub traces: &'a Traces,
    /// Seed of the resamples.
    pub seed: u64,
}

impl Scales<'_> {
    /// PV as recorded.
    fn pv(&self) -> impl Iterator<Item = f64> + '_ {
        self.problem.normalised.pv.iter().map(|y| self.problem.pv_of(*y))
    }

    /// Log mean squared training error after BIC, of a squared error and a number of parameters.
    fn score(&self, sse: f64, parameters: usize) -> f64 {
        let n = self.problem.target(View::Plain).len().max(1) as f64;
        libm::log((sse / n).max(1e-30)) + parameters as f64 * libm::log(n) / n
    }

    /// One simulated effect, or pair, weighed against the base.
    pub(crate) fn weigh(&self, search: &Search) -> Option<EffectNote> {
        let best = search.best.first()?;
        let made = fit(self.problem, search, self.floor.noise_floor, &|_| {})?;
        let structure = search.structure;
        let first = structure.each().next()?;
        let base_sse = self.search.sse();
        let freedom = |r: &Structure, l: &Search| l.best.first().map_or(0, |b| r.freedom(&r.plan(&b.theta)));
        let base_score = self.score(base_sse, freedom(&self.search.structure, self.search));
        let free = freedom(&structure, search);
        let tells = self.problem.target(View::Plain).len() >= POINTS_A_PARAMETER * free;
        let gain = base_score - self.score(best.sse, free);
        let evidence = if tells { gain } else { gain.min(0.0) };
        let margin = structure.each().map(|e| e.margin).fold(0.0, f64::max);
        let stages: Vec<Stage> = structure.each().map(|e| e.stage).collect();
        let stage = if stages.iter().all(|s| *s == first.stage) { first.stage } else { Stage::CannotTell };
        let predictable = decide::predictable(&structure.id());
        let is_meant = is_meant(&structure, best) && leaves_noise(self.problem, search, self.floor.noise_floor);
        let lead = if is_meant { evidence - margin } else { -margin };
        let parameters = parameters(self.problem, &structure, best);
        let (closed_pct, closed_interval) = if predictable { self.closed(&made) } else { (None, None) };
        Some(EffectNote {
            id: structure.id_in(self.problem),
            stage,
            parameters: sized(&structure.id(), parameters),
            gap_after: made.gap,
            closed_pct,
            closed_interval,
            evidence,
            lead,
            at_floor: Some(made.at_floor),
            simulated: true,
            fit: Some(made),
            ..self.nothing_of(first)
        })
    }

    /// What is said of an effect that does nothing.
    fn nothing_of(&self, effect: &Effect) -> EffectNote {
        EffectNote {
            id: effect.id.to_owned(),
            stage: effect.stage,
            parameters: BTreeMap::new(),
            gap_before: self.base.gap,
            gap_after: self.base.gap,
            floor_after: None,
            closed_pct: None,
            closed_interval: None,
            evidence: 0.0,
            lead: -effects::MARGIN,
            confusable_with: effect.confused_with.iter().map(|id| (*id).to_owned()).collect(),
            separated_by: effect.separated_by.to_owned(),
            at_floor: None,
            own_cycle: false,
            follows_set_point: false,
            simulated: false,
            fit: None,
        }
    }

    /// A filter in the measurement.
    #[must_use]
    pub(crate) fn filtered(&self, effect: &'static Effect, filtered: &Filtered) -> EffectNote {
        let made = filtered.fit.clone();
        let sse = |rmse: f64| rmse * rmse * self.problem.target(View::Plain).len() as f64;
        let [before, after] = [self.base, &made].map(|f| (sse(f.rmse_train), f.parameters));
        let evidence = self.score(before.0, before.1) - self.score(after.0, after.1);
        let (closed_pct, closed_interval) = self.closed(&made);
        EffectNote {
            simulated: true,
            parameters: sized(effect.id, filtered.parameters()),
            gap_after: made.gap,
            closed_pct,
            closed_interval,
            evidence,
            lead: evidence - effect.margin,
            at_floor: Some(made.at_floor),
            fit: Some(made),
            ..self.nothing_of(effect)
        }
    }

    /// One effect of the recording, seen in PV. What it does is measured where it is met and a free run can follow it.
    #[must_use]
    pub(crate) fn recorded(&self, effect: &'static Effect, floor_after: Option<f64>) -> EffectNote {
        let found = self.traces.signatures.iter().find(|s| s.id == effect.id && s.met);
        let met = found.is_some();
        let made = effect
            .recorder
            .filter(|_| met && !self.traces.beyond_reach)
            .and_then(|recorder| fit(self.problem, self.search, self.floor.noise_floor, &|p| recorder(self.traces, p)));
        let blocks = self.blocks(made.as_ref().unwrap_or(self.base), made.is_some() && effect.local);
        let [before, after] = self.gaps(&blocks);
        let (closed_pct, closed_interval) = made.as_ref().map_or((None, None), |_| self.closed_in(&blocks));
        EffectNote {
            parameters: found.map(|s| sized(effect.id, s.parameters.clone())).unwrap_or_default(),
            gap_before: before,
            gap_after: after,
            floor_after,
            closed_pct,
            closed_interval,
            lead: if met { 0.0 } else { -effects::MARGIN },
            fit: made,
            ..self.nothing_of(effect)
        }
    }

    /// Per cent closed on held-out blocks and its interval; nothing where the base has no gap.
    fn closed(&self, after: &Fit) -> (Option<f64>, Option<[f64; 2]>) {
        self.closed_in(&self.blocks(after, false))
    }

    /// Gaps before and after over blocks.
    fn gaps(&self, blocks: &[[f64; 3]]) -> [f64; 2] {
        let [n, before, after] = summed(blocks.iter());
        [before, after].map(|sse| above_floor((sse / n.max(1.0)).sqrt(), self.floor.noise_floor))
    }

    fn closed_in(&self, blocks: &[[f64; 3]]) -> (Option<f64>, Option<[f64; 2]>) {
        let floor = self.floor.noise_floor;
        let [n, sse, _] = summed(blocks.iter());
        let at_floor = floor.is_some_and(|f| (sse / n.max(1.0)).sqrt() < AT_FLOOR * f);
        let share = |[before, after]: [f64; 2]| (before > 0.0).then(|| 100.0 * (1.0 - after / before));
        let Some(closed) = share(self.gaps(blocks)).filter(|_| !at_floor) else { return (None, None) };
        if blocks.len() < 3 {
            return (Some(closed), None);
        }
        let mut rng = Noise::new(self.seed, 31);
        let mut drawn: Vec<f64> = Vec::with_capacity(RESAMPLES);
        for _ in 0..RESAMPLES {
            let some: Vec<[f64; 3]> = blocks.iter().map(|_| blocks[rng.below(blocks.len() as u64) as usize]).collect();
            drawn.extend(share(self.gaps(&some)));
        }
        let tail = 0.5 * (1.0 - LEVEL);
        let interval =
            (drawn.len() > RESAMPLES / 2).then(|| [stats::quantile(&drawn, tail), stats::quantile(&drawn, 1.0 - tail)]);
        (Some(closed), interval)
    }

    /// Points, squared error before and after, of every held-out block. Points that are left out of
    /// the fits for a passing effect's sake are what it is about: `with_unfitted` they count wherever they stand.
    fn blocks(&self, after: &Fit, with_unfitted: bool) -> Vec<[f64; 3]> {
        let blocks = &self.problem.blocks;
        let mut out = vec![[0.0; 3]; blocks.number.last().map_or(0, |n| n + 1)];
        for (k, y) in self.pv().enumerate() {
            let fitted = !blocks.masked[k] && self.problem.is_measured(k);
            let counts = blocks.held_out[k] && !blocks.masked[k] || with_unfitted && !fitted;
            if k >= blocks.from && counts {
                let (b, a) = (y - self.base.prediction[k], y - after.prediction[k]);
                let sums = &mut out[blocks.number[k]];
                *sums = [sums[0] + 1.0, sums[1] + b * b, sums[2] + a * a];
            }
        }
        out.retain(|b| b[0] > 0.0);
        out
    }
}

/// Whether a fit is what its effects' names say.
fn is_meant(structure: &Structure, best: &Candidate) -> bool {
    let plan = structure.plan(&best.theta);
    structure.each().all(|e| (e.is_meant)(&plan, best))
}

/// Whether what a search's best place leaves bears its effects' names out; `floor` in PV units. Without a floor nothing
/// speaks against them.
#[must_use]
fn leaves_noise(problem: &Problem, search: &Search, floor: Option<f64>) -> bool {
    let (Some(floor), Some(best)) = (floor, search.best.first()) else { return true };
    let Some(left) = residual_of(problem, search) else { return true };
    let points = problem.train.iter().flat_map(|[a, b]| *a..*b);
    let rest = Rest { points: points.map(|k| (k as f64, left[k] * problem.normalised.deviation / floor)).collect() };
    let plan = search.structure.plan(&best.theta);
    search.structure.each().all(|e| (e.leaves_noise)(&plan, &rest))
}

fn summed<'b>(blocks: impl Iterator<Item = &'b [f64; 3]>) -> [f64; 3] {
    blocks.fold([0.0; 3], |s, b| [s[0] + b[0], s[1] + b[1], s[2] + b[2]])
}
