//! A disturbance without a shape: first-order autoregressive noise or a random walk. Free run cannot predict it; one step ahead it can.

use super::effect::{Effect, Way};
use crate::core::gap::types::Stage;

/// As the catalogue has it.
pub(crate) const EFFECT: Effect = Effect {
    predictable: false,
    confused_with: &["sinusoid", "ramp", "step_load"],
    separated_by: "the disturbance itself, or PV with OP held",
    noun: "a slow random disturbance",
    twin: Some("a random walk"),
    ..Effect::unsimulated("coloured_noise", Stage::Disturbance, Way::Noise)
};
