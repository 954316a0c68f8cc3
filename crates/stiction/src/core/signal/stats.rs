//! Location, spread and noise of a signal, classical and robust.

/// Standard deviations beyond which [`clipped_sd`] drops a value, and the variance of a unit normal truncated there.
const CLIP: f64 = 2.75;
const LEFT_BY_CLIP: f64 = 0.949_685_6;

/// Arithmetic mean; 0 for an empty slice.
#[must_use]
pub fn mean(x: &[f64]) -> f64 {
    if x.is_empty() { 0.0 } else { x.iter().sum::<f64>() / x.len() as f64 }
}

/// Population variance (divided by n), in squared units of `x`; 0 for an empty slice.
#[must_use]
pub fn variance(x: &[f64]) -> f64 {
    if x.is_empty() {
        return 0.0;
    }
    let m = mean(x);
    x.iter().map(|v| (v - m) * (v - m)).sum::<f64>() / x.len() as f64
}

/// Population standard deviation, units of `x`.
#[must_use]
pub fn std_dev(x: &[f64]) -> f64 {
    variance(x).sqrt()
}

/// Inner product in eight running sums, an order that suits SIMD units.
///
/// Stops at the shorter slice.
#[must_use]
pub fn dot(a: &[f64], b: &[f64]) -> f64 {
    let n = a.len().min(b.len());
    let (a, b) = (&a[..n], &b[..n]);
    let mut sums = [0.0; 8];
    let (blocks_a, rest_a) = a.as_chunks::<8>();
    let (blocks_b, rest_b) = b.as_chunks::<8>();
    for (p, q) in blocks_a.iter().zip(blocks_b) {
        for lane in 0..8 {
            sums[lane] += p[lane] * q[lane];
        }
    }
    let tail: f64 = rest_a.iter().zip(rest_b).map(|(p, q)| p * q).sum();
    ((sums[0] + sums[4]) + (sums[1] + sums[5])) + ((sums[2] + sums[6]) + (sums[3] + sums[7])) + tail
}

/// Sum in eight running sums.
#[must_use]
pub(crate) fn sum(x: &[f64]) -> f64 {
    let mut sums = [0.0; 8];
    let (blocks, rest) = x.as_chunks::<8>();
    for block in blocks {
        for lane in 0..8 {
            sums[lane] += block[lane];
        }
    }
    let tail: f64 = rest.iter().sum();
    ((sums[0] + sums[4]) + (sums[1] + sums[5])) + ((sums[2] + sums[6]) + (sums[3] + sums[7])) + tail
}

/// Inner products of `a` with three others at once, in four running sums each; all of the length of `a` or longer.
#[must_use]
pub(crate) fn dot3(a: &[f64], b: [&[f64]; 3]) -> [f64; 3] {
    let n = b.iter().fold(a.len(), |n, x| n.min(x.len()));
    let (blocks_a, rest_a) = a[..n].as_chunks::<4>();
    let [(b0, r0), (b1, r1), (b2, r2)] = b.map(|x| x[..n].as_chunks::<4>());
    let (mut s0, mut s1, mut s2) = ([0.0; 4], [0.0; 4], [0.0; 4]);
    for (((p, x), y), z) in blocks_a.iter().zip(b0).zip(b1).zip(b2) {
        for lane in 0..4 {
            s0[lane] += p[lane] * x[lane];
            s1[lane] += p[lane] * y[lane];
            s2[lane] += p[lane] * z[lane];
        }
    }
    let tail = |r: &[f64]| rest_a.iter().zip(r).map(|(p, q)| p * q).sum::<f64>();
    let sum = |s: [f64; 4]| (s[0] + s[2]) + (s[1] + s[3]);
    [sum(s0) + tail(r0), sum(s1) + tail(r1), sum(s2) + tail(r2)]
}

/// Quantile `q` (0..1) of sorted values, linear between neighbours (Hyndman and Fan's type 7); 0 for an empty slice.
#[must_use]
pub(crate) fn quantile_sorted(sorted: &[f64], q: f64) -> f64 {
    let Some(last) = sorted.len().checked_sub(1) else { return 0.0 };
    let place = q.clamp(0.0, 1.0) * last as f64;
    let below = place.floor() as usize;
    let above = (below + 1).min(last);
    sorted[below] + (place - below as f64) * (sorted[above] - sorted[below])
}

/// The values in ascending order.
#[must_use]
pub fn sorted(x: &[f64]) -> Vec<f64> {
    let mut copy = x.to_vec();
    copy.sort_by(f64::total_cmp);
    copy
}

