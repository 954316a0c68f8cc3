//! A noise by its autocovariance: white, two correlated parts, and a stochastic cycle (Harvey 1989, ch. 2.3), which
//! is a rotation that is damped and driven by noise: `variance exp(-lag / decay) cos(2 pi lag / period)`.
//!
//! Such a covariance is factored as `L D L'` in time proportional to its length (Foreman-Mackey and others, arXiv
//! 1703.09710).

use core::f64::consts::TAU;

/// Columns of the factors: one for each correlated part, two for a cycle.
const MOST: usize = 4;
/// Least variance of an innovation, that of PV being 1.
const LEAST: f64 = 1e-12;

/// One that correlated: its variance and the points after which its autocorrelation has fallen to 1/e.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct CorrelatedNoise {
    pub variance: f64,
    pub decay: f64,
}

/// An oscillation whose amplitude and phase are such noises, and its period, points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct StochasticCycle {
    pub envelope: CorrelatedNoise,
    pub period: f64,
}

impl StochasticCycle {
    /// Periods after which its autocorrelation has fallen to 1/e.
    pub fn coherence(&self) -> f64 {
        self.envelope.decay / self.period
    }
}

/// The noise.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Kernel {
    /// Variance of the white part.
    pub white: f64,
    pub correlated: [CorrelatedNoise; 2],
    pub cycle: Option<StochasticCycle>,
}

/// The factors of its covariance.
#[derive(Debug, Clone)]
pub(super) struct Factors {
    decay_per_box: [f64; MOST],
    u: Vec<[f64; MOST]>,
    w: Vec<[f64; MOST]>,
    /// Variance of each innovation.
    pub variances: Vec<f64>,
}

fn product(x: &[f64; MOST], y: &[f64; MOST]) -> f64 {
    x[0] * y[0] + x[1] * y[1] + x[2] * y[2] + x[3] * y[3]
}

impl Kernel {
    /// The factors for `n` points; `None` where the covariance is singular or no number.
    pub fn factors(&self, n: usize) -> Option<Factors> {
        let [slow, quick] = self.correlated;
        let none = StochasticCycle { envelope: CorrelatedNoise { variance: 0.0, decay: 1.0 }, period: 1.0 };
        let cycle = self.cycle.unwrap_or(none);
        let decay_per_box = [slow, quick, cycle.envelope, cycle.envelope].map(|noise| libm::exp(-1.0 / noise.decay));
        let (sin, cos) = (libm::sin(TAU / cycle.period), libm::cos(TAU / cycle.period));
        let size = cycle.envelope.variance;
        let whole = self.white + slow.variance + quick.variance + size;
        let (mut s, mut c) = (0.0, 1.0);
        let mut sums = [[0.0; MOST]; MOST];
        let mut out = Factors {
            decay_per_box,
            u: Vec::with_capacity(n),
            w: Vec::with_capacity(n),
            variances: Vec::with_capacity(n),
        };
        for _ in 0..n {
            let u = [slow.variance, quick.variance, size * c, size * s];
            let known: [f64; MOST] = core::array::from_fn(|i| product(&sums[i], &u));
            let d = whole - product(&known, &u);
            if d.is_nan() || d <= LEAST {
                return None;
            }
            let v = [1.0, 1.0, c, s];
            let w: [f64; MOST] = core::array::from_fn(|i| (v[i] - known[i]) / d);
            for i in 0..MOST {
                for j in 0..MOST {
                    sums[i][j] = decay_per_box[i] * decay_per_box[j] * (sums[i][j] + d * w[i] * w[j]);
                }
            }
            (s, c) = (s * cos + c * sin, c * cos - s * sin);
            out.u.push(u);
            out.w.push(w);
            out.variances.push(d);
        }
        Some(out)
    }
}

impl Factors {
    /// The innovations of a series, in standard deviations of each.
    pub fn whitened(&self, x: &[f64]) -> Vec<f64> {
        let mut state = [0.0; MOST];
        let mut out = Vec::with_capacity(x.len());
        for (k, x) in x.iter().enumerate() {
            let e = x - product(&self.u[k], &state);
            state = core::array::from_fn(|i| self.decay_per_box[i] * (state[i] + self.w[k][i] * e));
            out.push(e / self.variances[k].sqrt());
        }
        out
    }

