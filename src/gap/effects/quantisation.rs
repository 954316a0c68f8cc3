//! PV on a grid that is coarse against its noise.

use super::{Effect, MARGIN, Stage, Way, nothing, once, outside};

/// As the catalogue has it.
pub const EFFECT: Effect = Effect {
    id: "quantisation",
    stage: Stage::Measurement,
    way: Way::Signature,
    params: &[],
    enter: outside,
    starts: once,
    linear: nothing,
    margin: MARGIN,
    predictable: false,
    confused_with: &["hold_compression"],
    separated_by: "the transmitter's resolution",
};
