//! Tools for sampled signals: detrending, resampling, statistics, spectra.

pub mod detrend;
pub mod held;
pub mod lag;
pub mod resample;
pub mod spectrum;
pub mod stats;
