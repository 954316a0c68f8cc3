//! Least squares on columns: weighted, and what new columns explain beyond known ones.

use nalgebra::{DMatrix, DVector};

use crate::core::signal::stats;

/// Ridge on the normal equations, relative to each diagonal entry and to the largest: columns may depend on each other.
const RIDGE: [f64; 2] = [1e-9, 1e-15];
/// A column whose remainder has less than this share of its power depends on the others.
const NEW: f64 = 1e-9;

/// Weighted least squares of `y` on `columns`; `None` where the equations have no solution.
#[must_use]
pub(crate) fn solve(columns: &[Vec<f64>], y: &[f64], weights: &[f64]) -> Option<Vec<f64>> {
    let k = columns.len();
    let mut gram = DMatrix::zeros(k, k);
    let mut right = DVector::zeros(k);
    for (i, column) in columns.iter().enumerate() {
        let weighted: Vec<f64> = column.iter().zip(weights).map(|(x, w)| x * w).collect();
        for (j, other) in columns.iter().enumerate().skip(i) {
            gram[(j, i)] = stats::dot(&weighted, other);
            gram[(i, j)] = gram[(j, i)];
        }
        right[i] = stats::dot(&weighted, y);
    }
    let largest = gram.diagonal().iter().copied().fold(0.0, f64::max);
    for i in 0..k {
        gram[(i, i)] += RIDGE[0] * gram[(i, i)] + RIDGE[1] * largest;
    }
    let solved = gram.cholesky()?.solve(&right);
    solved.iter().all(|v| v.is_finite()).then(|| solved.as_slice().to_vec())
}

/// `y` less columns with these coefficients.
#[must_use]
pub(crate) fn left(columns: &[Vec<f64>], y: &[f64], coefficients: &[f64]) -> Vec<f64> {
    let mut e = y.to_vec();
    for (column, c) in columns.iter().zip(coefficients) {
        e.iter_mut().zip(column).for_each(|(e, x)| *e -= c * x);
    }
    e
}

/// Slope of the line through points, and their correlation; not a number where either does not move.
#[must_use]
pub(crate) fn line(x: &[f64], y: &[f64]) -> [f64; 2] {
    let [x, y] = [x, y].map(|v| v.iter().map(|value| value - stats::mean(v)).collect::<Vec<f64>>());
    let [xx, xy, yy] = [stats::dot(&x, &x), stats::dot(&x, &y), stats::dot(&y, &y)];
    [xy / xx, xy / (xx * yy).sqrt()]
}

/// Orthonormal columns.
#[derive(Debug, Clone, Default)]
pub(crate) struct Orthonormal(pub Vec<Vec<f64>>);

impl Orthonormal {
    /// Of columns of one length, by Gram and Schmidt's method; what depends on those before is left out.
    #[must_use]
    pub(crate) fn of(columns: impl IntoIterator<Item = Vec<f64>>) -> Self {
        let mut own = Self::default();
        for column in columns {
            let new = own.beyond([column]);
            own.0.extend(new.0);
        }
        own
    }

    /// Further columns, made orthonormal to these and to each other.
    #[must_use]
    pub(crate) fn beyond(&self, columns: impl IntoIterator<Item = Vec<f64>>) -> Self {
        let mut new = Self::default();
        for mut x in columns {
            let whole = stats::dot(&x, &x);
            self.take_out(&mut x);
            new.take_out(&mut x);
            let own = stats::dot(&x, &x);
            if own > NEW * whole {
                let size = own.sqrt();
                x.iter_mut().for_each(|x| *x /= size);
                new.0.push(x);
            }
        }
        new
    }

    /// Subtracts a column's projection on these.
    pub(crate) fn take_out(&self, x: &mut [f64]) {
        for q in &self.0 {
            let along = stats::dot(x, q);
            x.iter_mut().zip(q).for_each(|(x, q)| *x -= along * q);
        }
    }

    /// Power of a column's projection on these.
    #[must_use]
    pub(crate) fn power_of(&self, x: &[f64]) -> f64 {
        self.0.iter().map(|q| stats::dot(q, x)).map(|along| along * along).sum()
    }
}

/// Squares of an error that a column explains, from the column's power, its product with the error, and the power of its
/// projection on columns that the error is already orthogonal to.
#[must_use]
pub(crate) fn taken(power: f64, along: f64, known: f64) -> f64 {
    let new = power - known;
    if new > NEW * power { along * along / new } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_has_its_slope() {
        let [slope, correlation] = line(&[1.0, 2.0, 3.0], &[5.0, 3.0, 1.0]);
        assert!(
            (slope + 2.0).abs() < 1e-12 && (correlation + 1.0).abs() < 1e-12 && line(&[1.0; 3], &[1.0; 3])[0].is_nan()
        );
    }

    #[test]
    fn new_columns_explain_what_a_fit_with_all_of_them_does() {
        let of = |f: &dyn Fn(f64) -> f64| (0..60).map(|k| f(f64::from(k))).collect::<Vec<f64>>();
        let (one, ramp) = (vec![1.0; 60], of(&|k| 1e4 + k));
        let (wave, y) = (of(&|k| libm::sin(0.3 * k)), of(&|k| 2.0 + 0.1 * k + libm::cos(0.29 * k)));
        let error = |columns: &[Vec<f64>]| {
            let rest = left(columns, &y, &solve(columns, &y, &[1.0; 60]).unwrap());
            stats::dot(&rest, &rest)
        };
        let known = Orthonormal::of([one.clone(), of(&|k| k), ramp]);
        assert_eq!(known.0.len(), 2, "the third is a sum of the others");
        let mut rest = y.clone();
        known.take_out(&mut rest);
        let columns = [one, of(&|k| k), wave.clone()];
        let gained = error(&columns[..2]) - error(&columns);
        assert!((known.beyond([wave.clone()]).power_of(&rest) - gained).abs() < 1e-6);
        let by_sums = taken(stats::dot(&wave, &wave), stats::dot(&wave, &rest), known.power_of(&wave));
        assert!((by_sums - gained).abs() < 1e-6 && known.beyond([columns[0].clone()]).0.is_empty());
    }
}
