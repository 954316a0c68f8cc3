//! A filter in the transmitter or in the PV block. It lags the noise as it lags the signal, which no lag of the process does.

use super::effect::{Effect, Way, said_already};
use crate::core::gap::types::Stage;

/// As the catalogue has it.
pub(crate) const EFFECT: Effect = Effect {
    bare: true,
    confused_with: &["extra_lag", "coloured_noise"],
    separated_by: "the filter setting of the transmitter or of the PV block",
    noun: "a filter in the measurement",
    phrase: |sizes| Some(format!("a filter in the measurement of {} s", sizes.said("lag")?)),
    in_loop: said_already,
    ..Effect::unsimulated("sensor_filter", Stage::Measurement, Way::Filter)
};
