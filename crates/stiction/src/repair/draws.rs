//! Loops compatible with the record: bands drawn from their intervals, process and controller drawn around the estimates, each
//! kept in proportion to its likelihood.

use super::plant::{Known, Plant, Shape};
use crate::core::ident::residual::whiteness;
use crate::core::sim::closed_loop::ValveLaw;
use crate::core::sim::noise::Noise;
use crate::core::sim::process::ProcessModel;

/// Number of proposals, and of loops drawn from them.
const PROPOSED: usize = 96;
pub(super) const DRAWN: usize = 32;
/// Most independent points used to compare proposals: no model is exact.
const MOST_POINTS: f64 = 60.0;
/// Half width of a 90 % interval in standard deviations.
const HALF_WIDTH: f64 = 1.645;
/// Relative standard deviations of proposals: time constants and dead time (points, at least), the controller's gain and
/// integral time; more if the controller model leaves more unexplained.
const TIMES: f64 = 0.15;
const LEAST_DEAD: f64 = 0.3;
const CONTROLLER: [f64; 2] = [0.02, 0.05];
const CONTROLLER_MORE: [f64; 2] = [0.5, 1.0];

/// A loop compatible with the record.
pub(super) struct Drawn {
    pub plant: Plant,
    /// Gain, OP units per PV unit, > 0, and integral time, s.
    pub kc: f64,
    pub ti_s: f64,
}

/// Loops compatible with the record, seeded; empty if no plant fits.
pub(super) fn draws(known: &Known<'_>, seed: u64) -> Vec<Drawn> {
    let mut noise = Noise::new(seed, 0);
    let centre = known.shape();
    let proposals =
        (0..PROPOSED).filter_map(|k| known.plant(if k == 0 { centre } else { proposed(known, &mut noise) }));
    let mut plants: Vec<Plant> = proposals.collect();
    let Some(least) = plants.iter().map(|p| p.mse).min_by(f64::total_cmp).filter(|m| *m > 0.0) else { return vec![] };
    let best = plants.iter().find(|p| p.mse == least);
    let inflation = best.map_or(1.0, |p| whiteness(&p.residual, &known.op[known.len() - p.residual.len()..]).inflation);
    let points = (known.len() as f64 / inflation).min(MOST_POINTS);
    let weights: Vec<f64> = plants.iter().map(|p| libm::pow(least / p.mse, 0.5 * points)).collect();
    let all: f64 = weights.iter().sum();
    // Systematic resampling: one draw for all equidistant points.
    let offset = noise.uniform();
    let (mut sum, mut at) = (weights.first().copied().unwrap_or(0.0), 0);
    let mut out = Vec::with_capacity(DRAWN);
    for k in 0..DRAWN {
        let place = (k as f64 + offset) / DRAWN as f64 * all;
        while sum < place && at + 1 < plants.len() {
            at += 1;
            sum += weights[at];
        }
        let (kc, ti_s) = controller(known, &mut noise);
        out.push(Drawn { plant: plants[at].clone(), kc, ti_s });
    }
    plants.clear();
    out
}

fn controller(known: &Known<'_>, noise: &mut Noise) -> (f64, f64) {
    let c = known.controller;
    let lost = (1.0 - c.r2).max(0.0);
    let mut factor = |k: usize| libm::exp((CONTROLLER[k] + CONTROLLER_MORE[k] * lost) * noise.gaussian());
    (c.kc.abs() * factor(0), c.ti_s * factor(1))
}

fn proposed(known: &Known<'_>, noise: &mut Noise) -> Shape {
    let centre = known.shape();
    let (fs, fd) = if known.law == ValveLaw::None { (0.0, 0.0) } else { bands(known, noise, [centre.fs, centre.fd]) };
    let p = centre.process;
    let mut times = || libm::exp(TIMES * noise.gaussian());
    let (tau, tau2) = (p.tau * times(), p.tau2 * times());
    let dead_time = (p.dead_time + (TIMES * p.dead_time).max(LEAST_DEAD) * noise.gaussian()).max(0.0);
    Shape { fs, fd, process: ProcessModel { tau, tau2, dead_time, ..p } }
}

/// fs and fd from s and j drawn from their intervals.
fn bands(known: &Known<'_>, noise: &mut Noise, [fs, fd]: [f64; 2]) -> (f64, f64) {
    let a = known.assessment;
    let (s, j) = (fs + fd, fs - fd);
    let normal = |centre: f64, interval: Option<[f64; 2]>, z: f64| {
        let [low, high] = interval.unwrap_or([centre; 2]);
        centre + z.abs() / HALF_WIDTH * if z > 0.0 { high - centre } else { low - centre }
    };
    let new_s = normal(s, a.s_interval, noise.gaussian()).max(0.05 * s);
    let new_j = match (a.j_identifiable, a.j_interval) {
        (Some(false), Some([low, high])) => low + (high - low) * noise.uniform(),
        (_, interval) => normal(j, interval, noise.gaussian()),
    };
    let new_j = new_j.clamp(0.0, new_s);
    (0.5 * (new_s + new_j), 0.5 * (new_s - new_j))
}
