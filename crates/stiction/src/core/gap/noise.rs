//! The noise that no free run explains: its floor, and what a noise model makes of a residual one step ahead.

use super::budget::student::Student;
use super::problem::Problem;
use super::types::{Floor, OneStep};
use crate::core::ident::least_squares::Gram;
use crate::core::signal::stats;

/// Order of the autoregression.
const ORDER: usize = 4;
/// Share of held samples from which no noise can be read.
const HELD: f64 = 0.3;

/// The quantum of a signal on a grid; `None` where it is on none, or on one far finer than its noise.
#[must_use]
pub(crate) fn quantum(x: &[f64]) -> Option<f64> {
    let sorted = stats::sorted(x);
    let width = sorted.last()? - sorted.first()?;
    let gaps: Vec<f64> = sorted.windows(2).map(|w| w[1] - w[0]).filter(|g| *g > 1e-9 * width).collect();
    let least = gaps.iter().copied().fold(f64::INFINITY, f64::min);
    let on_grid = |g: &&f64| ((*g / least) - (*g / least).round()).abs() < 0.02;
    let few = gaps.len() * 3 < x.len();
    (few && !gaps.is_empty() && gaps.iter().filter(on_grid).count() == gaps.len()).then_some(least)
}

/// The noise floor of PV, without any model of valve or process, from stretches in which it was `measured` at every point;
/// nothing of PV on `straight` lines.
#[must_use]
pub(crate) fn floor(pv: &[f64], measured: &[bool], straight: bool) -> Floor {
    let quantum = quantum(pv);
    let held = quantum.is_none() && stats::repeat_share(pv) > HELD;
    let noise_sd = if held || straight { None } else { Some(white_sd(&second_where(pv, measured))) };
    let grid = quantum.unwrap_or(0.0) / 12.0_f64.sqrt();
    // Rounding shows in the second differences too where it is finer than the noise.
    let noise_floor = noise_sd.map(|sd| if sd > 2.0 * grid { sd } else { sd + grid });
    Floor { noise_sd, quantum, noise_floor: noise_floor.filter(|f| *f > 0.0), high_band_sd: None }
}

/// Standard deviation of the white part of what a model leaves at the points that were `measured`, where a recorder kept
/// too few of them for differences of PV: from the differences between one and the next.
#[must_use]
pub(crate) fn of_measured(residual: &[f64], measured: &[bool], from: usize) -> Option<f64> {
    let kept: Vec<f64> = (from..residual.len()).filter(|k| measured[*k]).map(|k| residual[k]).collect();
    let first: Vec<f64> = kept.windows(2).map(|w| w[1] - w[0]).collect();
    (first.len() > 20).then(|| stats::clipped_sd(&first) / core::f64::consts::SQRT_2)
}

/// Standard deviation of a residual's white part from its second differences, over the given stretches.
#[must_use]
pub(crate) fn high_band(residual: &[f64], stretches: &[[usize; 2]]) -> Option<f64> {
    let second: Vec<f64> = stretches.iter().flat_map(|[a, b]| stats::second_differences(&residual[*a..*b])).collect();
    (second.len() > 20).then(|| white_sd(&second))
}

/// Second differences of points that were all measured.
fn second_where(x: &[f64], measured: &[bool]) -> Vec<f64> {
    let all = stats::second_differences(x).zip(measured.windows(3));
    all.filter(|(_, around)| around.iter().all(|m| *m)).map(|(second, _)| second).collect()
}

/// Deviation of the white part that second differences show: smooth courses they leave out, slips the clipping.
fn white_sd(second: &[f64]) -> f64 {
    stats::clipped_sd(second) / 6.0_f64.sqrt()
}

/// Mean squared error of an autoregression of a residual, one step ahead over its stretches; `None` for too few points.
#[must_use]
pub(crate) fn autoregression(residual: &[f64], stretches: &[[usize; 2]]) -> Option<f64> {
    let taken = coefficients(residual, stretches, ORDER)?;
    let left: Vec<f64> = innovations(residual, stretches, &taken).map(|e| e * e).collect();
    Some(stats::mean(&left))
}

