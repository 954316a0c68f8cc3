//! PV stands still for a while, and then goes on.

use super::effect::{Effect, Way};
use crate::core::gap::traces::Traces;
use crate::core::gap::types::Stage;

/// As the catalogue has it.
pub(crate) const EFFECT: Effect = Effect {
    confused_with: &["hold_compression"],
    separated_by: "a second sensor",
    noun: "a frozen sensor",
    local: true,
    masks: true,
    recorder: Some(Traces::freeze),
    ..Effect::unsimulated("frozen_sensor", Stage::Measurement, Way::Signature)
};
