//! PV on straight lines between the values that a recorder kept (swinging door).

use super::effect::{Effect, Way};
use crate::core::gap::traces::Traces;
use crate::core::gap::types::Stage;

/// As the catalogue has it.
pub(crate) const EFFECT: Effect = Effect {
    confused_with: &["hold_compression"],
    separated_by: "the historian's compression setting, or PV taken from the bus",
    noun: "a history of straight lines",
    recorder: Some(Traces::straighten),
    ..Effect::unsimulated("swinging_door", Stage::Measurement, Way::Signature)
};
