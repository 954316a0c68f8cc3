//! The process' answer to a valve signal: lag, second lag or integrator, with a dead time that may change.

use super::plan::Plan;
use crate::sim::process::{Pole, series_weights};

/// Points by which an integrator's answer is scaled down, so that it is of the size of its input.
pub(crate) const INTEGRATOR_SCALE: f64 = 50.0;

/// Least share of its usual rate at which a process settles whose rate goes with its input.
const LEAST_RATE: f64 = 0.1;

/// The process of a plan.
#[derive(Debug, Clone, Copy)]
pub struct Process<'p> {
    /// Which blocks it has.
    pub plan: &'p Plan,
    /// Time constants, points; the second 0 for none.
    pub tau: [f64; 2],
    /// Lag, whole points and the rest.
    pub whole: usize,
    /// See `whole`.
    pub fraction: f64,
}

impl Process<'_> {
    /// Its answer to `v` from rest at its first value.
    pub(crate) fn respond(&self, v: &[f64], out: &mut Vec<f64>, work: &mut Vec<f64>) {
        self.at_lag(v, self.whole, self.fraction, out, work);
    }

    /// The process whose gain and time constant grow with its input, `tau dx/dt = -(1 - c v) x + v`, solved exactly over
    /// each part of a point for which the delayed input is held.
    fn with_level(&self, v: &[f64], whole: usize, fraction: f64, out: &mut Vec<f64>) {
        let first = v.first().copied().unwrap_or(0.0);
        let own = |v: f64| (1.0 - self.plan.level * v).max(LEAST_RATE);
        let decay = |v: f64, time: f64| libm::exp(-time * own(v) / self.tau[0]);
        let rest = |v: f64| v / own(v);
        let mut before = [first, decay(first, fraction), decay(first, 1.0 - fraction)];
        let mut x = rest(first);
        out.clear();
        for k in 0..v.len() {
            let newer = if k >= whole { v[k - whole] } else { first };
            let older = before;
            if newer != before[0] {
                before = [newer, decay(newer, fraction), decay(newer, 1.0 - fraction)];
            }
            x = rest(older[0]) + (x - rest(older[0])) * older[1];
            x = rest(newer) + (x - rest(newer)) * before[2];
            out.push(x);
        }
    }

    fn at_lag(&self, v: &[f64], whole: usize, fraction: f64, out: &mut Vec<f64>, work: &mut Vec<f64>) {
        let first = v.first().copied().unwrap_or(0.0);
        if self.plan.level != 0.0 && !self.plan.integrating {
            self.with_level(v, whole, fraction, out);
            if self.tau[1] > 0.0 {
                work.clone_from(out);
                Pole::lag(self.tau[1], 0.0).run(0, work, work.first().copied().unwrap_or(0.0), out);
            }
            return;
        }
        if self.plan.integrating {
            let p = Pole::integrator(fraction);
            let p = Pole { a: p.a, b0: p.b0 / INTEGRATOR_SCALE, b1: p.b1 / INTEGRATOR_SCALE };
            p.run(whole, v, 0.0, out);
            return;
        }
        let [tau1, tau2] = self.tau;
        Pole::lag(tau1, fraction).run(whole, v, first, out);
        if tau2 > 0.0 {
            Pole::lag(tau2, fraction).run(whole, v, first, work);
            let (w1, w2) = series_weights(tau1, tau2);
            for (o, w) in out.iter_mut().zip(work.iter()) {
                *o = w1 * *o + w2 * w;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `tau dx/dt = -(1 - c v) x + v` in a thousand steps a point, `v` delayed by `lag` points.
    fn by_small_steps(v: &[f64], lag: f64, tau: f64, c: f64) -> Vec<f64> {
        const PARTS: usize = 1000;
        let at = |t: f64| if t < 0.0 { v[0] } else { v[(t.floor() as usize).min(v.len() - 1)] };
        let mut x = v[0] / (1.0 - c * v[0]);
        let mut out = Vec::new();
        for k in 0..v.len() {
            for i in 0..PARTS {
                // The value of a point acts over the point that ends there.
                let t = k as f64 + (i as f64 + 0.5) / PARTS as f64 - lag;
                let held = at(t);
                x += (held - (1.0 - c * held) * x) / (tau * PARTS as f64);
            }
            out.push(x);
        }
        out
    }

    #[test]
    fn a_gain_that_goes_with_the_level_is_solved_exactly() {
        let v: Vec<f64> = (0..120).map(|k| if k % 40 < 17 { 0.35 } else { -0.3 }).collect();
        for (level, fraction) in [(0.8, 0.3), (-1.2, 0.0), (0.0, 0.6)] {
            let plan = Plan { level, ..Plan::base(None) };
            let process = Process { plan: &plan, tau: [7.0, 0.0], whole: 3, fraction };
            let (mut out, mut work) = (Vec::new(), Vec::new());
            process.respond(&v, &mut out, &mut work);
            for (x, y) in out.iter().zip(by_small_steps(&v, 3.0 + fraction, 7.0, level)) {
                assert!((x - y).abs() < 1e-3, "{level} {fraction}: {x} {y}");
            }
        }
    }
}
