//! placeholder map
pub mod detect;
pub mod ident;
pub mod optim;
pub mod record;
pub mod signal;
pub mod sim;
pub mod units;
pub mod verdict;

/// Version of the program, as documents carry it.
pub const VERSION: &str = env!("CARGO_PKG_VERSION");
