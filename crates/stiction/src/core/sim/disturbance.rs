//! External disturbances of a loop, as signals over time.

use serde::Deserialize;

use super::noise::{Ar1, Noise, RandomWalk};

/// Shape of a disturbance. Sizes are in OP units at the process input and in PV units at PV; times count from the
/// start of the recording.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Disturbance {
    /// `amplitude * sin(2 pi t / period_s + phase)`.
    Sine {
        /// Half the peak-to-peak value.
        amplitude: f64,
        /// Period, s.
        period_s: f64,
        /// Phase at the start, degrees.
        #[serde(default)]
        phase_deg: f64,
    },
    /// `+amplitude` for half a period, then `-amplitude`.
    Square {
        /// Half the peak-to-peak value.
        amplitude: f64,
        /// Period, s.
        period_s: f64,
    },
    /// From 0 to `size` at `at_s`, permanently.
    Step {
        /// Height.
        size: f64,
        /// Time, s.
        at_s: f64,
    },
    /// From 0 at `from_s` to `size` at `from_s + over_s`, then constant.
    Ramp {
        /// Height at the end.
        size: f64,
        /// Start, s.
        from_s: f64,
        /// Duration, s.
        over_s: f64,
    },
    /// Coloured noise (first-order autoregressive).
    Ar1 {
        /// Standard deviation.
        sd: f64,
        /// Time after which its autocorrelation has fallen to 1/e, s.
        time_constant_s: f64,
    },
    /// A random walk from 0.
    RandomWalk {
        /// Standard deviation after one second; it grows with the square root of time.
        sd_per_root_s: f64,
    },
}

impl Disturbance {
    /// Invalid keys of the disturbance with reasons; empty if it is valid.
    #[must_use]
    pub fn faults(&self) -> Vec<(&'static str, String)> {
        let mut faults = Vec::new();
        let mut need = |ok: bool, key: &'static str, value: f64, want: &str| {
            if !ok {
                faults.push((key, format!("is {value}, but must be {want}")));
            }
        };
        let finite = "a finite number";
        match *self {
            Self::Sine { amplitude, period_s, phase_deg } => {
                need(amplitude.is_finite(), "amplitude", amplitude, finite);
                need(period_s.is_finite() && period_s > 0.0, "period_s", period_s, "greater than 0");
                need(phase_deg.is_finite(), "phase_deg", phase_deg, finite);
            }
            Self::Square { amplitude, period_s } => {
                need(amplitude.is_finite(), "amplitude", amplitude, finite);
                need(period_s.is_finite() && period_s > 0.0, "period_s", period_s, "greater than 0");
            }
            Self::Step { size, at_s } => {
                need(size.is_finite(), "size", size, finite);
                need(at_s.is_finite(), "at_s", at_s, finite);
            }
            Self::Ramp { size, from_s, over_s } => {
                need(size.is_finite(), "size", size, finite);
                need(from_s.is_finite(), "from_s", from_s, finite);
                need(over_s.is_finite() && over_s > 0.0, "over_s", over_s, "greater than 0");
            }
            Self::Ar1 { sd, time_constant_s } => {
                need(sd.is_finite() && sd >= 0.0, "sd", sd, "0 or more");
                let ok = time_constant_s.is_finite() && time_constant_s >= 0.0;
                need(ok, "time_constant_s", time_constant_s, "0 or more");
            }
            Self::RandomWalk { sd_per_root_s } => {
                let ok = sd_per_root_s.is_finite() && sd_per_root_s >= 0.0;
                need(ok, "sd_per_root_s", sd_per_root_s, "0 or more");
            }
        }
        faults
    }
}

impl core::fmt::Display for Disturbance {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match *self {
            Self::Sine { amplitude, period_s, .. } => write!(f, "sine of amplitude {amplitude}, period {period_s} s"),
            Self::Square { amplitude, period_s } => {
                write!(f, "square wave of amplitude {amplitude}, period {period_s} s")
            }
            Self::Step { size, at_s } => write!(f, "step of {size} at {at_s} s"),
            Self::Ramp { size, from_s, over_s } => write!(f, "ramp to {size} from {from_s} s over {over_s} s"),
            Self::Ar1 { sd, time_constant_s } => {
                write!(f, "coloured noise of sd {sd}, time constant {time_constant_s} s")
            }
            Self::RandomWalk { sd_per_root_s } => write!(f, "random walk of sd {sd_per_root_s} per root second"),
        }
    }
}

