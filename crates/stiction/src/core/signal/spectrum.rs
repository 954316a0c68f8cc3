//! Second-order structure of a signal: autocorrelation and where it crosses zero.

use std::sync::{Arc, LazyLock};

use super::stats::dot;

/// Autocorrelations of two zero-mean signals at lags `0..=max_lag`, biased (divided by n), 1 at lag 0; empty if a signal is
/// constant. One transform gives both (Cooley and Tukey 1965). It is bit-identical on every machine: its twiddle factors
/// are computed here and its sums have a fixed order.
#[must_use]
pub(crate) fn autocorrelations(x: [&[f64]; 2], max_lag: usize) -> [Vec<f64>; 2] {
    let longest = x[0].len().max(x[1].len());
    let lags = max_lag.min(longest.saturating_sub(1)) + 1;
    // Zero padding by the number of lags keeps the end of a signal from overlapping its beginning.
    let [mut re, mut im] = powers(x, (longest + lags).next_power_of_two().max(2));
    transform(&mut re, &mut im);
    let of = |sums: &[f64], x: &[f64]| match dot(x, x) > 0.0 {
        true => sums[..lags.min(x.len())].iter().map(|sum| sum / sums[0]).collect(),
        false => Vec::new(),
    };
    [of(&re, x[0]), of(&im, x[1])]
}

/// Power of two signals at the frequencies `k / size` cycles per point, each padded with zeros to `size` (a power of two, at
/// least the length of both); one transform gives both.
#[must_use]
pub(crate) fn powers(x: [&[f64]; 2], size: usize) -> [Vec<f64>; 2] {
    let padded = |x: &[f64]| {
        let mut padded = x.to_vec();
        padded.resize(size, 0.0);
        padded
    };
    let (mut re, mut im) = (padded(x[0]), padded(x[1]));
    transform(&mut re, &mut im);
    // Put the first signal's power in the real part and the second's in the imaginary part: both are even, so their transforms
    // are real.
    for k in 0..=size / 2 {
        let back = (size - k) % size;
        let (a, b) = ([re[k] + re[back], im[k] - im[back]], [im[k] + im[back], re[back] - re[k]]);
        let power = |z: [f64; 2]| 0.25 * (z[0] * z[0] + z[1] * z[1]);
        (re[k], im[k]) = (power(a), power(b));
        (re[back], im[back]) = (re[k], im[k]);
    }
    [re, im]
}

/// Twiddle factors of all stages: those of a stage of `2 h` values are at `h` to `2 h`.
fn turns(size: usize) -> Arc<[Vec<f64>; 2]> {
    static SHORT: LazyLock<Arc<[Vec<f64>; 2]>> = LazyLock::new(|| Arc::new(made(SHORT_SIZE)));
    if size <= SHORT_SIZE { Arc::clone(&SHORT) } else { Arc::new(made(size)) }
}

/// Largest size with cached twiddle factors.
const SHORT_SIZE: usize = 4096;

fn made(size: usize) -> [Vec<f64>; 2] {
    let (mut cosine, mut sine) = (vec![1.0; size], vec![0.0; size]);
    let mut half = 1;
    while half < size {
        for j in 0..half {
            let angle = -core::f64::consts::PI * j as f64 / half as f64;
            (cosine[half + j], sine[half + j]) = (libm::cos(angle), libm::sin(angle));
        }
        half *= 2;
    }
    [cosine, sine]
}

/// In-place discrete Fourier transform; the length is a power of two.
fn transform(re: &mut [f64], im: &mut [f64]) {
    let size = re.len();
    let turns = turns(size);
    let bits = size.trailing_zeros();
    for k in 1..size {
        let other = k.reverse_bits() >> (usize::BITS - bits);
        if k < other {
            re.swap(k, other);
            im.swap(k, other);
        }
    }
    let mut half = 1;
    while half < size {
        let (cosine, sine) = (&turns[0][half..2 * half], &turns[1][half..2 * half]);
        for (re, im) in re.chunks_exact_mut(2 * half).zip(im.chunks_exact_mut(2 * half)) {
            let ((re_a, re_b), (im_a, im_b)) = (re.split_at_mut(half), im.split_at_mut(half));
            let both = re_a.iter_mut().zip(re_b).zip(im_a.iter_mut().zip(im_b));
            for (((ra, rb), (ia, ib)), (c, s)) in both.zip(cosine.iter().zip(sine)) {
                let (r, i) = (*rb * c - *ib * s, *rb * s + *ib * c);
                (*rb, *ib) = (*ra - r, *ia - i);
                (*ra, *ia) = (*ra + r, *ia + i);
            }
        }
        half *= 2;
    }
}

/// Positions (fractions of a sample) of sign changes of `x`. A change counts once `x` has left a band of `+-hysteresis` on the
/// other side; its position is interpolated at the last sign change before.
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

/// Splits `x` into bands that add up to it: one below each edge (ascending, cycles per point, at most 0.5), and the rest above
/// the last.
///
/// A cosine transform (of `x` and its mirror image, so that the ends match) with sharp edges. The cost is the length times
/// the number of frequencies below the last edge.
#[must_use]
pub(crate) fn split(x: &[f64], edges: &[f64]) -> Vec<Vec<f64>> {
    let n = x.len();
    let mut bands = vec![vec![0.0; n]; edges.len()];
    let turn = 4 * n;
    // cos(2 pi i / 4n) for all angles of the transform.
    let table: Vec<f64> = (0..turn).map(|i| libm::cos(core::f64::consts::PI * i as f64 / (2 * n) as f64)).collect();
    let mut index = 0;
    for (band, edge) in bands.iter_mut().zip(edges) {
        // Frequency `index` is index / 2n cycles per point.
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

    fn autocorrelation(x: &[f64], max_lag: usize) -> Vec<f64> {
        let [found, _] = autocorrelations([x, &[]], max_lag);
        found
    }

    #[test]
    fn a_sine_correlates_with_itself_a_period_later() {
        let acf = autocorrelation(&sine(2000, 50.0), 100);
        assert!((acf[0] - 1.0).abs() < 1e-12 && acf[50] > 0.95 && acf[25] < -0.95);
        assert!(autocorrelation(&[0.0; 20], 5).is_empty());
        let x = [1.0, -2.0, 4.0, 3.0];
        let plain: Vec<f64> = (0..4).map(|l| (l..4).map(|k| x[k] * x[k - l]).sum::<f64>() / 30.0).collect();
        let found = autocorrelation(&x, 9);
        let both = autocorrelations([&x, &sine(9, 3.0)], 9);
        // A longer partner makes the transform longer, so rounding differs.
        let apart = both[0].iter().zip(&found).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(both[0].len() == found.len() && apart < 1e-12 && both[1].len() == 9, "{both:?}");
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
