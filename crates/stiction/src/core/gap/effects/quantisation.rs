//! PV on a grid that is coarse against its noise.

use super::effect::{Effect, Way};
use crate::core::gap::types::Stage;

/// As the catalogue has it.
pub(crate) const EFFECT: Effect = Effect {
    predictable: false,
    confused_with: &["hold_compression"],
    separated_by: "the transmitter's resolution",
    noun: "a coarse grid of PV",
    ..Effect::unsimulated("quantisation", Stage::Measurement, Way::Signature)
};
