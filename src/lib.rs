//! placeholder map
#[cfg(feature = "daemon")]
pub mod cli;
pub mod codec;
#[cfg(feature = "daemon")]
pub mod files;
pub mod record;
pub mod sim;
pub mod units;
pub mod verdict;

/// Version of the program, as documents carry it.
pub const VERSION: &str = env!("CARGO_PKG_VERSION");
