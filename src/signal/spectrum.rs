//! Second-order structure of a signal: autocorrelation and where it crosses zero.

use super::stats::{dot, dot3};

/// Autocorrelation of a zero-mean signal at lags `0..=max_lag`, biased (divided by n), 1 at lag 0.
///
/// Direct sums: for the sizes here they cost less than a transform and come out the same on every machine. Empty when
/// the signal is constant.
#[must_use]
pub fn autocorrelation(x: &[f64], max_lag: usize) -> Vec<f64> {
    let mut all = Autocorrelation::new(x, max_lag);
    all.reach(max_lag);
    all.acf
}

/// An autocorrelation that grows as far as it is asked for.
#[derive(Debug, Clone)]
pub struct Autocorrelation<'a> {
    x: &'a [f64],
    power: f64,
    last: usize,
    acf: Vec<f64>,
}

impl<'a> Autocorrelation<'a> {
    /// Of a zero-mean signal, for lags up to `max_lag`; for none where it is constant.
    #[must_use]
    pub fn new(x: &'a [f64], max_lag: usize) -> Self {
        Self { x, power: dot(x, x), last: max_lag.min(x.len().saturating_sub(1)), acf: Vec::new() }
    }

    /// Makes it known up to `lag` at least, as far as there are lags.
    pub fn reach(&mut self, lag: usize) {
        if self.power.is_nan() || self.power <= 0.0 {
            return;
        }
        let x = self.x;
        while self.acf.len() <= lag.min(self.last) {
            // Three lags at once over what they share, then the one or two products more of the shorter lags.
            let from = self.acf.len();
            let shared = x.len().saturating_sub(from + 2);
            let later = |by: usize| &x[(from + by).min(x.len())..];
            let sums = dot3(&x[..shared], [later(0), later(1), later(2)]);
            for (by, sum) in sums.into_iter().enumerate().take(self.last + 1 - from) {
                let rest = &x[shared..];
                let moved = later(by).get(shared..).unwrap_or(&[]);
                self.acf.push((sum + dot(rest, moved)) / self.power);
            }
        }
    }

    /// Makes it known until `enough` holds of what is known, or to its end.
    pub fn reach_until(&mut self, mut enough: impl FnMut(&[f64]) -> bool) {
        let step = (self.last / 12).max(24);
        let mut lag = 0;
        loop {
            lag += step;
            self.reach(lag);
            if lag >= self.last || self.acf.is_empty() || enough(&self.acf) {
                return;
            }
        }
    }

    /// What is known of it, from lag 0 on.
    #[must_use]
    pub fn known(&self) -> &[f64] {
        &self.acf
    }
}

/// Places (fractions of a sample) where `x` changes sign, counting a change only once `x` has left a band of
/// `+-hysteresis` on the other side; the place is interpolated at the last change of sign before.
#[must_use]
pub fn zero_crossings(x: &[f64], hysteresis: f64) -> Vec<f64> {
    let mut places = Vec::new();
    let mut side = 0.0_f64;
    let mut last_change = None;
    for (k, &v) in x.iter().enumerate() {
        if k > 0 && (x[k - 1] < 0.0) != (v < 0.0) {
            last_change = Some(k as f64 - v / (v - x[k - 1]));
        }
        if v.abs() > hysteresis {
            let now = v.signum();
            if side != 0.0 && now != side {
                places.extend(last_change);
            }
            side = now;
        }
    }
    places
}

/// Splits `x` into bands that add up to it again: one below each edge (rising, cycles a point, at most 0.5), and the
/// rest above the last.
///
/// A cosine transform (of `x` and its mirror image, so that the ends meet) cut sharply at the edges. The cost is the
/// length times the number of frequencies below the last edge.
#[must_use]
pub fn split(x: &[f64], edges: &[f64]) -> Vec<Vec<f64>> {
    let n = x.len();
    let mut bands = vec![vec![0.0; n]; edges.len()];
    let turn = 4 * n;
    // cos(2 pi i / 4n), all that the transform needs.
    let table: Vec<f64> = (0..turn).map(|i| libm::cos(core::f64::consts::PI * i as f64 / (2 * n) as f64)).collect();
    let mut index = 0;
    for (band, edge) in bands.iter_mut().zip(edges) {
        // Frequency `index` is index / 2n cycles a point.
        while index < n && (index as f64) < edge * (2 * n) as f64 {
            let angle = |j: usize| table[(index * (2 * j + 1)) % turn];
            let sum: f64 = x.iter().enumerate().map(|(j, v)| v * angle(j)).sum();
            let weight = if index == 0 { 1.0 } else { 2.0 } * sum / n as f64;
            band.iter_mut().enumerate().for_each(|(j, v)| *v += weight * angle(j));
            index += 1;
        }
    }
    let rest = (0..n).map(|j| x[j] - bands.iter().map(|b| b[j]).sum::<f64>()).collect();
    bands.push(rest);
    bands
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sine(n: usize, period: f64) -> Vec<f64> {
        (0..n).map(|k| libm::sin(2.0 * core::f64::consts::PI * (k as f64 + 0.3) / period)).collect()
    }

    #[test]
    fn a_sine_correlates_with_itself_a_period_later() {
        let acf = autocorrelation(&sine(2000, 50.0), 100);
        assert!((acf[0] - 1.0).abs() < 1e-12 && acf[50] > 0.95 && acf[25] < -0.95);
        assert!(autocorrelation(&[0.0; 20], 5).is_empty());
        let x = [1.0, -2.0, 4.0, 3.0];
        let plain: Vec<f64> = (0..4).map(|l| (l..4).map(|k| x[k] * x[k - l]).sum::<f64>() / 30.0).collect();
        let found = autocorrelation(&x, 9);
        assert!(found.len() == 4 && found.iter().zip(plain).all(|(a, b)| (a - b).abs() < 1e-15), "{found:?}");
    }

    #[test]
    fn crossings_are_half_a_period_apart_and_ripple_is_ignored() {
        let mut x = sine(400, 40.0);
        for (k, v) in x.iter_mut().enumerate() {
            *v += if k % 2 == 0 { 0.05 } else { -0.05 };
        }
        let places = zero_crossings(&x, 0.2);
        assert!(places.windows(2).all(|w| (w[1] - w[0] - 20.0).abs() < 1.5), "{places:?}");
    }

    #[test]
    fn bands_add_up_and_hold_what_belongs_to_them() {
        let (slow, fast) = (sine(900, 90.0), sine(900, 9.0));
        let x: Vec<f64> = slow.iter().zip(&fast).map(|(a, b)| 5.0 + a + 0.5 * b).collect();
        let bands = split(&x, &[0.002, 0.03, 0.2]);
        assert_eq!(bands.len(), 4);
        for k in 0..900 {
            assert!((bands.iter().map(|b| b[k]).sum::<f64>() - x[k]).abs() < 1e-9);
        }
        let error = |band: &[f64], want: &[f64], size: f64| {
            let e: Vec<f64> = band[90..810].iter().zip(&want[90..810]).map(|(b, w)| b - size * w).collect();
            dot(&e, &e) / dot(&want[90..810], &want[90..810]) / (size * size)
        };
        assert!(error(&bands[1], &slow, 1.0) < 0.02 && error(&bands[2], &fast, 0.5) < 0.02);
        assert!(split(&[], &[0.1]).iter().all(Vec::is_empty));
    }
}
