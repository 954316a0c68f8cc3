//! OP and PV recorded with different delays, read from the lag at which the controller answers.

use super::effect::{Effect, Way};
use crate::core::gap::types::Stage;

/// As the catalogue has it.
pub(crate) const EFFECT: Effect = Effect {
    confused_with: &["dead_time_change"],
    separated_by: "stamps from the controller itself",
    noun: "stamps of OP and PV that lie apart",
    ..Effect::unsimulated("time_skew", Stage::Measurement, Way::Controller)
};
