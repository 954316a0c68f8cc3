//! The deterministic half of the daemon: payloads to samples, samples to windows, windows to estimates and alarms.
//!
//! | module | |
//! |---|---|
//! | [`codec`] | bytes to samples; topics |
//! | `hash` | short hashes |
//! | [`alarm`] | ISA-18.2 states |
//! | [`engine`] | one state machine per loop |
//! | [`config`] | settings from text, for daemon, engine and alarm |
//! | [`expectations`] | what the daemon should report of known data |
//! | [`status`] | the status of a loop and the plant, in one sign and one sentence |
//! | [`shard`] | which daemon watches which loop |
//! | [`analysis`] | samples of a recording to the answers of `analyze` and `gap` |
//!
//! [`engine::Engine`] gets time (timestamps of samples) and data from its caller. A fit leaves it as an [`engine::Request`],
//! and the caller computes the answer. The crate uses no file, socket, clock, thread, environment or unseeded random
//! numbers, so recorded data replay byte for byte: the daemon runs the same engine live and from a file.

#![cfg_attr(test, allow(clippy::disallowed_methods, clippy::disallowed_types))]

pub mod alarm;
pub mod analysis;
pub mod codec;
pub mod config;
pub mod engine;
pub mod expectations;
mod hash;
pub mod shard;
pub mod status;

pub use hash::{provenance, short_hash};
