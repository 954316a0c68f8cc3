//! Faults of the machine around the daemon, one process each: disk, clock, start, configuration, links.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]
#![cfg(target_os = "linux")]

mod clock;
mod disk;
mod link;
#[path = "../common/live.rs"]
mod live;
mod readers;
mod shim;
mod start;
