//! What Gauss-Newton may move, by how much, and the bounds of every theta.

use super::effects::Reach;
use super::problem::Problem;
use super::structure::{MAX_PARAMS, Parameters, Plan, Structure};
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
    fn entry<'g>(&self, theta: &'g mut Parameters) -> &'g mut f64 {
        match self.slot {
            Slot::Fd => &mut theta.fd,
            Slot::LogTau => &mut theta.log_tau,
            Slot::Lag => &mut theta.lag,
            Slot::Param(i) => &mut theta.p[i],
        }
    }

    /// Shifts it by `share` of its scale, and says by how much.
    pub fn shift(&self, theta: &mut Parameters, share: f64) -> f64 {
        let delta = share * self.scale;
        *self.entry(theta) += delta;
        delta
    }

    /// Moves it by `by`, at most by its longest step.
    pub fn step(&self, theta: &mut Parameters, by: f64) {
        if by.is_finite() {
            *self.entry(theta) += by.clamp(-self.most, self.most);
        }
    }
}

/// What a structure lets Gauss-Newton move.
#[must_use]
pub fn movable(structure: &Structure, plan: &Plan, problem: &Problem) -> Vec<Movable> {
    let mut out = Vec::with_capacity(MAX_PARAMS + 3);
    if plan.law.is_some() && !plan.is_linear_in_fd() {
        out.push(Movable { slot: Slot::Fd, from: From::Stem, most: 0.1, scale: 0.1 });
    }
    if !plan.integrating {
        out.push(Movable { slot: Slot::LogTau, from: From::Process, most: LOG_STEP, scale: 0.1 });
    }
    out.push(Movable { slot: Slot::Lag, from: From::Process, most: 2.5_f64.max(0.02 * problem.period), scale: 0.1 });
    for (i, param) in structure.params().enumerate() {
        if let Some(from) = match param.reach {
            Reach::Process => Some(From::Process),
            Reach::Stem => Some(From::Stem),
            Reach::Path => Some(From::Path),
            Reach::Jumps => None,
        } {
            let [low, high] = param.bounds(problem);
            let width = high - low;
            out.push(Movable { slot: Slot::Param(i), from, most: 0.2 * width, scale: 0.01 * width });
        }
    }
    out
}

/// The theta inside its bounds.
#[must_use]
pub fn clamped(structure: &Structure, mut theta: Parameters, problem: &Problem) -> Parameters {
    let limits = problem.question.limits;
    theta.log_tau = theta.log_tau.clamp(libm::log(limits.tau[0]), libm::log(limits.tau[1]));
    theta.lag = theta.lag.clamp(limits.lag[0], limits.lag[1]);
    for (value, param) in theta.p.iter_mut().zip(structure.params()) {
        let [low, high] = param.bounds(problem);
        *value = value.clamp(low, high);
    }
    theta.s = theta.s.clamp(1e-4, 1.5);
    match structure.plan(&theta).landing() {
        Landing::Beyond => {
            theta.j = theta.j.clamp(0.0, 39.0 * theta.s);
            theta.fd = theta.fd.clamp(-MOST_OVERSHOOT * 0.5 * (theta.s + theta.j), 0.5 * theta.s);
        }
        Landing::Short => {
            theta.j = theta.j.clamp(0.0, theta.s);
            theta.fd = theta.fd.clamp(0.0, 0.5 * theta.s);
        }
    }
    theta
}
