//! Tools for sampled signals: alignment, history, statistics, spectra.

pub mod align;
#[cfg(test)]
mod align_check;
pub mod detrend;
pub mod held;
pub mod history;
pub mod lag;
mod op_trail;
pub mod resample;
pub mod spectrum;
pub mod stats;