/// Quantile `q` (0..1) of unsorted values, as `quantile_sorted`.
#[must_use]
pub fn quantile(x: &[f64], q: f64) -> f64 {
    let Some(last) = x.len().checked_sub(1) else { return 0.0 };
    let place = q.clamp(0.0, 1.0) * last as f64;
    let below = place.floor() as usize;
    let (mut work, share) = (Vec::new(), place - below as f64);
    let low = nth(x, below, &mut work);
    if below == last { low } else { low + share * (nth(x, below + 1, &mut work) - low) }
}

/// The value at position `place` (from 0, below the number of values) in ascending order; `work` is work space.
///
/// Values at regular distances bracket it, and only values within the bracket are sorted.
#[must_use]
pub(crate) fn nth(x: &[f64], place: usize, work: &mut Vec<f64>) -> f64 {
    const SAMPLE: usize = 64;
    const TO_EITHER_SIDE: usize = 8;
    work.clear();
    if x.len() < 4 * SAMPLE {
        work.extend_from_slice(x);
        return *work.select_nth_unstable_by(place, f64::total_cmp).1;
    }
    work.extend(x.iter().step_by(x.len() / SAMPLE));
    work.sort_unstable_by(f64::total_cmp);
    let near = place * work.len() / x.len();
    let low = near.checked_sub(TO_EITHER_SIDE).map_or(f64::NEG_INFINITY, |at| work[at]);
    let high = work.get(near + TO_EITHER_SIDE).copied().unwrap_or(f64::INFINITY);
    work.clear();
    work.resize(x.len(), 0.0);
    let (mut below, mut between) = (0, 0);
    for v in x {
        work[between] = *v;
        between += usize::from(*v >= low && *v <= high);
        below += usize::from(*v < low);
    }
    work.truncate(between);
    if place < below || place - below >= between {
        work.clear();
        work.extend_from_slice(x);
        below = 0;
    }
    *work.select_nth_unstable_by(place - below, f64::total_cmp).1
}

/// Median; 0 for an empty slice.
#[must_use]
pub fn median(x: &[f64]) -> f64 {
    quantile(x, 0.5)
}

/// Median absolute deviation from the median, units of `x` (times 1.4826 it estimates a normal's deviation).
#[must_use]
pub fn mad(x: &[f64]) -> f64 {
    let m = median(x);
    median(&x.iter().map(|v| (v - m).abs()).collect::<Vec<_>>())
}

/// Robust span: from the 0.5 to the 99.5 percentile, units of `x`.
#[must_use]
pub fn span(x: &[f64]) -> f64 {
    quantile(x, 0.995) - quantile(x, 0.005)
}

/// Standard deviation of the white part of a signal: 1.4826 MAD of its second differences over sqrt(6), which smooth trends
/// and rare jumps do not affect. 0 for fewer than 3 values, and for held or coarsely rounded signals.
#[must_use]
pub fn noise_sd(x: &[f64]) -> f64 {
    let second: Vec<f64> = second_differences(x).collect();
    1.4826 * mad(&second) / 6.0_f64.sqrt()
}

/// `x[k + 1] - 2 x[k] + x[k - 1]`, units of `x`; for white noise sqrt(6) times its standard deviation.
pub(crate) fn second_differences(x: &[f64]) -> impl Iterator<Item = f64> {
    x.windows(3).map(|w| w[2] - 2.0 * w[1] + w[0])
}

/// Standard deviation of the normal part of `x` around zero, units of `x`: values beyond [`CLIP`] standard deviations are
/// dropped until none is left, starting from the median's. It varies a quarter less between records than 1.4826 MAD, and is
/// less affected by rare outliers. 0 if the MAD is 0.
#[must_use]
pub(crate) fn clipped_sd(x: &[f64]) -> f64 {
    const ROUNDS: usize = 10;
    let mut sd = 1.4826 * mad(x);
    for _ in 0..ROUNDS {
        let (count, sum) =
            x.iter().filter(|v| v.abs() <= CLIP * sd).fold((0_usize, 0.0), |(count, sum), v| (count + 1, sum + v * v));
        if count == 0 {
            break;
        }
        sd = (sum / count as f64 / LEFT_BY_CLIP).sqrt();
    }
    sd
}

/// Share of values equal to their predecessor, 0..1.
#[must_use]
pub(crate) fn repeat_share(x: &[f64]) -> f64 {
    let pairs = x.len().saturating_sub(1).max(1);
    x.windows(2).filter(|w| w[0] == w[1]).count() as f64 / pairs as f64
}

/// Number of different values, up to `limit`.
#[must_use]
pub(crate) fn levels(x: &[f64], limit: usize) -> usize {
    // Most signals soon show many values.
    let soon = x.len().min(limit.saturating_mul(2));
    let count = different(&x[..soon], limit);
    if count >= limit || soon == x.len() { count } else { different(x, limit) }
}

