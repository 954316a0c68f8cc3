//! PV held by a recorder until it moves by more than a dead band.

use super::effect::{Effect, Way};
use crate::core::gap::traces::Traces;
use crate::core::gap::types::Stage;

/// As the catalogue has it.
pub(crate) const EFFECT: Effect = Effect {
    confused_with: &["swinging_door", "frozen_sensor"],
    separated_by: "the historian's exception setting, or PV taken from the bus",
    noun: "a history that holds values",
    recorder: Some(Traces::hold),
    ..Effect::unsimulated("hold_compression", Stage::Measurement, Way::Signature)
};
