//! The daemon under faults, crashes, hostile clients and restarts of everything around it, as promised in
//! docs/dev/robustness.md.
//!
//! Most of these tests wait, so `tests/run.sh` runs them in parallel with those that compute.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod crashes;
#[cfg(target_os = "linux")]
mod faults;
#[cfg(feature = "tls")]
mod hardened;
mod hostile;
#[path = "../common/live.rs"]
mod live;
mod reload;
mod repaired;
mod service;
mod shards;
mod soak;
mod twice;
