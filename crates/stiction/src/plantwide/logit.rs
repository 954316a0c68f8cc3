//! Logistic regression on a list of figures.

use serde::{Deserialize, Serialize};

/// `logit p = constant + sum of weight * (figure - mean) / scale`, each standardised figure limited to `+-limit`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Logit {
    /// Logit if every figure has its mean.
    pub constant: f64,
    /// Logit per standard deviation of each figure.
    pub weights: Vec<f64>,
    /// Mean of each figure over the calibration data.
    pub means: Vec<f64>,
    /// Standard deviation of each figure over the calibration data.
    pub scales: Vec<f64>,
    /// Largest standardised figure.
    pub limit: f64,
}

impl Logit {
    /// Contribution of each figure to the logit.
    pub fn parts<'a>(&'a self, figures: &'a [f64]) -> impl Iterator<Item = f64> + 'a {
        let standard = |k: usize, x: f64| ((x - self.means[k]) / self.scales[k]).clamp(-self.limit, self.limit);
        self.weights.iter().enumerate().zip(figures).map(move |((k, weight), x)| weight * standard(k, *x))
    }

    /// The logit.
    #[must_use]
    pub fn of(&self, figures: &[f64]) -> f64 {
        self.constant + self.parts(figures).sum::<f64>()
    }
}
