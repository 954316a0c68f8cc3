//! Classes of process model: the response to the valve signal, and the free response of the initial state (the "memory").
//!
//! Lags, times and gains are in points here.

use crate::core::sim::process::{Pole, series_weights};

/// A class of process model.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Class {
    /// First order with dead time.
    First,
    /// Two different lags in series with dead time.
    Second,
    /// Integrator with dead time; its input's bias is fitted.
    Integrating,
    /// Lag before an integrator, with dead time.
    LagIntegrating,
}

/// Nonlinear parameters: logarithms of the time constants (points), then the lag (points). Unused entries are 0.
pub type Shape = [f64; 3];

/// Limits of [`Shape`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// Time constants, points.
    pub tau: [f64; 2],
    /// Lag, points.
    pub lag: [f64; 2],
}

/// Scale of an integrator's gain, points: its response then has the size of its input.
pub(super) const INTEGRATOR_SCALE: f64 = 50.0;

impl Class {
    /// Entries of [`Shape`] in use; the last one is the lag.
    #[must_use]
    pub(crate) const fn shape_len(self) -> usize {
        match self {
            Self::Integrating => 1,
            Self::First | Self::LagIntegrating => 2,
            Self::Second => 3,
        }
    }

    /// Columns of the process's memory, including the constant.
    #[must_use]
    pub(crate) const fn memory_len(self) -> usize {
        match self {
            Self::First | Self::Integrating => 2,
            Self::Second | Self::LagIntegrating => 3,
        }
    }

    /// Time constants in the model.
    #[must_use]
    pub(crate) const fn lags(self) -> usize {
        self.shape_len() - 1
    }

    /// Lags in the model: its order as reported.
    #[must_use]
    pub(crate) const fn order(self) -> u8 {
        match self {
            Self::First | Self::Integrating => 1,
            Self::Second | Self::LagIntegrating => 2,
        }
    }

    /// Whether the class integrates.
    #[must_use]
    pub(crate) const fn integrates(self) -> bool {
        matches!(self, Self::Integrating | Self::LagIntegrating)
    }

    /// The shape with these time constants, as far as the class has them, and a lag, points.
    #[must_use]
    pub(crate) fn shape(self, taus: [f64; 2], lag: f64) -> Shape {
        let [a, b] = taus.map(libm::log);
        match self {
            Self::First | Self::LagIntegrating => [a, lag, 0.0],
            Self::Second => [a, b, lag],
            Self::Integrating => [lag, 0.0, 0.0],
        }
    }

    /// A shape limited to the allowed range; the two lags of [`Class::Second`] are kept distinct and in falling order.
    #[must_use]
    pub(crate) fn clamp(self, mut shape: Shape, limits: &Limits) -> Shape {
        let last = self.shape_len() - 1;
        let low = libm::log(limits.tau[0]);
        let high = libm::log(limits.tau[1]);
        for value in &mut shape[..last] {
            *value = value.clamp(low, high);
        }
        shape[last] = shape[last].clamp(limits.lag[0], limits.lag[1]);
        if self == Self::Second {
            if shape[1] > shape[0] {
                shape.swap(0, 1);
            }
            if shape[0] - shape[1] < 1e-3 {
                shape[1] = shape[0] - 1e-3;
            }
        }
        shape
    }

    /// Lag of a shape, points.
    #[must_use]
    pub(crate) const fn lag(self, shape: &Shape) -> f64 {
        shape[self.shape_len() - 1]
    }

