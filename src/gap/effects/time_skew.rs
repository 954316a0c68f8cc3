//! OP and PV recorded with different delays, read from the lag at which the controller answers.

use super::{Effect, MARGIN, Stage, Way, nothing, once, outside};

/// As the catalogue has it.
pub const EFFECT: Effect = Effect {
    id: "time_skew",
    stage: Stage::Measurement,
    way: Way::Controller,
    params: &[],
    enter: outside,
    starts: once,
    linear: nothing,
    margin: MARGIN,
    predictable: true,
    confused_with: &["dead_time_change"],
    separated_by: "stamps from the controller itself",
};
