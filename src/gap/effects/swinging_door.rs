//! PV on straight lines between the values that a recorder kept (swinging door).

use super::{Effect, Stage, Way};

/// As the catalogue has it.
pub const EFFECT: Effect = Effect {
    stage: Stage::Measurement,
    predictable: true,
    confused_with: &["hold_compression"],
    separated_by: "the historian's compression setting, or PV taken from the bus",
    ..Effect::unsimulated("swinging_door", Way::Signature)
};
