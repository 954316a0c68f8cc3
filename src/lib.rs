//! `stictiond` watches control loops for sticking valves.
//!
//! # The map
//! One crate, a library and a binary. Each room imports only rooms that stand above it in this list;
//! `tests/library/tidy.rs` holds the table.
//!
//! | layer | rooms |
//! |---|---|
//! | 0 words | [`units`] time and names · [`record`] a sample, and the record one estimate is made from |
//! | 1 tools | [`signal`] joining, memory, statistics · [`optim`] solvers |
//! | 2 physics | [`sim`] valve laws, processes, controller, noise, closed loop: the only copy of each formula |
//! | 3 identification | [`ident`] quantification of stiction · [`detect`] oscillation, and one file per witness |
//! | 4 judgement | [`verdict`] gates, verdict, the estimate's document · [`gap`] what the model leaves out · [`challenge`] its check on withheld causes · [`alarm`] ISA-18.2 states |
//! | 5 engine | [`config`] text to settings · [`codec`] bytes to samples, topics · [`engine`] one state machine a loop |
//! | 6 shell | `source` the bus · `sink` publisher, recorder, keeper of states · `files` CSV, MCAP, .mat · `report` pictures, pages · `daemon` wiring, replay · `web` · `cli` |
//!
//! `alarm` and `engine` take their settings from [`config`], which knows none of them.
//!
//! # As a library
//! A [`record::Record`] in, typed numbers out; `examples/` holds more.
//!
//! ```
//! use stictiond::record::Record;
//! use stictiond::sim::valve::he_step;
//! use stictiond::verdict::{AssessParams, assess};
//!
//! // OP swings, a valve with fs 2.5 and fd 1 follows it, a first-order process answers the valve.
//! let op: Vec<f64> = (0..600).map(|k| 6.0 * (f64::from(k) * 0.06).sin() + 2.0 * (f64::from(k) * 0.017).sin()).collect();
//! let (mut stem, mut pv, mut measured) = (0.0, 0.0, Vec::new());
//! for &u in &op {
//!     measured.push(pv);
//!     stem = he_step(stem, u, 2.5, 1.0);
//!     pv += 0.1 * (1.5 * stem - pv);
//! }
//! let record = Record::uniform(1.0, op, measured);
//! let found = assess(&record, &AssessParams { always_fit: true, ..AssessParams::default() });
//! assert!((found.s.unwrap() - 3.5).abs() < 0.1);
//! ```
//!
//! # What must be absent
//! Layers 0 to 5 build without the feature `daemon` and hold no file, socket, clock, thread, environment or unseeded
//! randomness. [`engine::Engine`] is told the time (stamps on samples) and handed the data; a fit leaves it as a
//! [`engine::Request`] and whoever drives it computes the answer. So what was recorded can be replayed, to the byte:
//! `daemon::replay` drives the same engine from a file.
//!
//! # One sample's way
//! `source::zenoh` (callback, bounded queue) → `daemon::core` (route, decode, record) → [`engine::Engine::push`] →
//! [`signal::align`] (joined by source time) → [`signal::history`] (bounded memory) → a due window → `daemon::schedule` (in turn) → `daemon::worker`
//! → [`verdict::assess`] → [`alarm`] → `sink::zenoh`, `sink::recorder` and `sink::keeper`.
//!
//! # Where to add
//! A solver: a file in `optim/` and a line in [`optim::ALL`]. A witness: `detect/` and [`detect::ALL`]. A payload
//! format: `codec/` and [`codec::ALL`]. A command: `cli/` and its dispatch. A valve law or process: `sim/`.

pub mod alarm;
pub mod challenge;
#[cfg(feature = "daemon")]
pub mod cli;
pub mod codec;
pub mod config;
#[cfg(feature = "daemon")]
pub mod daemon;
pub mod detect;
pub mod engine;
#[cfg(feature = "daemon")]
pub mod files;
pub mod gap;
pub mod ident;
pub mod optim;
pub mod record;
#[cfg(feature = "daemon")]
pub mod report;
pub mod signal;
pub mod sim;
#[cfg(feature = "daemon")]
pub mod sink;
#[cfg(feature = "daemon")]
pub mod source;
pub mod units;
pub mod verdict;
#[cfg(feature = "daemon")]
pub mod web;

/// Version of the program, as documents carry it.
pub const VERSION: &str = env!("CARGO_PKG_VERSION");