    /// Response of unit gain to a signal, from rest at its first value.
    #[must_use]
    pub(crate) fn respond(self, shape: &Shape, v: &[f64]) -> Vec<f64> {
        let late = self.lag(shape).max(0.0);
        let (lag, fraction) = (late.floor() as usize, late - late.floor());
        let behind = |pole: Pole, rest: f64| {
            let mut out = Vec::new();
            pole.run(lag, v, rest, &mut out);
            out
        };
        let rest = v.first().copied().unwrap_or(0.0);
        let tau = |slot: usize| libm::exp(shape[slot]);
        let behind_lag = |slot: usize| behind(Pole::lag(tau(slot), fraction), rest);
        let integral = || {
            let p = Pole::integrator(fraction);
            behind(Pole { a: p.a, b0: p.b0 / INTEGRATOR_SCALE, b1: p.b1 / INTEGRATOR_SCALE }, 0.0)
        };
        match self {
            Self::First => behind_lag(0),
            Self::Integrating => integral(),
            Self::Second => mixed(behind_lag(0), &behind_lag(1), series_weights(tau(0), tau(1))),
            // 1/(s (tau s + 1)) = 1/s - tau/(tau s + 1)
            Self::LagIntegrating => mixed(integral(), &behind_lag(0), (1.0, -tau(0) / INTEGRATOR_SCALE)),
        }
    }

    /// Column `index` of the process's memory at points `from..from + n`, filtered by `1 - rho q^-1`; ends where it has
    /// decayed.
    pub(crate) fn memory(self, shape: &Shape, index: usize, from: usize, n: usize, rho: f64, out: &mut Vec<f64>) {
        out.clear();
        let slot = match (self, index) {
            (_, 0) => {
                out.resize(n, 1.0 - rho);
                return;
            }
            (Self::Integrating | Self::LagIntegrating, 1) => {
                // The scale does not depend on the length, so that coefficients carry over.
                let scale = 1e-3;
                out.extend((0..n).map(|k| ((from + k) as f64 - rho * ((from + k) as f64 - 1.0)) * scale));
                return;
            }
            (Self::LagIntegrating, _) | (_, 1) => 0,
            _ => 1,
        };
        let a = libm::exp(-libm::exp(-shape[slot]));
        let mut value = 1.0;
        while out.len() < n && value >= 1e-14 {
            out.push(value);
            value *= a;
        }
    }

    /// Gain in signal units per valve unit (per point if integrating) from the coefficient of the unit response.
    #[must_use]
    pub(crate) fn gain(self, coefficient: f64) -> f64 {
        if self.integrates() { coefficient / INTEGRATOR_SCALE } else { coefficient }
    }
}

/// `w.0 x + w.1 z`.
fn mixed(mut x: Vec<f64>, z: &[f64], w: (f64, f64)) -> Vec<f64> {
    for (a, b) in x.iter_mut().zip(z) {
        *a = w.0 * *a + w.1 * b;
    }
    x
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_class_settles_or_integrates_as_its_step_response_says() {
        let v: Vec<f64> = (0..400).map(|k| f64::from(u8::from(k >= 10))).collect();
        let (slow, fast, lag) = (libm::log(8.0), libm::log(2.0), 3.5);
        for (class, shape) in [
            (Class::First, [slow, lag, 0.0]),
            (Class::Second, [slow, fast, lag]),
            (Class::Integrating, [lag, 0.0, 0.0]),
            (Class::LagIntegrating, [fast, lag, 0.0]),
        ] {
            let x = class.respond(&shape, &v);
            assert!(x[10].abs() < 1e-12, "{class:?}");
            let slope = (x[399] - x[398]) * class.gain(1.0).recip();
            if class.integrates() {
                assert!((slope - 1.0).abs() < 1e-9, "{class:?} {slope}");
            } else {
                assert!((x[399] - 1.0).abs() < 1e-9, "{class:?}");
            }
        }
    }

    #[test]
    fn shapes_are_kept_inside_their_limits() {
        let limits = Limits { tau: [0.3, 500.0], lag: [1.0, 25.0] };
        let shape = Class::Second.clamp([0.0, 9.0, 99.0], &limits);
        assert!(shape[0] > shape[1] && shape[2] == 25.0 && shape[0] <= libm::log(500.0));
    }
}
