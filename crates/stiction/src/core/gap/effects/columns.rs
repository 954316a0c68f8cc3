//! What effects add to PV with coefficients that are fitted linearly, one entry a point: the same columns for the free run and for
//! the budget's noise model.

/// A step from an instant (points) on, over `n` points; through a lag (points), or straight.
#[must_use]
pub(crate) fn step(start: f64, lag: Option<f64>, n: usize) -> Vec<f64> {
    let after = (start.ceil().max(0.0) as usize).min(n);
    let decay = lag.map_or(0.0, |tau| libm::exp(-1.0 / tau));
    let mut left = lag.filter(|_| decay > 0.0).map_or(0.0, |tau| libm::exp((start - after as f64) / tau));
    let mut step = vec![0.0; after];
    step.resize_with(n, || {
        let value = 1.0 - left;
        left *= decay;
        value
    });
    step
}

/// A straight rise from an instant (points) on, by 1 over `n` points.
#[must_use]
pub(crate) fn ramp(from: f64, n: usize) -> Vec<f64> {
    (0..n).map(|k| (k as f64 - from).max(0.0) / n as f64).collect()
}

/// Sine and cosine of a frequency (radians a point) over `n` points, by rotation from point to point.
#[must_use]
pub(crate) fn waves(omega: f64, n: usize) -> [Vec<f64>; 2] {
    let (sin, cos) = (libm::sin(omega), libm::cos(omega));
    let (mut s, mut c) = (0.0, 1.0);
    let mut out = [Vec::with_capacity(n), Vec::with_capacity(n)];
    for _ in 0..n {
        out[0].push(s);
        out[1].push(c);
        (s, c) = (s * cos + c * sin, c * cos - s * sin);
    }
    out
}

/// A single wild value.
#[must_use]
pub(crate) fn single(at: usize, n: usize) -> Vec<f64> {
    (0..n).map(|k| f64::from(u8::from(k == at))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_columns_are_what_the_names_say() {
        assert_eq!(step(39.4, None, 50)[39..42], [0.0, 1.0, 1.0]);
        let slow = step(10.0, Some(5.0), 50);
        assert!(slow[10] == 0.0 && (slow[15] - (1.0 - libm::exp(-1.0))).abs() < 1e-12);
        assert!((ramp(40.0, 100)[90] - 0.5).abs() < 1e-12 && ramp(40.0, 100)[40] == 0.0);
        let [sine, cosine] = waves(0.44, 100);
        assert!((sine[99] - libm::sin(43.56)).abs() < 1e-9 && (cosine[99] - libm::cos(43.56)).abs() < 1e-9);
        assert!(single(3, 9)[3] == 1.0 && single(3, 9).iter().sum::<f64>() == 1.0);
    }
}
