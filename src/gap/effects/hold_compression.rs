//! PV held by a recorder until it moves by more than a dead band.

use super::{Effect, Stage, Way};

/// As the catalogue has it.
pub const EFFECT: Effect = Effect {
    stage: Stage::Measurement,
    predictable: true,
    confused_with: &["swinging_door", "frozen_sensor"],
    separated_by: "the historian's exception setting, or PV taken from the bus",
    ..Effect::unsimulated("hold_compression", Way::Signature)
};
