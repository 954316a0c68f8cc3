//! Seeded draws, disturbance shapes, and two statistics of a series.

use stiction::core::sim::disturbance::{Disturbance, DisturbanceState};
use stiction::core::sim::noise::{Noise, stream_of};

/// A source of draws with the ranges that loops need.
#[derive(Debug, Clone)]
pub struct Draw(Noise);

impl Draw {
    /// The draws of `seed` for a purpose; each purpose has its own stream.
    pub fn new(seed: u64, purpose: &str) -> Self {
        Self(Noise::new(seed, stream_of(purpose)))
    }

    /// Uniform between two values.
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.0.uniform()
    }

    /// Log-uniform between two positive values.
    pub fn log_between(&mut self, low: f64, high: f64) -> f64 {
        libm::exp(self.between(libm::log(low), libm::log(high)))
    }

    /// Whether an event of probability `p` occurs.
    pub fn chance(&mut self, p: f64) -> bool {
        self.0.chance(p)
    }

    /// 1 or -1.
    pub fn sign(&mut self) -> f64 {
        if self.chance(0.5) { 1.0 } else { -1.0 }
    }

    /// A random element; `or` for an empty slice.
    pub fn pick<T: Copy>(&mut self, from: &[T], or: T) -> T {
        from.get(self.0.below(from.len() as u64) as usize).copied().unwrap_or(or)
    }

    /// Standard normal.
    pub fn gaussian(&mut self) -> f64 {
        self.0.gaussian()
    }

    /// A seed for another generator.
    pub fn seed(&mut self) -> u64 {
        self.0.below(1 << 52)
    }

    /// A separate noise source.
    pub fn noise(&mut self) -> Noise {
        Noise::new(self.seed(), 1)
    }

    /// `n` values of a disturbance, with scans as its seconds.
    pub fn series(&mut self, shape: Disturbance, n: usize) -> Vec<f64> {
        let mut state = DisturbanceState::new(shape, 1.0, self.noise());
        (0..n).map(|k| state.at(k as f64)).collect()
    }

    /// A sine of amplitude 1 with random phase.
    pub fn sine(&mut self, period: f64, n: usize) -> Vec<f64> {
        let phase_deg = self.between(0.0, 360.0);
        self.series(Disturbance::Sine { amplitude: 1.0, period_s: period, phase_deg }, n)
    }

    /// Steps to levels of -1..1, each held for `hold` scans on average.
    pub fn steps(&mut self, hold: f64, n: usize) -> Vec<f64> {
        let (mut level, mut left) = (0.0, hold * self.between(0.2, 0.6));
        (0..n)
            .map(|_| {
                left -= 1.0;
                if left < 0.0 {
                    let next: f64 = self.between(0.3, 1.0) * self.sign();
                    level = if (next - level).abs() < 0.3 { -next } else { next };
                    left = hold * self.between(0.6, 1.4);
                }
                level
            })
            .collect()
    }

    /// A triangle of amplitude 1 with random phase.
    pub fn triangle(&mut self, period: f64, n: usize) -> Vec<f64> {
        let phase = self.between(0.0, 1.0);
        let at = |k: usize| {
            let turns = k as f64 / period + phase;
            4.0 * (turns - turns.floor() - 0.5).abs() - 1.0
        };
        (0..n).map(at).collect()
    }

    /// A square wave of amplitude 1 with random phase.
    pub fn square(&mut self, period: f64, n: usize) -> Vec<f64> {
        let phase = self.between(0.0, 1.0);
        let at = |k: usize| {
            let turns = k as f64 / period + phase;
            if turns - turns.floor() < 0.5 { 1.0 } else { -1.0 }
        };
        (0..n).map(at).collect()
    }

    /// Ramps between levels of -1..1, about `hold` scans each, with rests in between.
    pub fn ramps(&mut self, hold: f64, n: usize) -> Vec<f64> {
        let (mut out, mut level) = (Vec::with_capacity(n), 0.0);
        while out.len() < n {
            let rest = (hold * self.between(0.2, 0.8)) as usize;
            let over = (hold * self.between(0.4, 1.2)).max(1.0) as usize;
            let next = self.between(-1.0, 1.0);
            out.extend(core::iter::repeat_n(level, rest));
            out.extend((1..=over).map(|k| level + (next - level) * k as f64 / over as f64));
            level = next;
        }
        out.truncate(n);
        out
    }
}

/// Difference of maximum and minimum.
pub fn span(x: &[f64]) -> f64 {
    x.iter().copied().fold(f64::MIN, f64::max) - x.iter().copied().fold(f64::MAX, f64::min)
}

/// Standard deviation around the mean.
pub fn std_dev(x: &[f64]) -> f64 {
    let n = x.len().max(1) as f64;
    let mean = x.iter().sum::<f64>() / n;
    (x.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>() / n).sqrt()
}

/// `x` scaled so that its half span is `size`.
pub fn scaled(x: &[f64], size: f64) -> Vec<f64> {
    let by = size / (0.5 * span(x)).max(1e-12);
    x.iter().map(|v| v * by).collect()
}
