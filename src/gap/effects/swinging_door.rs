//! PV on straight lines between the values that a recorder kept (swinging door).

use super::{Effect, MARGIN, Stage, Way, nothing, once, outside};

/// As the catalogue has it.
pub const EFFECT: Effect = Effect {
    id: "swinging_door",
    stage: Stage::Measurement,
    way: Way::Signature,
    params: &[],
    enter: outside,
    starts: once,
    linear: nothing,
    margin: MARGIN,
    predictable: true,
    confused_with: &["hold_compression"],
    separated_by: "the historian's compression setting, or PV taken from the bus",
};