    /// The inverse of the covariance times a series that is whitened.
    fn solved(&self, whitened: &[f64]) -> Vec<f64> {
        let mut state = [0.0; MOST];
        let mut out = vec![0.0; whitened.len()];
        for k in (0..whitened.len()).rev() {
            let x = whitened[k] / self.variances[k].sqrt() - product(&self.w[k], &state);
            out[k] = x;
            // From this point to the one before.
            state = core::array::from_fn(|i| self.decay_per_box[i] * (state[i] + self.u[k][i] * x));
        }
        out
    }

    /// What of a whitened series is likeliest the cycle's.
    pub fn cycle(&self, cycle: StochasticCycle, whitened: &[f64]) -> Vec<f64> {
        let x = self.solved(whitened);
        let decay_per_box = libm::exp(-1.0 / cycle.envelope.decay);
        let turn = [decay_per_box * libm::cos(TAU / cycle.period), decay_per_box * libm::sin(TAU / cycle.period)];
        let before = turned(turn, x.iter());
        let mut after = turned(turn, x.iter().rev());
        after.reverse();
        let sum = |((own, before), after): ((&f64, &f64), &f64)| cycle.envelope.variance * (own + before + after);
        x.iter().zip(&before).zip(&after).map(sum).collect()
    }
}

/// At each point the sum of those before, each turned and damped once a point.
fn turned<'x>([cos, sin]: [f64; 2], x: impl Iterator<Item = &'x f64>) -> Vec<f64> {
    let (mut re, mut im) = (0.0, 0.0);
    let step = |x: &f64| {
        let sum = re;
        (re, im) = ((re + x) * cos - im * sin, (re + x) * sin + im * cos);
        sum
    };
    x.map(step).collect()
}

#[cfg(test)]
mod tests {
    use nalgebra::{DMatrix, DVector};

    use super::*;
    use crate::core::sim::noise::Noise;

    #[test]
    fn factors_are_those_of_the_whole_covariance() {
        let correlated = |variance: f64, decay: f64| CorrelatedNoise { variance, decay };
        let cycle = StochasticCycle { envelope: correlated(0.7, 30.0), period: 11.0 };
        let kernel =
            Kernel { white: 0.1, correlated: [correlated(0.4, 3.0), correlated(0.2, 50.0)], cycle: Some(cycle) };
        let n = 60;
        let mut noise = Noise::new(3, 1);
        let y: Vec<f64> = (0..n).map(|_| noise.gaussian()).collect();
        let of_cycle = DMatrix::from_fn(n, n, |i, j| {
            let lag = i.abs_diff(j) as f64;
            0.7 * libm::exp(-lag / 30.0) * libm::cos(TAU * lag / 11.0)
        });
        let whole = DMatrix::from_fn(n, n, |i, j| {
            let lag = i.abs_diff(j) as f64;
            let white = if i == j { 0.1 } else { 0.0 };
            white + 0.4 * libm::exp(-lag / 3.0) + 0.2 * libm::exp(-lag / 50.0)
        }) + &of_cycle;
        let factors = kernel.factors(n).unwrap();
        let whitened = factors.whitened(&y);
        let cholesky = whole.cholesky().unwrap();
        let solved = cholesky.solve(&DVector::from_column_slice(&y));
        let logs: f64 = factors.variances.iter().map(|d| libm::log(*d)).sum();
        assert!((logs - libm::log(cholesky.determinant())).abs() < 1e-9);
        let power: f64 = whitened.iter().map(|e| e * e).sum();
        assert!((power - solved.dot(&DVector::from_column_slice(&y))).abs() < 1e-9);
        let found = factors.cycle(cycle, &whitened);
        let want = of_cycle * solved;
        assert!(found.iter().zip(want.iter()).all(|(x, y)| (x - y).abs() < 1e-9), "{found:?}");
    }
}
