//! Fitted parameters of the plant-wide judgement, in the file `calibration.json`, which stiction-lab writes.

use std::sync::LazyLock;

use serde::{Deserialize, Serialize};

use super::logit::Logit;

/// Rules and thresholds, fitted to simulated plants.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Calibration {
    /// Logit that a pair shares an oscillation.
    pub link: Logit,
    /// Links of unrelated pairs.
    pub chance: Chance,
    /// Logit that a member causes its group's oscillation.
    pub source: Logit,
    /// Logit that the valve of a member sticks.
    pub member: Logit,
    /// Probability by the member's rule below which a follower's own signs of stiction are attributed to the source.
    pub capped_below: f64,
    /// Data to which the rules were fitted.
    pub made: Made,
}

/// Link logits of pairs of loops from different plants with nearly equal periods.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Chance {
    /// Logit above which two loops are linked.
    pub threshold: f64,
    /// Share of the pairs above it.
    pub rate: f64,
    /// Decay of that share above the threshold: logits per factor e.
    pub decay: f64,
}

/// Data to which the rules were fitted.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Made {
    /// Simulated plants.
    pub plants: usize,
    /// Their loops.
    pub loops: usize,
    /// Pairs that share an oscillation, and pairs from different plants.
    pub pairs: [usize; 2],
    /// Seed of the first plant.
    pub seed: u64,
}

/// Number of pairs for which the threshold holds; with more pairs it rises, so that chance links stay as rare.
const PAIRS: f64 = 120.0;

impl Chance {
    /// Probability that an unrelated pair has at least this logit.
    #[must_use]
    pub fn p_value(&self, logit: f64) -> f64 {
        (self.rate * libm::exp(-(logit - self.threshold).max(0.0) / self.decay)).min(1.0)
    }

    /// The threshold if this many pairs are compared.
    #[must_use]
    pub(crate) fn threshold_among(&self, pairs: usize) -> f64 {
        self.threshold + self.decay * libm::log((pairs as f64 / PAIRS).max(1.0))
    }
}

impl Calibration {
    /// The parameters of this build.
    #[must_use]
    pub fn shipped() -> &'static Self {
        static SHIPPED: LazyLock<Calibration> = LazyLock::new(|| {
            // A test parses the file; without rules no loops are linked.
            let nothing = Calibration {
                chance: Chance { threshold: f64::INFINITY, ..Chance::default() },
                ..Calibration::default()
            };
            serde_json::from_str(include_str!("calibration.json")).unwrap_or(nothing)
        });
        &SHIPPED
    }
}
