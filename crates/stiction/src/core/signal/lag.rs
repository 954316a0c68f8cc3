//! Correlation of two signals, and the delay between them.

use super::detrend::remove_mean;
use super::stats;

/// Correlation of two series of equal length; 0 if one is constant.
#[must_use]
pub fn correlation(a: &[f64], b: &[f64]) -> f64 {
    let (a, b) = (remove_mean(a), remove_mean(b));
    let scale = (stats::dot(&a, &a) * stats::dot(&b, &b)).sqrt();
    if scale > 0.0 { stats::dot(&a, &b) / scale } else { 0.0 }
}

/// Delay of `pv` relative to `op`, 0 to `most` points, at which their normalised correlation is largest in magnitude. 0 if
/// either is constant.
#[must_use]
pub fn of_largest_correlation(op: &[f64], pv: &[f64], most: usize) -> usize {
    let n = op.len().min(pv.len());
    let (x, y) = (&op[..n], &pv[..n]);
    let (x, y) = (remove_mean(x), remove_mean(y));
    let mut best = (0, 0.0);
    for lag in 0..=most.min(n.saturating_sub(2)) {
        let (a, b) = (&x[..n - lag], &y[lag..]);
        let scale = (stats::dot(a, a) * stats::dot(b, b)).sqrt();
        let r = if scale > 0.0 { (stats::dot(a, b) / scale).abs() } else { 0.0 };
        if r > best.1 + 1e-12 {
            best = (lag, r);
        }
    }
    best.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_delay_is_read_with_either_sign() {
        let op: Vec<f64> = (0..400).map(|k| libm::sin(k as f64 * 0.1) + 0.3 * libm::sin(k as f64 * 0.37)).collect();
        for sign in [1.0, -1.0] {
            let pv: Vec<f64> = (0..400).map(|k| if k >= 9 { 5.0 + sign * op[k - 9] } else { 5.0 }).collect();
            assert_eq!(of_largest_correlation(&op, &pv, 30), 9);
        }
        assert_eq!(of_largest_correlation(&op, &[1.0; 400], 30), 0);
        assert_eq!(of_largest_correlation(&[], &[], 30), 0);
    }
}
