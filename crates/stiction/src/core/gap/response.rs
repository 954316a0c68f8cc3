//! The process' response to a valve signal, sample by sample; its time constant may depend on the signal's level.

use super::plan::Plan;
use crate::core::sim::process::Pole;

/// Least share of its usual rate at which a process settles whose time constant depends on its input.
const LEAST_RATE: f64 = 0.1;

/// The process of a plan.
#[derive(Debug, Clone, Copy)]
pub struct Process<'p> {
    /// Which blocks it has.
    pub plan: &'p Plan,
    /// Time constants, points; the second 0 for none.
    pub tau: [f64; 2],
    /// Lag, points.
    pub lag: f64,
}

impl Process<'_> {
    /// Its response to `v` from rest at its first value.
    pub(crate) fn respond(&self, v: &[f64]) -> Vec<f64> {
        let tau2 = self.tau[1];
        if self.plan.level == 0.0 || self.plan.integrating {
            let class = self.plan.class();
            return class.respond(&class.shape(self.tau, self.lag), v);
        }
        let slow = self.with_level(v);
        if tau2 == 0.0 {
            return slow;
        }
        let mut out = Vec::new();
        Pole::lag(tau2, 0.0).run(0, &slow, slow.first().copied().unwrap_or(0.0), &mut out);
        out
    }

    /// The process whose gain and time constant grow with its input, `tau dx/dt = -(1 - c v) x + v`, solved exactly over
    /// each part of a point for which the delayed input is held.
    fn with_level(&self, v: &[f64]) -> Vec<f64> {
        let first = v.first().copied().unwrap_or(0.0);
        let (whole, fraction) = (self.lag as usize, self.lag.fract());
        let own = |v: f64| (1.0 - self.plan.level * v).max(LEAST_RATE);
        let decay = |v: f64, time: f64| libm::exp(-time * own(v) / self.tau[0]);
        let rest = |v: f64| v / own(v);
        // The input held, where it settles, how far off that is, and what the parts of a point leave of that.
        let (mut held, mut settled, mut off, mut early, mut late) = (first, rest(first), 0.0, 1.0, 1.0);
        let point = |k: usize| {
            let newer = if k >= whole { v[k - whole] } else { first };
            if newer == held {
                off *= early * late;
            } else {
                let before = settled + off * early;
                (held, settled) = (newer, rest(newer));
                (early, late) = (decay(newer, fraction), decay(newer, 1.0 - fraction));
                off = (before - settled) * late;
            }
            settled + off
        };
        (0..v.len()).map(point).collect()
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
            let process = Process { plan: &plan, tau: [7.0, 0.0], lag: 3.0 + fraction };
            for (x, y) in process.respond(&v).iter().zip(by_small_steps(&v, 3.0 + fraction, 7.0, level)) {
                assert!((x - y).abs() < 1e-3, "{level} {fraction}: {x} {y}");
            }
        }
    }
}
