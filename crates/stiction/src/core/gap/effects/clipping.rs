//! PV cut off at the end of the transmitter's range.

use super::effect::{Effect, Way};
use crate::core::gap::traces::Traces;
use crate::core::gap::types::Stage;

/// As the catalogue has it.
pub(crate) const EFFECT: Effect = Effect {
    confused_with: &["travel_limit"],
    separated_by: "the transmitter's range",
    noun: "a transmitter at the end of its range",
    local: true,
    recorder: Some(Traces::clip),
    ..Effect::unsimulated("clipping", Stage::Measurement, Way::Signature)
};
