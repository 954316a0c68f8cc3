//! PV stands still for a while, and then goes on.

use super::{Effect, Stage, Way};

/// As the catalogue has it.
pub const EFFECT: Effect = Effect {
    stage: Stage::Measurement,
    predictable: true,
    confused_with: &["hold_compression"],
    separated_by: "a second sensor",
    ..Effect::unsimulated("frozen_sensor", Way::Signature)
};
