//! PV cut off at the end of the transmitter's range.

use super::{Effect, MARGIN, Stage, Way, nothing, once, outside};

/// As the catalogue has it.
pub const EFFECT: Effect = Effect {
    id: "clipping",
    stage: Stage::Measurement,
    way: Way::Signature,
    params: &[],
    enter: outside,
    starts: once,
    linear: nothing,
    margin: MARGIN,
    predictable: true,
    confused_with: &["travel_limit"],
    separated_by: "the transmitter's range",
};
