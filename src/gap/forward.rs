//! Forward in time: fitted to the first part of a record, run freely over the rest.

use super::express::{above_floor, fit};
use super::plan::Gene;
use super::rounds::Work;
use super::scene::Scene;
use super::search::{Lane, NARROW, hunt};
use super::types::Forward;

/// Share of the record that is fitted.
const FIRST: f64 = 0.6;
/// Fewest points of the rest.
const LEAST: usize = 40;

/// Gaps of base and cause on the rest; `None` where the rest is too short or a model finds no place.
pub fn forward(scene: &Scene, base: &Lane, cause: &Lane, floor: Option<f64>, work: &mut Work<'_>) -> Option<Forward> {
    let from = scene.blocks.from;
    let cut = from + (FIRST * (scene.n() - from) as f64) as usize;
    if scene.n() - cut < LEAST || cut - from < LEAST {
        return None;
    }
    let held_out: Vec<bool> = (0..scene.n()).map(|k| k >= cut).collect();
    let part = scene.held_out_by(&held_out);
    let seed = work.seed;
    let lanes = work.all(2, |i| {
        let source = if i == 0 { base } else { cause };
        let genes: Vec<Gene> = source.best.iter().map(|b| b.gene).collect();
        let starts = source.best.iter().take(2).map(|b| b.gene.p).collect();
        let mut lane = Lane { best: Vec::new(), evaluations: 0, allowed: u64::MAX, starts, ..source.clone() };
        hunt(&part, &mut lane, &genes, &[], &NARROW, seed);
        lane
    });
    work.done += lanes.iter().map(|l| l.evaluations).sum::<u64>();
    let gap = |lane: &Lane| fit(&part, lane, floor, &|_| {}).map(|f| above_floor(f.rmse, floor));
    let [before, after] = [lanes.first()?, lanes.get(1)?].map(gap);
    Some(Forward { gap_before: before?, gap_after: after? })
}
