//! Single samples far off.

use super::effect::{Effect, Way};
use crate::core::gap::types::Stage;

/// As the catalogue has it.
pub(crate) const EFFECT: Effect = Effect {
    // What the sensor made up is known only from PV itself.
    predictable: false,
    confused_with: &["coloured_noise"],
    separated_by: "the transmitter's diagnostics",
    noun: "single wild values",
    local: true,
    masks: true,
    ..Effect::unsimulated("outliers", Stage::Measurement, Way::Signature)
};
