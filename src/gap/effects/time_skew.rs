//! OP and PV recorded with different delays, read from the lag at which the controller answers.

use super::{Effect, Stage, Way};

/// As the catalogue has it.
pub const EFFECT: Effect = Effect {
    stage: Stage::Measurement,
    predictable: true,
    confused_with: &["dead_time_change"],
    separated_by: "stamps from the controller itself",
    ..Effect::unsimulated("time_skew", Way::Controller)
};