/// A disturbance with its state.
#[derive(Debug, Clone)]
pub struct DisturbanceState {
    shape: Disturbance,
    random: Option<Random>,
}

#[derive(Debug, Clone)]
enum Random {
    Ar1(Ar1),
    Walk(RandomWalk),
}

impl DisturbanceState {
    /// A disturbance sampled every `ts_s` seconds; only random shapes use `noise`.
    #[must_use]
    pub fn new(shape: Disturbance, ts_s: f64, noise: Noise) -> Self {
        let random = match shape {
            Disturbance::Ar1 { sd, time_constant_s } => Some(Random::Ar1(Ar1::new(sd, time_constant_s / ts_s, noise))),
            Disturbance::RandomWalk { sd_per_root_s } => {
                Some(Random::Walk(RandomWalk::new(sd_per_root_s * ts_s.sqrt(), noise)))
            }
            _ => None,
        };
        Self { shape, random }
    }

    /// The value at `t_s` seconds after the start; random shapes advance by one sample instead.
    pub fn at(&mut self, t_s: f64) -> f64 {
        match &mut self.random {
            Some(Random::Ar1(ar)) => return ar.next_value(),
            Some(Random::Walk(walk)) => return walk.next_value(),
            None => {}
        }
        match self.shape {
            Disturbance::Sine { amplitude, period_s, phase_deg } => {
                let turns = t_s / period_s + phase_deg / 360.0;
                amplitude * libm::sin(2.0 * core::f64::consts::PI * (turns - turns.floor()))
            }
            Disturbance::Square { amplitude, period_s } => {
                let turns = t_s / period_s;
                if turns - turns.floor() < 0.5 { amplitude } else { -amplitude }
            }
            Disturbance::Step { size, at_s } => {
                if t_s >= at_s {
                    size
                } else {
                    0.0
                }
            }
            Disturbance::Ramp { size, from_s, over_s } => size * ((t_s - from_s) / over_s).clamp(0.0, 1.0),
            Disturbance::Ar1 { .. } | Disturbance::RandomWalk { .. } => 0.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn values(shape: Disturbance, times: &[f64]) -> Vec<f64> {
        let mut state = DisturbanceState::new(shape, 1.0, Noise::new(1, 0));
        times.iter().map(|&t| state.at(t)).collect()
    }

    #[test]
    fn shapes_have_their_values() {
        let sine = values(Disturbance::Sine { amplitude: 2.0, period_s: 40.0, phase_deg: 90.0 }, &[0.0, 10.0, 20.0]);
        for (got, want) in sine.iter().zip([2.0, 0.0, -2.0]) {
            assert!((got - want).abs() < 1e-12);
        }
        let square = Disturbance::Square { amplitude: 1.5, period_s: 10.0 };
        assert_eq!(values(square, &[-1.0, 0.0, 4.9, 5.0, 10.0]), [-1.5, 1.5, 1.5, -1.5, 1.5]);
        assert_eq!(values(Disturbance::Step { size: 3.0, at_s: 5.0 }, &[4.9, 5.0, 99.0]), [0.0, 3.0, 3.0]);
        let ramp = Disturbance::Ramp { size: -4.0, from_s: 10.0, over_s: 20.0 };
        assert_eq!(values(ramp, &[0.0, 15.0, 30.0, 99.0]), [0.0, -1.0, -4.0, -4.0]);
    }

    #[test]
    fn impossible_sizes_are_named() {
        let bad = Disturbance::Sine { amplitude: f64::NAN, period_s: 0.0, phase_deg: 0.0 };
        let keys: Vec<&str> = bad.faults().iter().map(|f| f.0).collect();
        assert_eq!(keys, ["amplitude", "period_s"]);
        assert!(Disturbance::Ar1 { sd: 1.0, time_constant_s: 5.0 }.faults().is_empty());
        assert_eq!(Disturbance::Ramp { size: 1.0, from_s: 0.0, over_s: -1.0 }.faults().len(), 1);
        assert_eq!(Disturbance::RandomWalk { sd_per_root_s: -1.0 }.faults().len(), 1);
    }
}
