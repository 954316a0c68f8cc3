//! The deterministic half of the daemon: payloads to samples, samples to windows, windows to estimates and alarms.
//!
//! | room | |
//! |---|---|
//! | [`codec`] | bytes to samples; topics |
//! | `hash` | short names for what is the same |
//! | [`alarm`] | ISA-18.2 states |
//! | [`engine`] | one state machine a loop |
//! | [`config`] | text to settings: its own, the engine's and the alarm's |
//! | [`ownership`] | which daemon watches which loop |
//! | [`analysis`] | samples of a recording to the answers of `analyze` and `gap` |
//!
//! [`engine::Engine`] is told the time (stamps on samples) and handed the data; a fit leaves it as a
//! [`engine::Request`] and whoever drives it computes the answer. No file, socket, clock, thread, environment or
//! unseeded randomness is in here, so what was recorded can be replayed, to the byte: the daemon drives the same
//! engine live and from a file.

#![cfg_attr(test, allow(clippy::disallowed_methods, clippy::disallowed_types))]

pub mod alarm;
pub mod analysis;
pub mod codec;
pub mod config;
pub mod engine;
mod hash;
pub mod ownership;

pub use hash::short_hash;
