//! The daemon under faults, crashes, hostile clients and a restart of everything around it: what docs/dev/robustness.md promises.
//!
//! Most of it waits, so `tests/run.sh` runs it beside what computes.
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
