//! A disturbance without a shape: first-order autoregressive noise or a random walk. Free run cannot predict it; one step ahead it can.

use super::{Effect, MARGIN, Stage, Way, nothing, once, outside};

/// As the catalogue has it.
pub const EFFECT: Effect = Effect {
    id: "coloured_noise",
    stage: Stage::Disturbance,
    way: Way::Noise,
    params: &[],
    enter: outside,
    starts: once,
    linear: nothing,
    margin: MARGIN,
    predictable: false,
    confused_with: &["sinusoid", "ramp", "step_load"],
    separated_by: "the disturbance itself, or PV with OP held",
};
