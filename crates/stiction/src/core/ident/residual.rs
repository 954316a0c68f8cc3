//! Tests whether the residual of a fit is noise or shows structure that the model lacks.

use serde::{Deserialize, Serialize};

use crate::core::signal::stats;

/// Lags tested.
const LAGS: usize = 20;
/// Portmanteau statistic over [`LAGS`] lags beyond which a residual is not white: chi-squared, 20 degrees, 0.1 %.
pub(crate) const PORTMANTEAU: f64 = 45.3;
/// Lag-1 autocorrelation beyond which a residual is not white, however short the record.
const FIRST_LAG: f64 = 0.12;
/// Largest normalised cross-correlation of noise with OP and its moves, in standard errors: 40 draws, some 1 %.
const CROSS: f64 = 3.7;
/// Most that an autocorrelation may inflate the variance.
const MOST_INFLATION: f64 = 30.0;

/// Tests of a residual.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Whiteness {
    /// Autocorrelation at lag 1.
    pub r1: f64,
    /// Ljung and Box's statistic of 20 lags; 20 on average for white noise.
    pub portmanteau: f64,
    /// Largest correlation with OP, or its moves, 1 to 20 points earlier, in standard errors of white noise.
    pub cross: f64,
    /// Points over independent points, 1 for white noise: `1 + 2 sum r`, summed while positive.
    pub inflation: f64,
    /// The residual's own past predicts nothing of it.
    pub white: bool,
    /// Past OP predicts part of it.
    pub follows_op: bool,
}

impl Whiteness {
    /// Whether the residual is only noise.
    #[must_use]
    pub(crate) const fn is_noise(&self) -> bool {
        self.white && !self.follows_op
    }
}

/// Tests a residual against itself and against OP at the same points.
///
/// Only OP before the residual counts: the noise at a point enters OP from that point on, so correlations at other lags come
/// from the controller.
#[must_use]
pub(crate) fn whiteness(residual: &[f64], op: &[f64]) -> Whiteness {
    let n = residual.len().min(op.len());
    whiteness_where(&residual[..n], &op[..n], &[[0, n]])
}

/// As [`whiteness`], using only the points on some stretches.
#[must_use]
pub(crate) fn whiteness_where(residual: &[f64], op: &[f64], stretches: &[[usize; 2]]) -> Whiteness {
    let n = residual.len();
    let kept: Vec<f64> = stretches.iter().flat_map(|[a, b]| &residual[*a..*b]).copied().collect();
    let level = stats::mean(&kept);
    let (mut e, mut counts) = (vec![0.0; n], vec![0.0; n]);
    for k in stretches.iter().flat_map(|[a, b]| *a..*b) {
        (e[k], counts[k]) = (residual[k] - level, 1.0);
    }
    let power = stats::dot(&e, &e);
    if kept.len() < 2 * LAGS || power.is_nan() || power <= 0.0 {
        return Whiteness { r1: 0.0, portmanteau: 0.0, cross: 0.0, inflation: 1.0, white: true, follows_op: false };
    }
    let count = kept.len() as f64;
    let at_lag = |x: &[f64], y: &[f64], lag: usize| stats::dot(&x[lag..], &y[..y.len() - lag]);
    // The sums lack pairs across a gap, so they are scaled up.
    let of_pairs = |lag: usize| (count - lag as f64) / at_lag(&counts, &counts, lag).max(1.0);
    let r: Vec<f64> = (1..=2 * LAGS).map(|lag| at_lag(&e, &e, lag) / power * of_pairs(lag)).collect();
    let terms = r.iter().take(LAGS).enumerate().map(|(k, r)| r * r / (count - k as f64 - 1.0));
    let portmanteau = count * (count + 2.0) * terms.sum::<f64>();
    let lasting = 2.0 / count.sqrt();
    let inflation = 1.0 + 2.0 * r.iter().take_while(|r| **r > lasting).sum::<f64>();
    let moves: Vec<f64> = core::iter::once(0.0).chain(op[..n].windows(2).map(|w| w[1] - w[0])).collect();
    let middle = stats::mean(&op[..n]);
    let level: Vec<f64> = op[..n].iter().map(|u| u - middle).collect();
    let mut cross: f64 = 0.0;
    for signal in [&level, &moves] {
        let scale = (power * stats::dot(signal, signal) / n as f64).sqrt();
        if scale > 0.0 {
            cross = (1..=LAGS).map(|lag| (at_lag(&e, signal, lag) / scale).abs()).fold(cross, f64::max);
        }
    }
    let white = portmanteau < PORTMANTEAU && r[0].abs() < FIRST_LAG;
    let inflation = inflation.clamp(1.0, MOST_INFLATION);
    Whiteness { r1: r[0], portmanteau, cross, inflation, white, follows_op: cross > CROSS }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::sim::noise::Noise;

    fn noise(seed: u64, n: usize) -> Vec<f64> {
        let mut noise = Noise::new(seed, 1);
        (0..n).map(|_| noise.gaussian()).collect()
    }

    #[test]
    fn noise_is_white_and_follows_nothing() {
        let op: Vec<f64> = (0..1000).map(|k| libm::sin(k as f64 * 0.05)).collect();
        let good = (0..40).filter(|seed| {
            let w = whiteness(&noise(*seed, 1000), &op);
            w.white && !w.follows_op && w.inflation < 1.3
        });
        assert!(good.count() >= 38);
    }

    #[test]
    fn colour_and_what_goes_with_op_are_seen() {
        let op = noise(5, 1000);
        let mut slow = noise(6, 1000);
        for k in 1..slow.len() {
            slow[k] += 0.6 * slow[k - 1];
        }
        let w = whiteness(&slow, &op);
        assert!(!w.white && !w.follows_op && (w.r1 - 0.6).abs() < 0.1 && (w.inflation - 4.0).abs() < 1.5, "{w:?}");
        let late: Vec<f64> = (0..1000).map(|k| slow[k] * 0.0 + if k >= 7 { op[k - 7] } else { 0.0 }).collect();
        let left: Vec<f64> = noise(7, 1000).iter().zip(&late).map(|(e, l)| e + 0.2 * l).collect();
        let w = whiteness(&left, &op);
        assert!(w.white && w.follows_op, "{w:?}");
        assert!(whiteness(&[0.0; 100], &op).white);
    }
}
