//! PV cut off at the end of the transmitter's range.

use super::{Effect, Stage, Way};

/// As the catalogue has it.
pub const EFFECT: Effect = Effect {
    stage: Stage::Measurement,
    predictable: true,
    confused_with: &["travel_limit"],
    separated_by: "the transmitter's range",
    ..Effect::unsimulated("clipping", Way::Signature)
};
