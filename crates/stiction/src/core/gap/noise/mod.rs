//! The noise that no free run explains: its floor, and its models one step ahead, by autoregressions (AR, and ARX in [`arx`]) whose
//! innovations follow Student's t.

pub(crate) mod arx;
pub(crate) mod least_squares;
mod student;

use super::problem::Problem;
use super::types::{Floor, OneStep};
use crate::core::signal::stats;
pub(crate) use arx::whitened;
use least_squares::solve;
use student::Student;

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
    Floor { noise_sd, noise_floor: noise_floor.filter(|f| *f > 0.0) }
}

/// Standard deviation of the white part of what a model leaves at the points that were `measured`, where a recorder kept
/// too few of them for differences of PV: from the differences between one and the next.
#[must_use]
pub(crate) fn of_measured(residual: &[f64], measured: &[bool], from: usize) -> Option<f64> {
    let kept: Vec<f64> = (from..residual.len()).filter(|k| measured[*k]).map(|k| residual[k]).collect();
    let first: Vec<f64> = kept.windows(2).map(|w| w[1] - w[0]).collect();
    (first.len() > 20).then(|| stats::clipped_sd(&first) / core::f64::consts::SQRT_2)
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

/// The points at which an autoregression of any order up to [`ORDER`] predicts.
fn predicted(stretches: &[[usize; 2]]) -> impl Iterator<Item = usize> {
    stretches.iter().flat_map(|[from, to]| from + ORDER..*to)
}

/// An autoregression of a residual by least squares over its stretches: coefficients of A by rising lag, the first 1; `None`
/// for too few points.
#[must_use]
pub(crate) fn autoregression(residual: &[f64], stretches: &[[usize; 2]], order: usize) -> Option<Vec<f64>> {
    let at = |lag: usize| predicted(stretches).map(|k| residual[k - lag]).collect::<Vec<f64>>();
    let (y, past) = (at(0), (1..=order).map(at).collect::<Vec<_>>());
    let enough = y.len() >= 10 * ORDER;
    let found = enough.then(|| solve(&past, &y, &vec![1.0; y.len()])).flatten()?;
    Some(core::iter::once(1.0).chain(found.iter().map(|c| -c)).collect())
}

/// What an autoregression leaves of a residual at each point that it predicts.
#[must_use]
pub(crate) fn innovations(residual: &[f64], stretches: &[[usize; 2]], a: &[f64]) -> Vec<f64> {
    let all = whitened(a, residual);
    predicted(stretches).map(|k| all[k]).collect()
}

/// Mean of the squares.
#[must_use]
pub(crate) fn mean_square(e: &[f64]) -> f64 {
    stats::dot(e, e) / e.len().max(1) as f64
}

/// Mean squared error one step ahead of an autoregression of the highest order, and of one of first order with its pole.
#[must_use]
pub(crate) fn memory(residual: &[f64], stretches: &[[usize; 2]]) -> Option<(f64, f64, f64)> {
    let left = |a: &[f64]| mean_square(&innovations(residual, stretches, a));
    let [high, first] = [ORDER, 1].map(|order| autoregression(residual, stretches, order));
    let first = first?;
    Some((left(&high?), left(&first), -first[1]))
}

/// How likely a residual in PV units is one step ahead, by the order of its noise.
#[must_use]
pub(crate) fn one_step(residual: &[f64], problem: &Problem) -> OneStep {
    let deviation = problem.normalised.deviation;
    let of_order = |order: usize| {
        let a = autoregression(residual, &problem.train, order)?;
        let [train, test] = [&problem.train, &problem.test].map(|stretches| {
            let e = innovations(residual, stretches, &a);
            e.into_iter().map(|e| e / deviation).collect::<Vec<f64>>()
        });
        let student = Student::of(train.iter().copied());
        let loss = |e: &[f64]| student.loss(e.iter().copied()) / e.len().max(1) as f64;
        let fitted = student.log_likelihood / train.len() as f64;
        Some([fitted, fitted + loss(&train) - loss(&test)])
    };
    core::array::from_fn(|order| of_order(order).unwrap_or_default())
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
        assert!((found.noise_floor.unwrap() / 0.1 - 1.0).abs() < 0.08 && quantum(&slow).is_none());
        let rounded: Vec<f64> = slow.iter().map(|x| crate::core::sim::noise::quantise(*x, 0.5)).collect();
        assert!((quantum(&rounded).unwrap() - 0.5).abs() < 1e-9);
        let held: Vec<f64> = (0..2000).map(|k| slow[k - k % 5]).collect();
        assert_eq!(floor(&held, &[true; 2000], false).noise_floor, None);
    }

    #[test]
    fn an_autoregression_finds_the_innovations() {
        let mut x = noise(3000);
        for k in 1..x.len() {
            x[k] += 0.9 * x[k - 1];
        }
        let (high, first, pole) = memory(&x, &[[0, 1500], [1600, 3000]]).unwrap();
        assert!(
            (high - 1.0).abs() < 0.1 && (first - 1.0).abs() < 0.1 && (pole - 0.9).abs() < 0.03,
            "{high} {first} {pole}"
        );
        assert_eq!(autoregression(&x, &[[0, 1500]], 0).unwrap(), [1.0]);
    }
}
