//! The noise that no free run explains: its floor, and what a noise model makes of a residual one step ahead.

use super::budget::student::Student;
use super::problem::Problem;
use super::types::{Alone, Floor, NoiseModels, OneStep};
use crate::core::ident::least_squares::Gram;
use crate::core::ident::residual;
use crate::core::signal::stats;
use crate::core::sim::noise::Noise;

/// Order of the autoregression.
const ORDER: usize = 4;
/// Circular shifts of a permutation test.
const SHIFTS: usize = 99;
/// Lags of OP and of its moves that are asked.
const LAGS: usize = 24;
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

/// An autoregression of a residual.
#[derive(Debug, Clone)]
pub(crate) struct Autoregression {
    /// Mean squared error one step ahead.
    pub mse: f64,
    /// What it leaves, with the point of each.
    pub innovations: Vec<(usize, f64)>,
}

/// Fits one to the stretches of a residual; `None` for too few points.
#[must_use]
pub(crate) fn autoregression(residual: &[f64], stretches: &[[usize; 2]]) -> Option<Autoregression> {
    of_order(residual, stretches, ORDER)
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

/// Mean squared error one step ahead of noise with a memory of first order under white noise, over the points that an
/// autoregression predicts: measurement noise hides the memory from an autoregression of first order.
fn first_order_under_white(residual: &[f64], stretches: &[[usize; 2]]) -> f64 {
    /// Time constants from one point on, by this factor each, and shares of the memory that the white noise takes.
    const TIMES: i32 = 26;
    const FACTOR: f64 = 1.3;
    const SHARES: [f64; 11] = [0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95];
    let mut best = f64::INFINITY;
    for pole in (0..TIMES).map(|i| libm::exp(-libm::pow(FACTOR, -f64::from(i)))) {
        for share in SHARES {
            let (mut count, mut sum) = (0.0, 0.0);
            for [a, b] in stretches {
                let mut error = 0.0;
                for (i, pair) in residual[*a..*b].windows(2).enumerate() {
                    error = pair[1] - pole * pair[0] + share * pole * error;
                    if i + 1 >= ORDER {
                        (count, sum) = (count + 1.0, sum + error * error);
                    }
                }
            }
            best = best.min(sum / f64::max(count, 1.0));
        }
    }
    best
}

/// How likely a residual in PV units is one step ahead, by the order of its noise.
#[must_use]
pub(crate) fn one_step(residual: &[f64], problem: &Problem) -> OneStep {
    let deviation = problem.normalised.deviation;
    let of_order = |order: usize| {
        let taken = coefficients(residual, &problem.train, order)?;
        let [train, test] = [&problem.train, &problem.test].map(|stretches| -> Vec<f64> {
            innovations(residual, stretches, &taken).map(|(_, e)| e / deviation).collect()
        });
        let student = Student::of(&train, &vec![true; train.len()]);
        let loss = |e: &[f64]| student.loss(e.iter().copied()) / e.len().max(1) as f64;
        let fitted = student.log_likelihood / train.len() as f64;
        Some([fitted, fitted + loss(&train) - loss(&test)])
    };
    core::array::from_fn(|order| of_order(order).unwrap_or_default())
}

fn of_order(residual: &[f64], stretches: &[[usize; 2]], order: usize) -> Option<Autoregression> {
    let taken = coefficients(residual, stretches, order)?;
    let innovations: Vec<(usize, f64)> = innovations(residual, stretches, &taken).collect();
    let mse = innovations.iter().map(|(_, e)| e * e).sum::<f64>() / innovations.len() as f64;
    Some(Autoregression { mse, innovations })
}

/// The innovation of an autoregression at each point that it predicts, with the point.
fn innovations(residual: &[f64], stretches: &[[usize; 2]], coefficients: &[f64]) -> impl Iterator<Item = (usize, f64)> {
    let points = stretches.iter().flat_map(|[a, b]| a + ORDER..*b);
    points.map(|k| {
        let past = &residual[k - coefficients.len()..k];
        (k, residual[k] - coefficients.iter().zip(past).map(|(c, x)| c * x).sum::<f64>())
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

/// What noise models say: `base` and `best` are free-run residuals over the whole record.
#[must_use]
pub(crate) fn judge(problem: &Problem, base: &[f64], best: &[f64], slipped: &[bool], seed: u64) -> NoiseModels {
    let nothing =
        NoiseModels { over_base: 0.0, over_best: 0.0, independence_p: 1.0, whitens: false, beyond_first: 0.0 };
    let Some(found) = autoregression(base, &problem.train) else { return nothing };
    let mse = |r: &[f64]| {
        let n = problem.train.iter().map(|[a, b]| b - a).sum::<usize>().max(1);
        problem.train.iter().flat_map(|[a, b]| &r[*a..*b]).map(|e| e * e).sum::<f64>() / n as f64
    };
    let log = |x: f64| libm::log(x.max(1e-30));
    let e: Vec<f64> = found.innovations.iter().map(|(_, e)| *e).collect();
    let op: Vec<f64> = found.innovations.iter().map(|(k, _)| problem.normalised.mean[*k]).collect();
    NoiseModels {
        over_base: log(mse(base)) - log(found.mse),
        over_best: log(mse(best)) - log(found.mse),
        independence_p: independence(problem, &found, slipped, seed),
        whitens: residual::whiteness(&e, &op).white,
        beyond_first: of_order(base, &problem.train, 1).map_or(0.0, |first| log(first.mse) - log(found.mse)),
    }
}

/// The base's place whose residual is best one step ahead, and what noise models say of it: under a slow disturbance the
/// right slips need not leave the least of PV. `best` is the least that any structure leaves.
#[must_use]
pub(crate) fn alone(
    problem: &Problem,
    places: &[Vec<f64>],
    best: &[f64],
    slipped: &[bool],
    seed: u64,
) -> Option<Alone> {
    let of_each = places.iter().filter_map(|left| Some((left, autoregression(left, &problem.train)?)));
    let (left, found) = of_each.min_by(|a, b| a.1.mse.total_cmp(&b.1.mse))?;
    let models = judge(problem, left, best, slipped, seed);
    let first = first_order_under_white(left, &problem.train);
    let beyond_first = models.beyond_first.min(libm::log((first / found.mse).max(1e-30)));
    let e: Vec<f64> = found.innovations.iter().map(|(_, e)| *e).collect();
    let powers = e.iter().fold([0.0; 2], |s, x| [s[0] + x * x, s[1] + x * x * x * x]);
    let tails = powers[1] * e.len() as f64 / (powers[0] * powers[0]).max(1e-300) - 3.0;
    Some(Alone { models: NoiseModels { beyond_first, ..models }, tails })
}

/// Smallest p of the innovations' independence from what OP did before, from slips and from the level, by circular
/// shifts. Innovations, because under feedback OP carries the residual's own past.
fn independence(problem: &Problem, found: &Autoregression, slipped: &[bool], seed: u64) -> f64 {
    let op = &problem.normalised.mean;
    let places: Vec<usize> = found.innovations.iter().map(|(k, _)| *k).collect();
    let e: Vec<f64> = found.innovations.iter().map(|(_, e)| *e).collect();
    let n = e.len();
    let stride = ((problem.longest_lag() / LAGS as f64).ceil() as usize).max(1);
    let mut series: Vec<Vec<f64>> = Vec::new();
    for lag in (1..=LAGS).map(|l| l * stride) {
        let back = |k: usize, more: usize| op[k.saturating_sub(lag + more)];
        series.push(places.iter().map(|k| back(*k, 0)).collect());
        series.push(places.iter().map(|k| back(*k, 0) - back(*k, stride)).collect());
    }
    let levels: Vec<f64> = places.iter().map(|k| problem.normalised.pv[k.saturating_sub(1)]).collect();
    series.push(levels.iter().map(|l| l * l).collect());
    series.push(levels);
    let after: Vec<f64> = places.iter().map(|k| f64::from(u8::from(slipped[*k]))).collect();
    for s in series.iter_mut() {
        standardise(s);
    }
    let mut slips = after;
    standardise(&mut slips);
    let statistic = |shift: usize| -> [f64; 2] {
        let turned: Vec<f64> = (0..n).map(|i| e[(i + shift) % n]).collect();
        let mut squares: Vec<f64> = turned.iter().map(|x| x * x).collect();
        standardise(&mut squares);
        let linear = series.iter().map(|s| stats::dot(s, &turned).abs()).fold(0.0, f64::max);
        [linear, stats::dot(&slips, &squares).abs()]
    };
    let own = statistic(0);
    let mut rng = Noise::new(seed, 77);
    let mut above = [1_usize; 2];
    for _ in 0..SHIFTS {
        let shift = n / 20 + rng.below((n - n / 10).max(1) as u64) as usize;
        for (count, (other, own)) in above.iter_mut().zip(statistic(shift).into_iter().zip(own)) {
            *count += usize::from(other >= own);
        }
    }
    let least = above.into_iter().min().unwrap_or(1) as f64;
    (2.0 * least / (SHIFTS + 1) as f64).min(1.0)
}

fn standardise(x: &mut [f64]) {
    let (mean, sd) = (stats::mean(x), stats::std_dev(x));
    for v in x.iter_mut() {
        *v = if sd > 0.0 { (*v - mean) / sd } else { 0.0 };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
    fn white_noise_does_not_hide_a_memory_of_first_order() {
        let (slow, white) = (noise(3000), Noise::new(4, 0));
        let (mut white, mut memory) = (white, 0.0);
        let x: Vec<f64> = slow
            .iter()
            .map(|e| {
                memory = 0.97 * memory + e;
                memory + 2.0 * white.gaussian()
            })
            .collect();
        let stretches = [[0, 1500], [1600, 3000]];
        let found = autoregression(&x, &stretches).unwrap().mse;
        let plain = of_order(&x, &stretches, 1).unwrap().mse;
        let under_white = first_order_under_white(&x, &stretches);
        assert!(
            libm::log(plain / found) > 0.1 && libm::log(under_white / found) < 0.03,
            "{found} {plain} {under_white}"
        );
    }

    #[test]
    fn an_autoregression_finds_the_innovations() {
        let mut x = noise(3000);
        for k in 1..x.len() {
            x[k] += 0.9 * x[k - 1];
        }
        let found = autoregression(&x, &[[0, 1500], [1600, 3000]]).unwrap();
        assert!((found.mse - 1.0).abs() < 0.1, "{}", found.mse);
    }
}
