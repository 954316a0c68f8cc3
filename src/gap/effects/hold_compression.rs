//! PV held by a recorder until it moves by more than a dead band.

use super::{Effect, MARGIN, Stage, Way, nothing, once, outside};

/// As the catalogue has it.
pub const EFFECT: Effect = Effect {
    id: "hold_compression",
    stage: Stage::Measurement,
    way: Way::Signature,
    params: &[],
    enter: outside,
    starts: once,
    linear: nothing,
    margin: MARGIN,
    predictable: true,
    confused_with: &["swinging_door", "frozen_sensor"],
    separated_by: "the historian's exception setting, or PV taken from the bus",
};
