//! The sign of the process gain, from the controller's response.
//!
//! A working loop has negative feedback, so the process gain has the sign of the controller's. A fit with the wrong sign would
//! model the controller backwards instead of the process.

use super::robust::Regressor;
use crate::core::signal::detrend::{moving_average, remove_mean};
use crate::core::signal::stats;

/// Spread of the set point over PV's from which it counts as moving, and its correlation with PV from which PV follows it.
const SP_MOVES: f64 = 0.02;
const PV_FOLLOWS: f64 = 0.2;
/// Share of OP's moves by which a later regression must explain more.
const CLEARER: f64 = 0.02;

/// Sign of the process gain (+1 or -1), or `None` if the record does not show the controller clearly.
///
/// Regresses the moves of OP on the moves and the value of -PV (a PI controller in velocity form) by three rounds of
/// reweighted least squares, for OP and PV smoothed over 1, 3 or 7 points and PV up to a point earlier.
#[must_use]
pub(crate) fn of_gain(op: &[f64], pv: &[f64]) -> Option<f64> {
    decided(best_of(op, pv, None)?)
}

/// As `of_gain`, with a set point in PV's units: if it moves and PV follows it, SP - PV is tried in addition to -PV. With a
/// moving set point the controller responds to the error, and PV alone may even move with OP.
#[must_use]
pub fn of_gain_with_sp(op: &[f64], pv: &[f64], sp: Option<&[f64]>) -> Option<f64> {
    let mut best = best_of(op, pv, None);
    if let Some(sp) = sp.filter(|sp| sp.len() == pv.len() && follows(pv, sp)) {
        let behind: Vec<f64> = pv.iter().zip(sp).map(|(pv, sp)| pv - sp).collect();
        best = best_of(op, &behind, best);
    }
    decided(best?)
}

fn follows(pv: &[f64], sp: &[f64]) -> bool {
    let (moved, spread) = (stats::std_dev(sp), stats::std_dev(pv));
    let together = stats::dot(&remove_mean(sp), &remove_mean(pv)) / pv.len() as f64;
    moved > SP_MOVES * spread && together > PV_FOLLOWS * moved * spread
}

/// The regression that shows the controller most clearly; a later one must explain more by [`CLEARER`].
fn best_of(op: &[f64], pv: &[f64], mut best: Option<Answer>) -> Option<Answer> {
    let mut work = Regressor::default();
    for width in [1, 3, 7] {
        if best.as_ref().is_some_and(|b| b.r2 + CLEARER > 1.0) {
            break;
        }
        let (u, e) = (moving_average(op, width), moving_average(pv, width));
        for lag in [0, 1] {
            // Repeat on first differences, in which a step of the set point is a single outlier.
            for found in
                [regress(&u, &e, lag, &mut work), regress(&moves(&u), &moves(&e), lag, &mut work)].into_iter().flatten()
            {
                if best.as_ref().is_none_or(|b| found.r2 > b.r2 + CLEARER) {
                    best = Some(found);
                }
            }
        }
    }
    best
}

fn decided(found: Answer) -> Option<f64> {
    let agree = found.proportional * found.integral > 0.0;
    if found.r2 > 0.6 || (found.r2 > 0.3 && agree) {
        let stronger =
            if found.integral.abs() > found.proportional.abs() { found.integral } else { found.proportional };
        if stronger != 0.0 {
            return Some(stronger.signum());
        }
    }
    None
}

/// First differences.
fn moves(x: &[f64]) -> Vec<f64> {
    x.windows(2).map(|w| w[1] - w[0]).collect()
}

/// Coefficients of the controller's response, in standard deviations of its move.
struct Answer {
    proportional: f64,
    integral: f64,
    r2: f64,
}

fn regress(op: &[f64], pv: &[f64], lag: usize, work: &mut Regressor) -> Option<Answer> {
    let n = op.len().min(pv.len());
    if n < lag + 20 {
        return None;
    }
    let from = lag + 1;
    let middle = stats::mean(pv);
    let moves: Vec<f64> = (from..n).map(|k| op[k] - op[k - 1]).collect();
    let de: Vec<f64> = (from..n).map(|k| pv[k - lag - 1] - pv[k - lag]).collect();
    let e: Vec<f64> = (from..n).map(|k| middle - pv[k - lag]).collect();
    let found = work.regress(&moves, &[&de, &e], None)?;
    Some(Answer {
        proportional: found.coefficients[0] * stats::std_dev(&de),
        integral: found.coefficients[1] * stats::std_dev(&e),
        r2: found.r2,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_controller_shows_its_sign() {
        let pv: Vec<f64> =
            (0..300).map(|k| 50.0 + libm::sin(k as f64 * 0.2) + 0.3 * libm::sin(k as f64 * 0.9)).collect();
        for sign in [1.0, -1.0] {
            let mut integral = 0.0;
            let op: Vec<f64> = pv
                .iter()
                .map(|p| {
                    integral += 0.05 * (50.0 - p);
                    30.0 + sign * (0.8 * (50.0 - p) + integral)
                })
                .collect();
            assert_eq!(of_gain(&op, &pv), Some(sign));
        }
        let unrelated: Vec<f64> = (0_u64..300).map(|k| ((k * k * 7919) % 1013) as f64).collect();
        assert_eq!(of_gain(&unrelated, &pv), None);
        assert_eq!(of_gain(&[], &[]), None);
    }

    #[test]
    fn a_set_point_that_pv_follows_shows_the_sign_that_pv_hides() {
        let n = 500;
        let sp: Vec<f64> = (0..n).map(|k| 3.0 * libm::sin(k as f64 * 0.05) + libm::sin(k as f64 * 0.21)).collect();
        let (mut pv, mut op, mut y, mut integral) = (Vec::new(), Vec::new(), 0.0, 0.0);
        for target in &sp {
            let error = target - y;
            integral += 0.05 * error;
            let u = 0.5 * error + integral;
            op.push(u);
            pv.push(y);
            y += 0.4 * (2.0 * u - y);
        }
        assert_eq!(of_gain_with_sp(&op, &pv, Some(&sp)), Some(1.0));
        let reversed: Vec<f64> = op.iter().map(|u| -u).collect();
        assert_eq!(of_gain_with_sp(&reversed, &pv, Some(&sp)), Some(-1.0));
        let still = vec![0.0; n];
        assert_eq!(of_gain_with_sp(&op, &pv, Some(&still)), of_gain(&op, &pv));
    }
}
