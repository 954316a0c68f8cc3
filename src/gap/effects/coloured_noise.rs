//! A disturbance without a shape: first-order autoregressive noise or a random walk. Free run cannot predict it; one step ahead it can.

use super::{Effect, Stage, Way};

/// As the catalogue has it.
pub const EFFECT: Effect = Effect {
    stage: Stage::Disturbance,
    predictable: false,
    confused_with: &["sinusoid", "ramp", "step_load"],
    separated_by: "the disturbance itself, or PV with OP held",
    ..Effect::unsimulated("coloured_noise", Way::Noise)
};
