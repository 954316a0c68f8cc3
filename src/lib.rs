//! placeholder map
pub mod alarm;
pub mod config;
pub mod record;
pub mod signal;
pub mod sim;
pub mod units;
pub mod verdict;

/// Version of the program, as documents carry it.
pub const VERSION: &str = env!("CARGO_PKG_VERSION");
