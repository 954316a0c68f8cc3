//! Phase-coherent lines: the frequency that, with its harmonics, best predicts the part of PV that its past does not.

use core::f64::consts::PI;

use super::known::{Ends, Known, SAYS, log_ratio};
use super::ringing::{HARMONICS, harmonics, strongest};
use crate::core::signal::detrend;

/// Fewest periods for a line, search range around the strongest line in bins of the spectrum, and steps per bin.
const PERIODS: f64 = 2.0;
const REACH: i32 = 8;
const STEPS_PER_BIN: f64 = 10.0;
/// Columns for the lines of one frequency.
const COLUMNS: usize = 2 * HARMONICS;
/// Bins after which a rotating line is recomputed, so that rounding errors do not accumulate.
const FRESH: usize = 64;

/// Frequency of the strongest line of a signal in bins, cycles per bin.
pub(super) fn around(signal: &[f64]) -> f64 {
    strongest(&detrend::remove_line(signal), [(PERIODS + 1.0) / signal.len() as f64, 0.45])
}

/// The prior model with the lines that predict most, with a frequency near one of `near`.
pub(super) fn with_best(known: Known, near: [f64; 2]) -> Known {
    let n = known.pv.len() as f64;
    let mut best = (known.error(), None);
    let mut work = Normal::default();
    for around in near {
        for step in -REACH..=REACH {
            let f = around + f64::from(step) / (STEPS_PER_BIN * n);
            if f <= PERIODS / n {
                continue;
            }
            let error = work.error(&known, f);
            if error < best.0 {
                best = (error, Some(f));
            }
        }
    }
    match best.1 {
        Some(f) => known.with_lines(f),
        None => known,
    }
}

/// The normal equations of lines in addition to the prior model.
#[derive(Default)]
struct Normal {
    past: Vec<[f64; 2]>,
    shares: Vec<f64>,
}

impl Normal {
    /// Squared error with a line of frequency `f` and its harmonics.
    fn error(&mut self, known: &Known, f: f64) -> f64 {
        let (from, n) = (known.from, known.pv.len());
        let lines = harmonics(f).len();
        let count = 2 * lines;
        let transforms = transforms(f, from, [&known.pv[from - 1..n - 1], &known.left]);
        let sums: Vec<[f64; 2]> = (0..=2 * lines).map(|m| turns(2.0 * PI * f * m as f64, from, n)).collect();
        let mut gram = gram(&sums, lines);
        let wholes: Vec<f64> = (0..count).map(|i| gram[i][i]).collect();
        self.shares.clear();
        self.shares.resize(known.count() * count, 0.0);
        for line in 0..lines {
            let ends = Ends::of(f * (line + 1) as f64, from, n);
            known.past_with_line(sums[line + 1], transforms[0][line], ends, &mut self.past);
            for (row, product) in self.shares.chunks_exact_mut(count).zip(&self.past) {
                (row[2 * line], row[2 * line + 1]) = (product[0], product[1]);
            }
        }
        known.orthonormal(&mut self.shares, count);
        for row in self.shares.chunks_exact(count) {
            for (i, a) in row.iter().enumerate() {
                for (slot, b) in gram[i].iter_mut().zip(row) {
                    *slot -= a * b;
                }
            }
        }
        let left: Vec<f64> = transforms[1][..lines].iter().flatten().copied().collect();
        known.error() - explained(gram, &wholes, left)
    }
}

/// Share explained by columns, added one by one; a linearly dependent one is skipped.
fn explained(mut gram: [[f64; COLUMNS]; COLUMNS], wholes: &[f64], mut left: Vec<f64>) -> f64 {
    let mut sum = 0.0;
    for i in 0..wholes.len() {
        let pivot = gram[i][i];
        if pivot <= SAYS * wholes[i] {
            continue;
        }
        sum += left[i] * left[i] / pivot;
        let row = gram[i];
        for k in i + 1..wholes.len() {
            let share = row[k] / pivot;
            left[k] -= share * left[i];
            for (slot, x) in gram[k][i + 1..].iter_mut().zip(&row[i + 1..]) {
                *slot -= share * x;
            }
        }
    }
    sum
}

