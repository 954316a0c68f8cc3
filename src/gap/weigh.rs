//! How far each effect closes the gap: held-out free run before and after, with an interval from its blocks.

use super::decide;
use super::effects::{self, Effect, Way};
use super::express::{above_floor, fit, parameters, rms};
use super::plan::Recipe;
use super::scene::{Scene, View};
use super::search::Lane;
use super::signatures::Traces;
use super::types::{EffectResult, Fit, Floor, Stage};
use crate::signal::stats;
use crate::sim::noise::Noise;

/// Resamples of the held-out blocks, and the share that the interval holds.
const RESAMPLES: usize = 400;
const LEVEL: f64 = 0.9;
/// Error of the base over the floor below which there is nothing to close.
const NOTHING_LEFT: f64 = 1.05;

/// What the weighing needs beside the lanes.
#[derive(Debug)]
pub struct Scales<'a> {
    /// The record.
    pub scene: &'a Scene,
    /// Its floor.
    pub floor: &'a Floor,
    /// The base.
    pub base: &'a Fit,
    /// The base's lane.
    pub lane: &'a Lane,
    /// Traces in PV.
    pub traces: &'a Traces,
    /// Seed of the resamples.
    pub seed: u64,
}

impl Scales<'_> {
    /// PV as recorded.
    fn pv(&self) -> impl Iterator<Item = f64> + '_ {
        self.scene.question.pv.iter().map(|y| y * self.scene.deviation + self.scene.pv_mean)
    }

    /// Log mean squared training error after BIC, of a squared error and a number of parameters.
    fn score(&self, sse: f64, parameters: usize) -> f64 {
        let n = self.scene.target(View::Plain).len().max(1) as f64;
        libm::log((sse / n).max(1e-30)) + parameters as f64 * libm::log(n) / n
    }

    /// One simulated effect, or pair, weighed against the base.
    pub fn weigh(&self, lane: &Lane) -> Option<EffectResult> {
        let best = lane.best.first()?;
        let made = fit(self.scene, lane, self.floor.noise_floor, &|_| {})?;
        let recipe = lane.recipe;
        let first = recipe.each().next()?;
        let base_sse = self.lane.sse();
        let freedom = |r: &Recipe, l: &Lane| l.best.first().map_or(0, |b| r.freedom(&r.plan(&b.gene)));
        let base_score = self.score(base_sse, freedom(&self.lane.recipe, self.lane));
        let evidence = base_score - self.score(best.sse, freedom(&recipe, lane));
        let margin = recipe.each().map(|e| e.margin).fold(0.0, f64::max);
        let stages: Vec<Stage> = recipe.each().map(|e| e.stage).collect();
        let stage = if stages.iter().all(|s| *s == first.stage) { first.stage } else { Stage::CannotTell };
        let predictable = decide::predictable(&recipe.id());
        let parameters = parameters(self.scene, &recipe, best);
        let (closed_pct, closed_interval) = if predictable { self.closed(&made) } else { (None, None) };
        Some(EffectResult {
            id: recipe.id(),
            stage,
            parameters,
            gap_before: self.base.gap,
            gap_after: made.gap,
            floor_after: None,
            closed_pct,
            closed_interval,
            raw_gain: libm::log(base_sse.max(1e-30)) - libm::log(best.sse.max(1e-30)),
            evidence,
            lead: evidence - margin,
            confusable_with: first.confused_with.to_vec(),
            separated_by: first.separated_by,
            fit: Some(made),
        })
    }

    /// One effect of the recording, seen in PV.
    #[must_use]
    pub fn recorded(&self, effect: &'static Effect, floor_after: Option<f64>) -> EffectResult {
        let found = self.traces.signatures.iter().find(|s| s.id == effect.id);
        let met = found.is_some_and(|s| s.met);
        let made = if met && effect.way == Way::Signature && effect.predictable {
            fit(self.scene, self.lane, self.floor.noise_floor, &|p| self.traces.apply(effect.id, p))
        } else {
            None
        };
        // Masked points count here: they are what the effect is about.
        let all = |f: &Fit| -> Vec<f64> { self.pv().zip(&f.prediction).map(|(y, p)| y - p).collect() };
        let held_out: Vec<[usize; 2]> = (self.scene.blocks.from..self.scene.n())
            .filter(|k| self.scene.blocks.held_out[*k])
            .map(|k| [k, k + 1])
            .collect();
        let floor = self.floor.noise_floor;
        let before = above_floor(rms(&all(self.base), &held_out), floor);
        let after = made.as_ref().map_or(before, |f| above_floor(rms(&all(f), &held_out), floor));
        let closed =
            if met && effect.predictable && before > 0.0 { Some(100.0 * (1.0 - after / before)) } else { None };
        EffectResult {
            id: effect.id.to_owned(),
            stage: effect.stage,
            parameters: found.filter(|s| s.met).map(|s| s.parameters.clone()).unwrap_or_default(),
            gap_before: before,
            gap_after: after,
            floor_after,
            closed_pct: closed,
            closed_interval: None,
            raw_gain: 0.0,
            evidence: 0.0,
            lead: if met { 0.0 } else { -effects::MARGIN },
            confusable_with: effect.confused_with.to_vec(),
            separated_by: effect.separated_by,
            fit: None,
        }
    }

    /// Per cent closed on held-out blocks and its interval; nothing where the base has no gap.
    fn closed(&self, after: &Fit) -> (Option<f64>, Option<[f64; 2]>) {
        let floor = self.floor.noise_floor;
        let at_floor = floor.is_some_and(|f| self.base.rmse < NOTHING_LEFT * f);
        if at_floor || self.base.gap <= 0.0 {
            return (None, None);
        }
        let share = |before: f64, after: f64| 100.0 * (1.0 - after / before);
        let blocks = self.blocks(after);
        if blocks.len() < 3 {
            return (Some(share(self.base.gap, after.gap)), None);
        }
        let mut rng = Noise::new(self.seed, 31);
        let mut drawn: Vec<f64> = Vec::with_capacity(RESAMPLES);
        for _ in 0..RESAMPLES {
            let mut sums = [0.0; 3];
            for _ in 0..blocks.len() {
                let block = blocks[rng.below(blocks.len() as u64) as usize];
                for (sum, value) in sums.iter_mut().zip(block) {
                    *sum += value;
                }
            }
            let gap = |sse: f64| above_floor((sse / sums[0]).sqrt(), floor);
            let (before, after) = (gap(sums[1]), gap(sums[2]));
            if before > 0.0 {
                drawn.push(share(before, after));
            }
        }
        let tail = 0.5 * (1.0 - LEVEL);
        let interval =
            (drawn.len() > RESAMPLES / 2).then(|| [stats::quantile(&drawn, tail), stats::quantile(&drawn, 1.0 - tail)]);
        (Some(share(self.base.gap, after.gap)), interval)
    }

    /// Points, squared error before and after, of every held-out block.
    fn blocks(&self, after: &Fit) -> Vec<[f64; 3]> {
        let blocks = &self.scene.blocks;
        let mut out = vec![[0.0; 3]; blocks.number.last().map_or(0, |n| n + 1)];
        for (k, y) in self.pv().enumerate() {
            if k >= blocks.from && blocks.held_out[k] && !blocks.masked[k] {
                let (b, a) = (y - self.base.prediction[k], y - after.prediction[k]);
                let sums = &mut out[blocks.number[k]];
                *sums = [sums[0] + 1.0, sums[1] + b * b, sums[2] + a * a];
            }
        }
        out.retain(|b| b[0] > 0.0);
        out
    }
}
