//! The published method: one-step least squares for the process, free run for the score.
//!
//! Lee, Ren and Huang (2008) grid the two bands of He's law, estimate a first-order process with dead time from the valve
//! signal of each cell by least squares, and compare. An industrial implementation scores a window by how much the best cell's
//! free run improves on the one without friction. [`crate::core::ident::quantify`] does better in all respects; this is the benchmark, with
//! the number that others know.

use crate::core::signal::stats::{dot, mean, variance};
use crate::core::sim::valve::he_step;

/// The search of the industrial implementation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Search {
    /// Largest band tried, OP units.
    pub fs_max: f64,
    /// Largest s = fs + fd tried, OP units.
    pub s_max: f64,
    /// Values per band, including both ends.
    pub bands: usize,
    /// Initial positions of the stem, from one end of the stick band to the other.
    pub positions: usize,
    /// Largest dead time, points.
    pub delays: usize,
    /// Sign of the process gain.
    pub sign: f64,
}

impl Search {
    /// Settings of the industrial implementation: 11 by 11 bands, 10 positions, dead times up to 24 points.
    #[must_use]
    pub const fn published(fs_max: f64, sign: f64) -> Self {
        Self { fs_max, s_max: f64::INFINITY, bands: 11, positions: 10, delays: 24, sign }
    }

    /// The same, with s limited to OP's span: a stem that sticks more would not move both ways.
    #[must_use]
    pub const fn within(span: f64, sign: f64) -> Self {
        Self { s_max: span, ..Self::published(span, sign) }
    }
}

/// The best cell.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Best {
    /// `1 - least error with friction / least error without`, 0..1; both in free run, with the mean removed.
    pub index: f64,
    /// The cell's s = fs + fd, OP units; 0 if no cell beats the fit without friction.
    pub s: f64,
    /// The cell's mean squared error, PV units.
    pub error: f64,
}

/// Searches the cells. `None` if PV is constant. A process of the wrong sign is rejected: its error is PV's variance.
///
/// `op` and `pv` of equal length, in any units.
#[must_use]
pub fn toolbox(op: &[f64], pv: &[f64], search: &Search) -> Option<Best> {
    let n = op.len().min(pv.len());
    let (op, pv) = (&op[..n], &pv[..n]);
    let level = mean(pv);
    let pv: Vec<f64> = pv.iter().map(|y| y - level).collect();
    if n < search.delays + 10 {
        return None;
    }
    let target = Target::new(&pv);
    if !target.spread.is_normal() {
        return None;
    }
    let centre = mean(op);
    let error_of = |valve: &[f64]| -> f64 {
        let shifted = (0..=search.delays).map(|first| &valve[first..first + n - 1]);
        let errors = shifted.filter_map(|valve| target.free_run_error(valve, search.sign));
        // A process of gain 0 is always a candidate.
        errors.fold(target.spread, f64::min)
    };
    // Before the record the valve rests at OP's mean.
    let head = search.delays;
    let mut valve = vec![0.0; head];
    valve.extend(op.iter().map(|u| u - centre));
    let op = valve[head..].to_vec();
    let without = error_of(&valve);
    let (mut least, mut s) = (without, 0.0);
    let place = |i: usize, of: usize| if of > 1 { i as f64 / (of - 1) as f64 } else { 0.0 };
    for i in 1..search.bands {
        let fs = search.fs_max * place(i, search.bands);
        for k in 0..=i {
            let fd = search.fs_max * place(k, search.bands);
            if fs + fd > search.s_max {
                break;
            }
            for p in 0..search.positions {
                let mut position = op[0] + fs * (2.0 * place(p, search.positions) - 1.0);
                valve.truncate(head);
                valve.extend(op.iter().map(|u| {
                    position = he_step(position, *u, fs, fd);
                    position
                }));
                let error = error_of(&valve);
                if error < least {
                    (least, s) = (error, fs + fd);
                }
            }
        }
    }
    (without > 0.0).then(|| Best { index: (1.0 - least / without).clamp(0.0, 1.0), s, error: least })
}

/// PV with all sums that do not depend on the valve.
struct Target<'a> {
    first: f64,
    now: &'a [f64],
    before: &'a [f64],
    sums: [f64; 4],
    /// Variance of the PV values to be fitted.
    spread: f64,
}

impl<'a> Target<'a> {
    fn new(pv: &'a [f64]) -> Self {
        let (now, before) = (&pv[1..], &pv[..pv.len() - 1]);
        let sums = [before.iter().sum(), now.iter().sum(), dot(before, before), dot(before, now)];
        Self { first: pv[0], now, before, sums, spread: variance(now) }
    }

    /// Mean squared error, mean removed, of `y[k] = a y[k-1] + b valve[k] + c` in free run, with coefficients from one-step
    /// least squares; `None` if `b` does not have the required sign.
    fn free_run_error(&self, valve: &[f64], sign: f64) -> Option<f64> {
        let count = self.now.len() as f64;
        let [sy, sz, syy, syz] = self.sums;
        let sv: f64 = valve.iter().sum();
        let (cyy, cyz) = (syy - sy * sy / count, syz - sy * sz / count);
        let cvv = dot(valve, valve) - sv * sv / count;
        let cyv = dot(self.before, valve) - sy * sv / count;
        let cvz = dot(valve, self.now) - sv * sz / count;
        let determinant = cyy * cvv - cyv * cyv;
        if determinant.is_nan() || determinant <= 1e-12 * cyy * cvv {
            return None;
        }
        let a = (cyz * cvv - cvz * cyv) / determinant;
        let b = (cvz * cyy - cyz * cyv) / determinant;
        if b * sign <= 0.0 {
            return None;
        }
        let c = (sz - a * sy - b * sv) / count;
        let mut y = self.first;
        let (mut sum, mut squares) = (0.0, 0.0);
        for (v, z) in valve.iter().zip(self.now) {
            y = a * y + (b * v + c);
            let e = z - y;
            sum += e;
            squares += e * e;
        }
        let error = squares / count - (sum / count) * (sum / count);
        error.is_finite().then_some(error)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::sim::process::Pole;

    #[test]
    fn friction_scores_high_and_none_scores_nothing() {
        let op: Vec<f64> = (0..600).map(|k| 3.0 * libm::sin(f64::from(k) * 0.06)).collect();
        let (fs, fd) = (2.0, 1.2);
        let mut position = op[0];
        let stem: Vec<f64> = op
            .iter()
            .map(|u| {
                position = he_step(position, *u, fs, fd);
                position
            })
            .collect();
        let search = Search::published(4.0, 1.0);
        let (mut sticking, mut healthy) = (Vec::new(), Vec::new());
        Pole::lag(8.0, 0.0).run(3, &stem, 0.0, &mut sticking);
        Pole::lag(8.0, 0.0).run(3, &op, 0.0, &mut healthy);
        assert!(
            toolbox(&op, &sticking, &search).is_some_and(|best| best.index > 0.8 && (best.s - fs - fd).abs() < 0.9)
        );
        let noisy: Vec<f64> =
            healthy.iter().enumerate().map(|(k, y)| y + 0.1 * ((k * k % 101) as f64 / 101.0 - 0.5)).collect();
        assert!(toolbox(&op, &noisy, &search).is_some_and(|best| best.index < 0.2));
        assert_eq!(toolbox(&op, &[1.0; 600], &search), None);
        assert_eq!(toolbox(&[], &[], &search), None);
    }
}
