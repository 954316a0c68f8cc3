//! A loop's phase in a few numbers, which rule out most unrelated pairs before the full comparison.

use super::cycle::{Cycle, length, phasor};
use crate::core::signal::stats::median;

/// Largest amplitude of a frame, in medians of the loop's frames.
const LARGEST: f64 = 2.0;
/// Fewest common frames for a comparison.
const LEAST_FRAMES: usize = 3;
/// Values summed in parallel.
const LANES: usize = 8;

/// Complex amplitude of a cycle at the multiples of a time step, s, which is the power of two between half a period and a
/// period: loops of nearly the same period have frames at the same times.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Sketch {
    /// Binary logarithm of the time between frames, s.
    octave: i32,
    /// Index of the first frame, relative to the plant's epoch.
    first: i64,
    /// Real parts, imaginary parts and absolute values, in medians of the absolute values.
    frames: [Vec<f32>; 3],
}

impl Sketch {
    pub fn of(cycle: &Cycle) -> Self {
        let (frequency, period) = (cycle.frequency_hz, cycle.period_s());
        let octave = libm::ilogb(period);
        let hop = libm::scalbn(1.0, octave);
        let frame_s = super::pair::frame_periods(cycle.end_s() - cycle.start_s, period) * period;
        let first = ((cycle.start_s + frame_s / 2.0) / hop).ceil() as i64;
        let last = ((cycle.end_s() - frame_s / 2.0) / hop).floor() as i64;
        let centres: Vec<f64> = (first..=last).map(|k| k as f64 * hop).collect();
        let amplitudes = cycle.demodulated(frequency, &centres, frame_s);
        let sizes: Vec<f64> = amplitudes.iter().map(|z| length(*z)).collect();
        let scale = median(&sizes).max(f64::MIN_POSITIVE);
        let mut frames = [const { Vec::new() }; 3];
        for ((z, size), centre) in amplitudes.iter().zip(&sizes).zip(&centres) {
            let cycles = frequency * centre;
            let limited = (size / scale).min(LARGEST);
            let z = z * phasor(cycles - cycles.floor()) * (limited / size.max(f64::MIN_POSITIVE));
            for (kept, value) in frames.iter_mut().zip([z.re, z.im, limited]) {
                kept.push(value as f32);
            }
        }
        Self { octave, first, frames }
    }

    fn count(&self) -> usize {
        self.frames[0].len()
    }

    /// Stability of the phase difference of two loops, 0 to 1; `None` if they have too few common frames.
    pub fn agreement(&self, other: &Self) -> Option<f32> {
        let (fine, coarse) = if self.octave <= other.octave { (self, other) } else { (other, self) };
        let step = 1_usize.checked_shl(fine.octave.abs_diff(coarse.octave)).unwrap_or(usize::MAX);
        let ratio = step as i64;
        // Indices of the common frames, in steps of the coarser sketch.
        let from = coarse.first.max(fine.first.div_euclid(ratio) + i64::from(fine.first.rem_euclid(ratio) > 0));
        let end_of_fine = (fine.first + fine.count() as i64 - 1).div_euclid(ratio) + 1;
        let count = usize::try_from(end_of_fine.min(coarse.first + coarse.count() as i64) - from).unwrap_or(0);
        if count < LEAST_FRAMES {
            return None;
        }
        let a = fine.frames.each_ref().map(|x| &x[(from * ratio - fine.first) as usize..]);
        let b = coarse.frames.each_ref().map(|x| &x[(from - coarse.first) as usize..][..count]);
        let [re, im, all] = if step == 1 { sums(a.map(|x| &x[..count]), b) } else { sums_apart(a, step, b) };
        Some((re * re + im * im).sqrt() / all.max(f32::MIN_POSITIVE))
    }
}

/// Sums of the products of one loop's frames with the conjugate frames of another, real and imaginary, and of their absolute
/// values.
fn sums(a: [&[f32]; 3], b: [&[f32]; 3]) -> [f32; 3] {
    let n = a[0].len();
    let mut lanes = [[0.0_f32; LANES]; 3];
    let whole = n - n % LANES;
    for k in (0..whole).step_by(LANES) {
        let [ar, ai, az] = a.map(|x| &x[k..k + LANES]);
        let [br, bi, bz] = b.map(|x| &x[k..k + LANES]);
        for lane in 0..LANES {
            lanes[0][lane] += ar[lane] * br[lane] + ai[lane] * bi[lane];
            lanes[1][lane] += ai[lane] * br[lane] - ar[lane] * bi[lane];
            lanes[2][lane] += az[lane] * bz[lane];
        }
    }
    let rest = sums_apart(a.map(|x| &x[whole..]), 1, b.map(|x| &x[whole..]));
    core::array::from_fn(|k| lanes[k].iter().sum::<f32>() + rest[k])
}

/// The same if only every `step`-th frame of the first loop has a partner.
fn sums_apart(a: [&[f32]; 3], step: usize, b: [&[f32]; 3]) -> [f32; 3] {
    let mut sums = [0.0; 3];
    for (k, at) in (0..b[0].len()).map(|k| (k, k * step)) {
        sums[0] += a[0][at] * b[0][k] + a[1][at] * b[1][k];
        sums[1] += a[1][at] * b[0][k] - a[0][at] * b[1][k];
        sums[2] += a[2][at] * b[2][k];
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::record::Record;

    fn cycle(period: f64, phase: f64, from: f64, n: usize) -> Cycle {
        let pv = (0..n).map(|k| libm::sin(2.0 * core::f64::consts::PI * (k as f64 + from) / period + phase)).collect();
        Cycle { start_s: from, ..Cycle::of(&Record::uniform(1.0, vec![50.0; n], pv), 0).unwrap() }
    }

    #[test]
    fn a_constant_difference_agrees_across_windows_and_octaves_and_a_turning_one_does_not() {
        // 128 s is between the periods of the second pair.
        for [a, b] in [[100.0, 100.0], [127.9, 128.1]] {
            let [one, two] = [cycle(a, 0.0, 0.0, 2000), cycle(b, 1.0, 300.0, 1900)].map(|c| Sketch::of(&c));
            assert!(one.agreement(&two).unwrap() > 0.99, "{a} {b} {:?}", one.agreement(&two));
            assert_eq!(one.agreement(&two), two.agreement(&one));
        }
        let [one, two] = [cycle(123.0, 0.0, 0.0, 2000), cycle(132.0, 1.0, 0.0, 2000)].map(|c| Sketch::of(&c));
        assert!(one.agreement(&two).unwrap() < 0.3, "{:?}", one.agreement(&two));
    }

    #[test]
    fn windows_with_too_little_in_common_say_nothing() {
        let [one, two] = [cycle(100.0, 0.0, 0.0, 1000), cycle(100.0, 0.0, 900.0, 1000)].map(|c| Sketch::of(&c));
        assert_eq!(one.agreement(&two), None);
    }
}
