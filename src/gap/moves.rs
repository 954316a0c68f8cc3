//! What Gauss-Newton may move, by how much, and the bounds of every gene.

use super::effects::Reach;
use super::plan::{Gene, MAX_PARAMS, Plan, Recipe};
use super::scene::Scene;
use crate::ident::candidate::{Landing, MOST_OVERSHOOT};

/// Longest step in the logarithm of a time constant.
const LOG_STEP: f64 = 0.7;

/// What of the valve has to be run again.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum From {
    /// All of it.
    Path,
    /// What follows the stem.
    Stem,
    /// Nothing.
    Process,
}

/// One entry that Gauss-Newton may move.
#[derive(Debug)]
pub struct Movable {
    slot: Slot,
    /// What a shift of it runs again.
    pub from: From,
    /// Longest step.
    most: f64,
    /// Size of 1e-4 of it for a difference.
    scale: f64,
}

#[derive(Debug)]
enum Slot {
    Fd,
    LogTau,
    Lag,
    Param(usize),
}

impl Movable {
    fn entry<'g>(&self, gene: &'g mut Gene) -> &'g mut f64 {
        match self.slot {
            Slot::Fd => &mut gene.fd,
            Slot::LogTau => &mut gene.log_tau,
            Slot::Lag => &mut gene.lag,
            Slot::Param(i) => &mut gene.p[i],
        }
    }

    /// Shifts it by `share` of its scale, and says by how much.
    pub fn shift(&self, gene: &mut Gene, share: f64) -> f64 {
        let delta = share * self.scale;
        *self.entry(gene) += delta;
        delta
    }

    /// Moves it by `by`, at most by its longest step.
    pub fn step(&self, gene: &mut Gene, by: f64) {
        if by.is_finite() {
            *self.entry(gene) += by.clamp(-self.most, self.most);
        }
    }
}

/// What a recipe lets Gauss-Newton move.
#[must_use]
pub fn movable(recipe: &Recipe, plan: &Plan, scene: &Scene) -> Vec<Movable> {
    let mut out = Vec::with_capacity(MAX_PARAMS + 3);
    if plan.law.is_some() && !plan.is_linear_in_fd() {
        out.push(Movable { slot: Slot::Fd, from: From::Stem, most: 0.1, scale: 0.1 });
    }
    if !plan.integrating {
        out.push(Movable { slot: Slot::LogTau, from: From::Process, most: LOG_STEP, scale: 0.1 });
    }
    out.push(Movable { slot: Slot::Lag, from: From::Process, most: 2.5_f64.max(0.02 * scene.period), scale: 0.1 });
    for (i, param) in recipe.params().enumerate() {
        if let Some(from) = match param.reach {
            Reach::Process => Some(From::Process),
            Reach::Stem => Some(From::Stem),
            Reach::Path => Some(From::Path),
            Reach::Jumps => None,
        } {
            let [low, high] = param.bounds(scene);
            let width = high - low;
            out.push(Movable { slot: Slot::Param(i), from, most: 0.2 * width, scale: 0.01 * width });
        }
    }
    out
}

/// The gene inside its bounds.
#[must_use]
pub fn clamped(recipe: &Recipe, mut gene: Gene, scene: &Scene) -> Gene {
    let limits = scene.question.limits;
    gene.log_tau = gene.log_tau.clamp(libm::log(limits.tau[0]), libm::log(limits.tau[1]));
    gene.lag = gene.lag.clamp(limits.lag[0], limits.lag[1]);
    for (value, param) in gene.p.iter_mut().zip(recipe.params()) {
        let [low, high] = param.bounds(scene);
        *value = value.clamp(low, high);
    }
    gene.s = gene.s.clamp(1e-4, 1.5);
    match recipe.plan(&gene).landing() {
        Landing::Beyond => {
            gene.j = gene.j.clamp(0.0, 39.0 * gene.s);
            gene.fd = gene.fd.clamp(-MOST_OVERSHOOT * 0.5 * (gene.s + gene.j), 0.5 * gene.s);
        }
        Landing::Short => {
            gene.j = gene.j.clamp(0.0, gene.s);
            gene.fd = gene.fd.clamp(0.0, 0.5 * gene.s);
        }
    }
    gene
}