/// Mean squared error one step ahead of noise with a memory of first order, and its pole.
#[must_use]
pub(crate) fn first_order(residual: &[f64], stretches: &[[usize; 2]]) -> Option<(f64, f64)> {
    let pairs = || stretches.iter().flat_map(|[a, b]| residual[*a..*b].windows(2));
    let sums = pairs().fold([0.0; 3], |s, w| [s[0] + w[0] * w[0], s[1] + w[0] * w[1], s[2] + 1.0]);
    let pole = (sums[0] > 0.0).then(|| sums[1] / sums[0])?;
    let sse: f64 = pairs().map(|w| (w[1] - pole * w[0]) * (w[1] - pole * w[0])).sum();
    Some((sse / sums[2], pole))
}

/// How likely a residual in PV units is one step ahead, by the order of its noise.
#[must_use]
pub(crate) fn one_step(residual: &[f64], problem: &Problem) -> OneStep {
    let deviation = problem.normalised.deviation;
    let of_order = |order: usize| {
        let taken = coefficients(residual, &problem.train, order)?;
        let [train, test] = [&problem.train, &problem.test]
            .map(|stretches| -> Vec<f64> { innovations(residual, stretches, &taken).map(|e| e / deviation).collect() });
        let student = Student::of(&train, &vec![true; train.len()]);
        let loss = |e: &[f64]| student.loss(e.iter().copied()) / e.len().max(1) as f64;
        let fitted = student.log_likelihood / train.len() as f64;
        Some([fitted, fitted + loss(&train) - loss(&test)])
    };
    core::array::from_fn(|order| of_order(order).unwrap_or_default())
}

/// The innovation of an autoregression at each point that it predicts.
fn innovations(residual: &[f64], stretches: &[[usize; 2]], coefficients: &[f64]) -> impl Iterator<Item = f64> {
    let points = stretches.iter().flat_map(|[a, b]| a + ORDER..*b);
    points.map(|k| {
        let past = &residual[k - coefficients.len()..k];
        residual[k] - coefficients.iter().zip(past).map(|(c, x)| c * x).sum::<f64>()
    })
}

/// The coefficients of an autoregression by least squares, the farthest point's first; `None` for too few points.
fn coefficients(residual: &[f64], stretches: &[[usize; 2]], order: usize) -> Option<Vec<f64>> {
    let mut columns: Vec<Vec<f64>> = vec![Vec::new(); order + 1];
    for k in stretches.iter().flat_map(|[a, b]| a + ORDER..*b) {
        for (lag, column) in columns.iter_mut().enumerate() {
            // The last column is the point itself.
            column.push(residual[k - (order - lag)]);
        }
    }
    if columns[order].len() < 10 * ORDER {
        return None;
    }
    let views: Vec<&[f64]> = columns.iter().map(Vec::as_slice).collect();
    let mut gram = Gram::of(&views);
    gram.eliminate(order);
    let all = gram.back(order, &[]);
    Some(all[..order].to_vec())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::sim::noise::Noise;

    fn noise(n: usize) -> Vec<f64> {
        let mut noise = Noise::new(3, 0);
        (0..n).map(|_| noise.gaussian()).collect()
    }

    #[test]
    fn the_floor_is_the_noise_and_the_grid() {
        let slow: Vec<f64> =
            noise(2000).iter().enumerate().map(|(k, e)| 0.1 * e + 3.0 * libm::sin(k as f64 * 0.05)).collect();
        let found = floor(&slow, &[true; 2000], false);
        assert!((found.noise_floor.unwrap() / 0.1 - 1.0).abs() < 0.08 && found.quantum.is_none());
        let rounded: Vec<f64> = slow.iter().map(|x| crate::core::sim::noise::quantise(*x, 0.5)).collect();
        assert!((floor(&rounded, &[true; 2000], false).quantum.unwrap() - 0.5).abs() < 1e-9);
        let held: Vec<f64> = (0..2000).map(|k| slow[k - k % 5]).collect();
        assert_eq!(floor(&held, &[true; 2000], false).noise_floor, None);
    }

    #[test]
    fn an_autoregression_finds_the_innovations() {
        let mut x = noise(3000);
        for k in 1..x.len() {
            x[k] += 0.9 * x[k - 1];
        }
        let found = autoregression(&x, &[[0, 1500], [1600, 3000]]).unwrap();
        assert!((found - 1.0).abs() < 0.1, "{found}");
    }
}
