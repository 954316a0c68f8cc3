//! The fitted numbers of the plant-wide judgement, in a file beside this one that the laboratory writes.

use std::sync::LazyLock;

use serde::{Deserialize, Serialize};

use super::logit::Logit;

/// Rules and thresholds, fitted to simulated plants.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Calibration {
    /// Logit that a pair shares one oscillation.
    pub link: Logit,
    /// What pairs that share nothing give.
    pub chance: Chance,
    /// Logit that a member makes its group's oscillation.
    pub source: Logit,
    /// Logit that the valve of a member sticks.
    pub member: Logit,
    /// Probability of the member's rule below which a follower's own stiction is taken for the source's.
    pub capped_below: f64,
    /// What it was fitted to.
    pub made: Made,
}

/// Link logits of pairs of loops of different plants whose periods nearly agree.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Chance {
    /// Logit above which two loops are linked.
    pub threshold: f64,
    /// Share of the pairs above it.
    pub rate: f64,
    /// How fast that share falls above the threshold: by a factor e over so many logits.
    pub decay: f64,
}

/// What the rules were fitted to.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Made {
    /// Simulated plants.
    pub plants: usize,
    /// Their loops.
    pub loops: usize,
    /// Pairs of one oscillation, and of different plants.
    pub pairs: [usize; 2],
    /// Seed of the first plant.
    pub seed: u64,
}

/// Pairs at which the threshold is meant; where more are compared, it rises so that chance links stay as rare.
const PAIRS: f64 = 120.0;

impl Chance {
    /// Probability that a pair which shares nothing has at least this logit.
    #[must_use]
    pub fn p_value(&self, logit: f64) -> f64 {
        (self.rate * libm::exp(-(logit - self.threshold).max(0.0) / self.decay)).min(1.0)
    }

    /// The threshold where so many pairs are compared.
    #[must_use]
    pub(crate) fn threshold_among(&self, pairs: usize) -> f64 {
        self.threshold + self.decay * libm::log((pairs as f64 / PAIRS).max(1.0))
    }
}

impl Calibration {
    /// The numbers of this build.
    #[must_use]
    pub fn shipped() -> &'static Self {
        static SHIPPED: LazyLock<Calibration> = LazyLock::new(|| {
            // A test reads the file; without rules nothing is linked.
            let nothing = Calibration {
                chance: Chance { threshold: f64::INFINITY, ..Chance::default() },
                ..Calibration::default()
            };
            serde_json::from_str(include_str!("calibration.json")).unwrap_or(nothing)
        });
        &SHIPPED
    }
}
