//! Bands that differ from slip to slip, fs and fd in proportion: the packing holds the stem with a different force after each slip.

use super::effect::{Effect, Way};
use crate::core::gap::types::Stage;

/// As the catalogue has it.
pub(crate) const EFFECT: Effect = Effect {
    // When the stem slips is known only from PV itself.
    predictable: false,
    confused_with: &["asymmetric_stiction"],
    separated_by: "the valve position over several slips",
    noun: "friction that differs from slip to slip",
    needs_friction: true,
    phrase: |sizes| {
        let (fs, spread) = (sizes.said("median_fs")?, sizes.value("spread")?);
        let by = sizes.percent(spread);
        Some(format!("friction that differs from slip to slip: fs is {fs} OP units in the median and varies by {by}"))
    },
    ..Effect::unsimulated("random_friction", Stage::Valve, Way::Replay)
};
