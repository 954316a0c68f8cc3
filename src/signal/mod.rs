//! Tools on sampled signals: joining, memory, statistics, spectra.

pub mod align;
pub mod history;
