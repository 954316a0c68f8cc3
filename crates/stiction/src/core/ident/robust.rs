//! Robust least squares, which outliers cannot dominate: the regression that identifies the controller.

use super::least_squares::Gram;
use crate::core::signal::stats;

/// Most regression columns, not counting the constant.
pub(crate) const MAX_COLUMNS: usize = 4;
/// Rounds of reweighting.
const ROUNDS: usize = 3;

/// Result of a regression.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Regression {
    /// Coefficients of the columns, then the constant.
    pub coefficients: [f64; MAX_COLUMNS + 1],
    /// Share of the weighted variance explained.
    pub r2: f64,
}

/// Regression with reusable buffers.
#[derive(Debug, Clone, Default)]
pub(crate) struct Regressor {
    weights: Vec<f64>,
    ones: Vec<f64>,
    weighted: [Vec<f64>; MAX_COLUMNS + 1],
    left: Vec<f64>,
    seen: Vec<f64>,
    work: Vec<f64>,
}

impl Regressor {
    /// Regresses `y` on up to [`MAX_COLUMNS`] `columns` of its length and a constant: in three rounds, a residual `r` gets the
    /// weight `1/sqrt(1 + (r / 3 sigma)^2)`, sigma from the median absolute deviation. Samples outside `used` are ignored.
    /// `None` if `y` is constant.
    pub(crate) fn regress(&mut self, y: &[f64], columns: &[&[f64]], used: Option<&[bool]>) -> Option<Regression> {
        let count = columns.len().min(MAX_COLUMNS);
        let columns = &columns[..count];
        let base = |k: usize| used.is_none_or(|used| used.get(k).copied().unwrap_or(false));
        self.weights.clear();
        self.weights.extend((0..y.len()).map(|k| f64::from(u8::from(base(k)))));
        self.ones.resize(y.len(), 1.0);
        let spread = stats::std_dev(y);
        let mut coefficients = [0.0; MAX_COLUMNS + 1];
        for _ in 0..ROUNDS {
            coefficients = self.solve(y, columns);
            residual(y, columns, &coefficients, &mut self.left);
            self.weigh(spread, used);
        }
        let r2 = self.explained(y)?;
        Some(Regression { coefficients, r2 })
    }

    /// Residual of the last regression.
    #[must_use]
    pub(crate) fn left(&self) -> &[f64] {
        &self.left
    }

    /// Weighted least squares.
    fn solve(&mut self, y: &[f64], columns: &[&[f64]]) -> [f64; MAX_COLUMNS + 1] {
        let count = columns.len();
        for (weighted, column) in self.weighted.iter_mut().zip(columns.iter().copied().chain([y])) {
            weighted.clear();
            weighted.extend(column.iter().zip(&self.weights).map(|(a, w)| a * w));
        }
        let ones = &self.ones[..y.len()];
        let mut left: [&[f64]; MAX_COLUMNS + 2] = [&[]; MAX_COLUMNS + 2];
        let mut right = left;
        for (index, column) in columns.iter().enumerate() {
            (left[index], right[index]) = (&self.weighted[index], column);
        }
        (left[count], right[count]) = (&self.weights, ones);
        (left[count + 1], right[count + 1]) = (&self.weighted[count], y);
        let mut gram = Gram::of_weighted(&left[..count + 2], &right[..count + 2]);
        gram.eliminate(count + 1);
        let all = gram.back(count + 1, &[]);
        let mut out = [0.0; MAX_COLUMNS + 1];
        out[..=count].copy_from_slice(&all[..=count]);
        out
    }

    /// Computes the weights from the residuals.
    fn weigh(&mut self, spread: f64, used: Option<&[bool]>) {
        self.seen.clear();
        match used {
            Some(used) => self.seen.extend(self.left.iter().zip(used).filter(|(_, u)| **u).map(|(r, _)| *r)),
            None => self.seen.extend_from_slice(&self.left),
        }
        let scale = 3.0 * 1.4826 * mad(&mut self.seen, &mut self.work) + 1e-12 * spread;
        if scale > 0.0 {
            for (w, r) in self.weights.iter_mut().zip(&self.left) {
                let share = r / scale;
                *w = 1.0 / (1.0 + share * share).sqrt();
            }
        } else {
            self.weights.fill(1.0);
        }
        if let Some(used) = used {
            for (w, used) in self.weights.iter_mut().zip(used) {
                *w *= f64::from(u8::from(*used));
            }
        }
    }

    /// Share of `y`'s weighted variance that is explained; `None` if `y` has no variance.
    fn explained(&self, y: &[f64]) -> Option<f64> {
        let mean = stats::dot(&self.weights, y) / stats::sum(&self.weights);
        let (mut whole, mut rest) = (0.0, 0.0);
        for ((w, y), r) in self.weights.iter().zip(y).zip(&self.left) {
            whole += w * (y - mean) * (y - mean);
            rest += w * r * r;
        }
        // Written so that NaN fails too.
        if whole > 0.0 { Some(1.0 - rest / whole) } else { None }
    }
}

/// Median absolute deviation from the median (the upper median for an even count); 0 for an empty slice.
fn mad(x: &mut [f64], work: &mut Vec<f64>) -> f64 {
    if x.is_empty() {
        return 0.0;
    }
    let middle = stats::nth(x, x.len() / 2, work);
    for v in &mut *x {
        *v = (*v - middle).abs();
    }
    stats::nth(x, x.len() / 2, work)
}

/// `y` minus the fitted columns and constant.
fn residual(y: &[f64], columns: &[&[f64]], coefficients: &[f64; MAX_COLUMNS + 1], left: &mut Vec<f64>) {
    let constant = coefficients[columns.len().min(MAX_COLUMNS)];
    left.clear();
    left.extend(y.iter().map(|a| a - constant));
    for (column, c) in columns.iter().zip(coefficients) {
        for (r, x) in left.iter_mut().zip(*column) {
            *r -= c * x;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fifth_of_wild_samples_does_not_turn_the_line() {
        let x: Vec<f64> = (0..500).map(|k| libm::sin(f64::from(k) * 0.7)).collect();
        let y: Vec<f64> = x.iter().enumerate().map(|(k, x)| if k % 5 == 0 { 40.0 } else { 2.0 * x - 1.0 }).collect();
        let found = Regressor::default().regress(&y, &[&x], None).unwrap();
        assert!((found.coefficients[0] - 2.0).abs() < 0.1 && found.coefficients[1] < 0.0, "{found:?}");
        let used: Vec<bool> = (0..500).map(|k| k % 5 != 0).collect();
        let found = Regressor::default().regress(&y, &[&x], Some(&used)).unwrap();
        assert!((found.coefficients[1] + 1.0).abs() < 1e-9 && found.r2 > 1.0 - 1e-12);
        assert_eq!(Regressor::default().regress(&[1.0; 50], &[&x[..50]], None), None);
    }
}
