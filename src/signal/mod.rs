//! Tools on plain slices of samples.

pub mod detrend;
pub mod spectrum;
pub mod stats;
