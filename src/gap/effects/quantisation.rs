//! PV on a grid that is coarse against its noise.

use super::{Effect, Stage, Way};

/// As the catalogue has it.
pub const EFFECT: Effect = Effect {
    stage: Stage::Measurement,
    predictable: false,
    confused_with: &["hold_compression"],
    separated_by: "the transmitter's resolution",
    ..Effect::unsimulated("quantisation", Way::Signature)
};
