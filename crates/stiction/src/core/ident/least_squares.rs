//! Least squares on a handful of columns: Gram matrices and their elimination, without allocation.

use crate::core::signal::stats::{dot, dot3};

/// Most columns of a system, including the right-hand side.
pub(crate) const MAX: usize = 16;

/// A symmetric system of up to [`MAX`] columns; only the upper triangle is kept.
#[derive(Debug, Clone)]
pub(crate) struct Gram {
    /// Columns in use.
    pub n: usize,
    m: [[f64; MAX]; MAX],
    live: [bool; MAX],
}

impl Gram {
    /// Inner products of all columns (equal length, at most [`MAX`]; more are ignored).
    #[must_use]
    pub(crate) fn of(columns: &[&[f64]]) -> Self {
        let n = columns.len().min(MAX);
        let mut m = [[0.0; MAX]; MAX];
        for i in 0..n {
            let mut k = i;
            while k + 3 <= n {
                let three = dot3(columns[i], [columns[k], columns[k + 1], columns[k + 2]]);
                m[i][k..k + 3].copy_from_slice(&three);
                k += 3;
            }
            for k in k..n {
                m[i][k] = dot(columns[i], columns[k]);
            }
        }
        Self { n, m, live: [false; MAX] }
    }

    /// Inner products of each column of `left` with the same and all later columns of `right`, the weighted ones.
    #[must_use]
    pub(crate) fn of_weighted(left: &[&[f64]], right: &[&[f64]]) -> Self {
        let n = left.len().min(right.len()).min(MAX);
        let mut m = [[0.0; MAX]; MAX];
        for (i, (row, own)) in m.iter_mut().zip(left).take(n).enumerate() {
            let mut k = i;
            while k + 3 <= n {
                row[k..k + 3].copy_from_slice(&dot3(own, [right[k], right[k + 1], right[k + 2]]));
                k += 3;
            }
            for k in k..n {
                row[k] = dot(own, right[k]);
            }
        }
        Self { n, m, live: [false; MAX] }
    }

    /// Entry (row, column), row <= column; after elimination, of the Schur complement.
    #[must_use]
    pub(crate) fn at(&self, row: usize, column: usize) -> f64 {
        self.m[row][column]
    }

    /// Eliminates the first `count` columns; a column that depends linearly on earlier ones is skipped.
    pub(crate) fn eliminate(&mut self, count: usize) {
        let scale: [f64; MAX] = core::array::from_fn(|i| self.m[i][i]);
        #[allow(clippy::needless_range_loop)] // rows and columns of one array
        for p in 0..count {
            let pivot = self.m[p][p];
            self.live[p] = pivot > 1e-11 * scale[p] && pivot > 0.0;
            if !self.live[p] {
                continue;
            }
            let row = self.m[p];
            for i in p + 1..self.n {
                let factor = row[i] / pivot;
                for (target, value) in self.m[i][i..self.n].iter_mut().zip(&row[i..self.n]) {
                    *target -= factor * value;
                }
            }
        }
    }

    /// Coefficients of the first `count` (eliminated) columns that fit the last column, given the coefficients `known` of the
    /// columns between (from column `count` on). Skipped columns get 0.
    #[must_use]
    pub(crate) fn back(&self, count: usize, known: &[f64]) -> [f64; MAX] {
        let mut x = [0.0; MAX];
        for (k, value) in known.iter().enumerate() {
            x[count + k] = *value;
        }
        for p in (0..count).rev() {
            if self.live[p] {
                let mut sum = self.m[p][self.n - 1];
                for (coefficient, value) in self.m[p][p + 1..self.n - 1].iter().zip(&x[p + 1..self.n - 1]) {
                    sum -= coefficient * value;
                }
                x[p] = sum / self.m[p][p];
            }
        }
        x
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coefficients_are_found_and_dependent_columns_left_out() {
        let n = 40;
        let one = vec![1.0; n];
        let ramp: Vec<f64> = (0..n).map(|k| k as f64).collect();
        let wave: Vec<f64> = ramp.iter().map(|k| libm::sin(*k)).collect();
        let y: Vec<f64> = (0..n).map(|k| 2.0 - 0.5 * ramp[k] + 3.0 * wave[k]).collect();
        let mut gram = Gram::of(&[&one, &ramp, &one, &wave, &y]);
        gram.eliminate(4);
        let x = gram.back(4, &[]);
        for (got, want) in x.iter().zip([2.0, -0.5, 0.0, 3.0]) {
            assert!((got - want).abs() < 1e-10, "{x:?}");
        }
        assert!(gram.at(4, 4).abs() < 1e-9);
    }

    #[test]
    fn a_known_coefficient_is_respected() {
        let one = [1.0, 1.0, 1.0];
        let ramp = [0.0, 1.0, 2.0];
        let y = [1.0, 3.0, 5.0];
        let mut gram = Gram::of(&[&one, &ramp, &y]);
        gram.eliminate(1);
        assert!((gram.back(1, &[1.0])[0] - 2.0).abs() < 1e-12);
    }
}
