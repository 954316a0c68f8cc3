//! The sign of the process gain, read from how the controller answers.
//!
//! A loop that works has negative feedback, so the process gain has the sign of the controller's. Fitting the wrong
//! sign would model the controller backwards instead of the process.

use super::robust::Regressor;
use crate::signal::detrend::moving_average;
use crate::signal::stats;

/// Sign of the process gain (+1 or -1), or `None` where the record does not show the controller clearly.
///
/// Regresses the moves of OP on the moves and the value of -PV (a PI controller in velocity form) by three rounds of
/// reweighted least squares, for OP and PV smoothed over 1, 3 or 7 points and PV up to a point earlier.
#[must_use]
pub fn of_gain(op: &[f64], pv: &[f64]) -> Option<f64> {
    let mut best: Option<Answer> = None;
    let mut work = Regressor::default();
    for width in [1, 3, 7] {
        let (u, e) = (moving_average(op, width), moving_average(pv, width));
        for lag in [0, 1] {
            // Once more on first differences, in which a set point that steps leaves single outliers only.
            for found in
                [regress(&u, &e, lag, &mut work), regress(&moves(&u), &moves(&e), lag, &mut work)].into_iter().flatten()
            {
                if best.as_ref().is_none_or(|b| found.r2 > b.r2 + 0.02) {
                    best = Some(found);
                }
            }
        }
    }
    let found = best?;
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

/// Shares of the controller's answer in standard deviations of its move.
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
}