/// Products of cosines and sines of a line and its harmonics, from the sums of single lines.
fn gram(sums: &[[f64; 2]], lines: usize) -> [[f64; COLUMNS]; COLUMNS] {
    let mut out = [[0.0; COLUMNS]; COLUMNS];
    for a in 0..lines {
        for b in 0..lines {
            let [re, im] = sums[a + b + 2];
            // The product of a line and a higher one has negative frequency.
            let [apart_re, apart] = sums[a.abs_diff(b)];
            let apart_im = if a >= b { apart } else { -apart };
            out[2 * a][2 * b] = 0.5 * (apart_re + re);
            out[2 * a + 1][2 * b + 1] = 0.5 * (apart_re - re);
            out[2 * a][2 * b + 1] = 0.5 * (im - apart_im);
            out[2 * b + 1][2 * a] = out[2 * a][2 * b + 1];
        }
    }
    out
}

/// Sum of `exp(i angle k)` over `from..n`, real and imaginary part.
fn turns(angle: f64, from: usize, n: usize) -> [f64; 2] {
    let count = (n - from) as f64;
    let half = libm::sin(0.5 * angle);
    let size = if half == 0.0 { count } else { libm::sin(0.5 * count * angle) / half };
    let middle = 0.5 * angle * (from + n - 1) as f64;
    [size * libm::cos(middle), size * libm::sin(middle)]
}

/// Sums of two signals, which start at bin `from`, with a line of frequency `f` and its harmonics.
fn transforms(f: f64, from: usize, [x, y]: [&[f64]; 2]) -> [[[f64; 2]; HARMONICS]; 2] {
    let angle = |line: usize, k: usize| 2.0 * PI * f * (line + 1) as f64 * k as f64;
    let of = |k: usize, turn: fn(f64) -> f64| -> [f64; HARMONICS] { core::array::from_fn(|line| turn(angle(line, k))) };
    let (turn_cos, turn_sin) = (of(1, libm::cos), of(1, libm::sin));
    let mut sums = [[0.0; HARMONICS]; 4];
    for (block, (x, y)) in x.chunks(FRESH).zip(y.chunks(FRESH)).enumerate() {
        let at = from + block * FRESH;
        let (mut cosine, mut sine) = (of(at, libm::cos), of(at, libm::sin));
        for (a, b) in x.iter().zip(y) {
            for line in 0..HARMONICS {
                let (c, s) = (cosine[line], sine[line]);
                sums[0][line] += a * c;
                sums[1][line] += a * s;
                sums[2][line] += b * c;
                sums[3][line] += b * s;
                cosine[line] = c * turn_cos[line] - s * turn_sin[line];
                sine[line] = c * turn_sin[line] + s * turn_cos[line];
            }
        }
    }
    let pair = |re: usize| core::array::from_fn(|line| [sums[re][line], sums[re + 1][line]]);
    [pair(0), pair(2)]
}

/// Gain of lines over the prior model, minus their chance gain: see [`super::one_step::Periodicity`].
pub(super) fn gain(before: &[f64; 2], after: &Known) -> f64 {
    let [error, columns] = *before;
    let lines = after.count() as f64 - columns;
    log_ratio(error, after.error()) - 2.0 * lines / after.left.len() as f64
}

#[cfg(test)]
mod tests {
    use super::super::noise;
    use super::*;
    use crate::core::signal::stats;

    #[test]
    fn the_normal_equations_agree_with_learning_column_by_column() {
        for seed in 1..20 {
            let mut pv = noise(200 + 17 * seed as usize, seed);
            for k in 0..pv.len() {
                pv[k] += 2.0 * libm::sin(0.21 * k as f64) + if k > 0 { 0.4 * pv[k - 1] } else { 0.0 };
            }
            let known = Known::past(pv, 12, 7);
            for f in [0.011, 0.0334, 0.12, 0.4] {
                let quick = Normal::default().error(&known, f);
                let plain = known.clone().with_lines(f).error();
                assert!((quick / plain - 1.0).abs() < 1e-10, "{f}: {quick} {plain}");
                assert!(stats::dot(&known.left, &known.left) >= plain);
            }
        }
    }
}
