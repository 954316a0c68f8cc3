//! Single samples far off.

use super::{Effect, MARGIN, Stage, Way, nothing, once, outside};

/// As the catalogue has it.
pub const EFFECT: Effect = Effect {
    id: "outliers",
    stage: Stage::Measurement,
    way: Way::Signature,
    params: &[],
    enter: outside,
    starts: once,
    linear: nothing,
    margin: MARGIN,
    predictable: true,
    confused_with: &["coloured_noise"],
    separated_by: "the transmitter's diagnostics",
};
