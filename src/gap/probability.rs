//! How sure a call is: a logistic function of a few features, its coefficients calibrated on generated loops.

use std::sync::OnceLock;

use serde::{Deserialize, Serialize};

/// What is known about a call.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Features {
    /// Training evidence of the best effect beyond its margin.
    pub lead: f64,
    /// By how much it leads the second.
    pub ahead: f64,
    /// Whether its fit is at the noise floor.
    pub at_floor: bool,
    /// Share of the gap that it closes on held-out blocks.
    pub closed: f64,
    /// By how much a noise model of the base beats it, log mean squared error.
    pub over_best: f64,
    /// Whether the record is excited beyond a plain cycle.
    pub excited: bool,
}

impl Features {
    /// As the logistic sees them: a constant first, everything bounded.
    #[must_use]
    pub fn columns(&self) -> [f64; COLUMNS] {
        let unit = |x: f64| x.clamp(-1.0, 1.0);
        let flag = |x: bool| f64::from(u8::from(x));
        [
            1.0,
            unit(self.lead),
            unit(2.0 * self.ahead),
            flag(self.at_floor),
            unit(self.closed),
            unit(self.over_best),
            flag(self.excited),
        ]
    }
}

/// Columns of the logistic.
pub const COLUMNS: usize = 7;

/// Thresholds and coefficients, as the calibration writes them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Calibration {
    /// A noise model this much better than the best structural one rejects it, log mean squared error.
    pub reject: f64,
    /// Probability that a call made from a trace in the data is right.
    pub trace: f64,
    /// Logistic coefficients for named effects.
    pub named: [f64; COLUMNS],
    /// For `none`.
    pub none: [f64; COLUMNS],
    /// For `unknown` and `coloured_noise`.
    pub rejected: [f64; COLUMNS],
    /// Where they come from.
    pub from: String,
}

fn calibration() -> &'static Calibration {
    static READ: OnceLock<Calibration> = OnceLock::new();
    READ.get_or_init(|| {
        serde_json::from_str(include_str!("calibration.json")).unwrap_or(Calibration {
            reject: 0.25,
            trace: 0.9,
            named: [0.0; COLUMNS],
            none: [0.0; COLUMNS],
            rejected: [0.0; COLUMNS],
            from: String::new(),
        })
    })
}

fn logistic(coefficients: &[f64; COLUMNS], features: &Features) -> f64 {
    let z: f64 = coefficients.iter().zip(features.columns()).map(|(c, x)| c * x).sum();
    1.0 / (1.0 + libm::exp(-z))
}

/// Probability that a named effect is right.
#[must_use]
pub fn of_named(features: &Features) -> f64 {
    logistic(&calibration().named, features)
}

/// Probability that `none` is right.
#[must_use]
pub fn of_none(features: &Features) -> f64 {
    logistic(&calibration().none, features)
}

/// Probability that `unknown` or `coloured_noise` is right.
#[must_use]
pub fn of_rejected(features: &Features) -> f64 {
    logistic(&calibration().rejected, features)
}

/// Probability of a call from a trace in the data.
#[must_use]
pub fn of_trace() -> f64 {
    calibration().trace
}

/// From here on a noise model rejects the best structural one.
#[must_use]
pub fn reject_margin() -> f64 {
    calibration().reject
}

/// Fits the coefficients to calls of known outcome: Newton steps with a ridge of `ridge` on all but the constant.
/// Cases are features and whether the call was right.
#[must_use]
pub fn calibrate(cases: &[(Features, bool)], ridge: f64) -> [f64; COLUMNS] {
    let mut w = [0.0; COLUMNS];
    for _ in 0..30 {
        let mut hessian = nalgebra::SMatrix::<f64, COLUMNS, COLUMNS>::zeros();
        let mut slope = nalgebra::SVector::<f64, COLUMNS>::zeros();
        for (features, right) in cases {
            let x = nalgebra::SVector::<f64, COLUMNS>::from(features.columns());
            let p = logistic(&w, features);
            slope += x * (f64::from(u8::from(*right)) - p);
            hessian += x * x.transpose() * (p * (1.0 - p)).max(1e-6);
        }
        for i in 0..COLUMNS {
            let held = if i == 0 { 1e-3 } else { ridge };
            hessian[(i, i)] += held;
            slope[i] -= held * w[i];
        }
        let Some(step) = hessian.lu().solve(&slope) else { break };
        for (value, by) in w.iter_mut().zip(step.iter()) {
            *value += by;
        }
        if step.norm() < 1e-9 {
            break;
        }
    }
    w
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shipped_calibration_is_read_and_sane() {
        assert!(!calibration().from.is_empty() && calibration().reject > 0.0 && of_trace() > 0.5);
        let weak = Features { lead: 0.01, ahead: 0.0, at_floor: false, closed: 0.0, over_best: 0.2, excited: false };
        let strong = Features { lead: 1.0, ahead: 0.5, at_floor: true, closed: 0.9, over_best: -0.1, excited: true };
        assert!(of_named(&strong) > of_named(&weak));
    }

    #[test]
    fn coefficients_are_recovered() {
        let mut noise = crate::sim::noise::Noise::new(5, 0);
        let cases: Vec<(Features, bool)> = (0..4000)
            .map(|_| {
                let lead = noise.uniform();
                let f = Features { lead, ahead: 0.0, at_floor: false, closed: 0.0, over_best: 0.0, excited: false };
                let p = 1.0 / (1.0 + libm::exp(-(4.0 * lead - 1.5)));
                (f, noise.chance(p))
            })
            .collect();
        let w = calibrate(&cases, 0.1);
        assert!((w[1] - 4.0).abs() < 0.5 && (w[0] + 1.5).abs() < 0.3, "{w:?}");
    }
}
