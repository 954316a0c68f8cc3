//! Least squares that a few wild samples cannot turn: the one regression by which a controller is read.

use super::least_squares::Gram;
use crate::signal::stats;

/// Most columns that are regressed on, the constant not counted.
pub const MAX_COLUMNS: usize = 4;

/// What a regression found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Regression {
    /// Coefficients of the columns, then the constant.
    pub coefficients: [f64; MAX_COLUMNS + 1],
    /// Share of the weighted variance explained.
    pub r2: f64,
}

/// Regresses `y` on up to [`MAX_COLUMNS`] `columns` of its length and a constant: three rounds in which a residual `r`
/// gets the weight `1/sqrt(1 + (r / 3 sigma)^2)`, sigma from the median absolute deviation. Samples outside `used` have
/// no say. `None` where `y` does not move.
#[must_use]
pub fn regress(y: &[f64], columns: &[&[f64]], used: Option<&[bool]>) -> Option<Regression> {
    let count = columns.len().min(MAX_COLUMNS);
    let columns = &columns[..count];
    let base: Vec<f64> = match used {
        Some(used) => (0..y.len()).map(|k| f64::from(u8::from(used.get(k).copied().unwrap_or(false)))).collect(),
        None => vec![1.0; y.len()],
    };
    let spread = stats::std_dev(y);
    let mut roots = base.clone();
    let mut coefficients = [0.0; MAX_COLUMNS + 1];
    let mut left = Vec::new();
    for _ in 0..3 {
        let weigh = |v: &[f64]| -> Vec<f64> { v.iter().zip(&roots).map(|(a, w)| a * w).collect() };
        let mut weighted: Vec<Vec<f64>> = columns.iter().map(|c| weigh(c)).collect();
        weighted.push(roots.clone());
        weighted.push(weigh(y));
        let views: Vec<&[f64]> = weighted.iter().map(Vec::as_slice).collect();
        let mut gram = Gram::of(&views);
        gram.eliminate(count + 1);
        let all = gram.back(count + 1, &[]);
        coefficients[..=count].copy_from_slice(&all[..=count]);
        left = residual(y, columns, &coefficients);
        let seen: Vec<f64> = left.iter().zip(&base).filter(|(_, b)| **b > 0.0).map(|(r, _)| *r).collect();
        let scale = 3.0 * 1.4826 * mad(seen) + 1e-12 * spread;
        for ((w, r), b) in roots.iter_mut().zip(&left).zip(&base) {
            *w = if scale > 0.0 { b / (1.0 + (r / scale) * (r / scale)).sqrt().sqrt() } else { *b };
        }
    }
    let weights: Vec<f64> = roots.iter().map(|w| w * w).collect();
    let mean = stats::dot(&weights, y) / weights.iter().sum::<f64>();
    let total: Vec<f64> = y.iter().map(|a| (a - mean) * (a - mean)).collect();
    let squares: Vec<f64> = left.iter().map(|r| r * r).collect();
    let whole = stats::dot(&weights, &total);
    // Written so that a value that is not a number fails too.
    if whole > 0.0 { Some(Regression { coefficients, r2: 1.0 - stats::dot(&weights, &squares) / whole }) } else { None }
}

/// Median absolute deviation from the median, without sorting; 0 for none.
fn mad(mut x: Vec<f64>) -> f64 {
    if x.is_empty() {
        return 0.0;
    }
    let place = x.len() / 2;
    let middle = *x.select_nth_unstable_by(place, f64::total_cmp).1;
    for v in &mut x {
        *v = (*v - middle).abs();
    }
    *x.select_nth_unstable_by(place, f64::total_cmp).1
}

/// `y` less what the coefficients make of the columns and the constant.
#[must_use]
pub fn residual(y: &[f64], columns: &[&[f64]], coefficients: &[f64; MAX_COLUMNS + 1]) -> Vec<f64> {
    let constant = coefficients[columns.len().min(MAX_COLUMNS)];
    let mut left: Vec<f64> = y.iter().map(|a| a - constant).collect();
    for (column, c) in columns.iter().zip(coefficients) {
        for (r, x) in left.iter_mut().zip(*column) {
            *r -= c * x;
        }
    }
    left
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fifth_of_wild_samples_does_not_turn_the_line() {
        let x: Vec<f64> = (0..500).map(|k| libm::sin(f64::from(k) * 0.7)).collect();
        let y: Vec<f64> = x.iter().enumerate().map(|(k, x)| if k % 5 == 0 { 40.0 } else { 2.0 * x - 1.0 }).collect();
        let found = regress(&y, &[&x], None).unwrap();
        assert!((found.coefficients[0] - 2.0).abs() < 0.1 && found.coefficients[1] < 0.0, "{found:?}");
        let used: Vec<bool> = (0..500).map(|k| k % 5 != 0).collect();
        let found = regress(&y, &[&x], Some(&used)).unwrap();
        assert!((found.coefficients[1] + 1.0).abs() < 1e-9 && found.r2 > 1.0 - 1e-12);
        assert_eq!(regress(&[1.0; 50], &[&x[..50]], None), None);
    }
}