fn different(x: &[f64], limit: usize) -> usize {
    let mut s = x.to_vec();
    s.sort_unstable_by(f64::total_cmp);
    let count = usize::from(!s.is_empty()) + s.windows(2).filter(|w| w[0] != w[1]).count();
    count.min(limit)
}

/// Autocorrelation of a zero-mean signal at lag one, -1..1; 0 for an empty slice.
#[must_use]
pub(crate) fn autocorrelation_1(x: &[f64]) -> f64 {
    let whole = dot(x, x);
    if whole > 0.0 { x.windows(2).map(|w| w[0] * w[1]).sum::<f64>() / whole } else { 0.0 }
}

/// Number of reversals of a signal by more than `band`.
#[must_use]
pub fn turns(x: &[f64], band: f64) -> usize {
    let (mut high, mut low, mut rising, mut count) = (f64::NEG_INFINITY, f64::INFINITY, None, 0);
    for &u in x {
        high = high.max(u);
        low = low.min(u);
        if rising != Some(false) && u < high - band {
            count += usize::from(rising.is_some());
            (rising, low) = (Some(false), u);
        } else if rising != Some(true) && u > low + band {
            count += usize::from(rising.is_some());
            (rising, high) = (Some(true), u);
        }
    }
    count
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_lie_between_neighbours() {
        let x = [4.0, 1.0, 3.0, 2.0];
        assert_eq!(median(&x), 2.5);
        assert_eq!(quantile(&x, 0.0), 1.0);
        assert_eq!(quantile(&x, 1.0), 4.0);
        assert_eq!(median(&[]), 0.0);
        assert_eq!(mad(&[1.0, 2.0, 3.0, 4.0, 100.0]), 1.0);
    }

    #[test]
    fn the_nth_value_is_found_without_sorting() {
        for seed in 0..40_u64 {
            let mut noise = crate::core::sim::noise::Noise::new(seed, 0);
            let step = f64::from(seed as u8 % 4);
            let x: Vec<f64> =
                (0..400 + 13 * seed as usize)
                    .map(|k| {
                        if step > 0.0 { (noise.gaussian() * step).round() } else { noise.gaussian() + (k / 300) as f64 }
                    })
                    .collect();
            let s = sorted(&x);
            let mut work = Vec::new();
            for place in (0..x.len()).step_by(7).chain([x.len() - 1]) {
                assert_eq!(nth(&x, place, &mut work), s[place]);
            }
            for q in [0.0, 0.005, 0.3, 0.5, 0.995, 1.0] {
                assert_eq!(quantile(&x, q), quantile_sorted(&s, q));
            }
        }
    }

    #[test]
    fn a_clipped_deviation_is_that_of_the_normal_part() {
        let mut noise = crate::core::sim::noise::Noise::new(3, 0);
        let mut x: Vec<f64> = (0..20_000).map(|_| 0.7 * noise.gaussian()).collect();
        assert!((clipped_sd(&x) / 0.7 - 1.0).abs() < 0.02, "{}", clipped_sd(&x));
        x.iter_mut().step_by(50).for_each(|v| *v = 30.0);
        assert!((clipped_sd(&x) / 0.7 - 1.0).abs() < 0.03, "{}", clipped_sd(&x));
        assert_eq!(clipped_sd(&[0.0, 0.0, 0.0, 0.0, 5.0]), 0.0);
        assert_eq!(clipped_sd(&[]), 0.0);
    }

    #[test]
    fn one_spike_leaves_the_span() {
        let mut x: Vec<f64> = (0..1000).map(|k| f64::from(k % 100)).collect();
        x[500] = 1e6;
        assert!((span(&x) - 99.0).abs() < 1.0);
    }

    #[test]
    fn noise_is_seen_through_a_ramp() {
        // A fixed +-1 pattern without structure: the low bit of squares modulo a prime.
        let x: Vec<f64> =
            (0_u64..4000).map(|k| k as f64 * 0.3 + (((k * k * k) % 8191) as f64 / 8191.0 - 0.5)).collect();
        assert!((noise_sd(&x) - (1.0_f64 / 12.0).sqrt()).abs() < 0.06, "{}", noise_sd(&x));
    }

    #[test]
    fn dot_agrees_with_the_plain_sum() {
        let a: Vec<f64> = (0..37).map(f64::from).collect();
        assert_eq!(dot(&a, &a), a.iter().map(|v| v * v).sum::<f64>());
        assert_eq!(dot3(&a, [&a, &a[..36], &a])[0], a[..36].iter().map(|v| v * v).sum::<f64>());
        assert_eq!(levels(&[1.0, 2.0, 1.0, 2.0], 10), 2);
        assert_eq!(repeat_share(&[1.0, 1.0, 2.0]), 0.5);
    }
}
