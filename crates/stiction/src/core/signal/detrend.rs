//! Removal of slow components: the mean, a line, a moving average.

/// `x` minus its mean.
#[must_use]
pub fn remove_mean(x: &[f64]) -> Vec<f64> {
    let m = super::stats::mean(x);
    x.iter().map(|v| v - m).collect()
}

/// `x` minus its least-squares line.
#[must_use]
pub fn remove_line(x: &[f64]) -> Vec<f64> {
    let n = x.len() as f64;
    let middle = 0.5 * (n - 1.0);
    let m = super::stats::mean(x);
    let (mut sxy, mut sxx) = (0.0, 0.0);
    for (k, v) in x.iter().enumerate() {
        let t = k as f64 - middle;
        sxy += t * (v - m);
        sxx += t * t;
    }
    let slope = if sxx > 0.0 { sxy / sxx } else { 0.0 };
    x.iter().enumerate().map(|(k, v)| v - m - slope * (k as f64 - middle)).collect()
}

/// Centred moving average over `width` points (made odd), with the end values repeated; same length as `x`.
#[must_use]
pub(crate) fn moving_average(x: &[f64], width: usize) -> Vec<f64> {
    let half = width / 2;
    if half == 0 || x.is_empty() {
        return x.to_vec();
    }
    let last = x.len() - 1;
    let at = |k: isize| x[k.clamp(0, last as isize) as usize];
    let h = half as isize;
    let mut sum: f64 = (-h..=h).map(at).sum();
    let scale = 1.0 / (2 * half + 1) as f64;
    (0..x.len() as isize)
        .map(|k| {
            let value = sum * scale;
            sum += at(k + h + 1) - at(k - h);
            value
        })
        .collect()
}

/// `x` minus its centred moving average over `width` points: removes components slower than about two widths.
#[must_use]
pub(crate) fn high_pass(x: &[f64], width: usize) -> Vec<f64> {
    moving_average(x, width).iter().zip(x).map(|(slow, v)| v - slow).collect()
}

/// `x` smoothed by a Hann window about `width` points wide, with the end values repeated; same length as `x`.
#[must_use]
pub(crate) fn hann_smooth(x: &[f64], width: usize) -> Vec<f64> {
    if width < 2 || x.is_empty() {
        return x.to_vec();
    }
    let half = width as isize / 2;
    let weight = |k: isize| 0.5 + 0.5 * libm::cos(core::f64::consts::PI * k as f64 / (half + 1) as f64);
    let weights: Vec<f64> = (-half..=half).map(weight).collect();
    let total: f64 = weights.iter().sum();
    let last = x.len() as isize - 1;
    (0..=last)
        .map(|at| {
            let around = (-half..=half).zip(&weights);
            around.map(|(k, w)| w * x[(at + k).clamp(0, last) as usize]).sum::<f64>() / total
        })
        .collect()
}

/// Means of bins of `k` values; an incomplete last bin is dropped.
#[must_use]
pub fn box_means(x: &[f64], k: usize) -> Vec<f64> {
    if k <= 1 { x.to_vec() } else { x.chunks_exact(k).map(super::stats::mean).collect() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_is_removed_whole() {
        let x: Vec<f64> = (0..50).map(|k| 3.0 - 0.2 * f64::from(k)).collect();
        assert!(remove_line(&x).iter().all(|v| v.abs() < 1e-12));
        assert!(remove_line(&[]).is_empty());
    }

    #[test]
    fn the_moving_average_keeps_constants_and_length() {
        assert_eq!(moving_average(&[2.0; 9], 5), vec![2.0; 9]);
        let x = [0.0, 3.0, 0.0, 3.0, 0.0];
        assert_eq!(moving_average(&x, 3)[2], 2.0);
        assert_eq!(high_pass(&x, 1), vec![0.0; 5]);
        assert_eq!(box_means(&x, 2), vec![1.5, 1.5]);
    }
}
