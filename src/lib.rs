//! `stictiond` watches control loops for sticking valves.
//!
//! # The map
//! The workspace, each crate using those above it alone:
//!
//! | crate | |
//! |---|---|
//! | [`stiction`] | the science: records, physics, identification, verdict, gap. No file, clock, thread or socket |
//! | [`stiction_monitor`] | what is deterministic of a daemon: payloads, settings, the engine, alarms. Neither |
//! | [`stiction_lab`] | what proves the science: truth, challenge, calibration |
//! | this one | the shell, below |
//!
//! | room | |
//! |---|---|
//! | [`cores`] | work shared out over all cores, watched, ended early |
//! | [`source`] | the bus |
//! | [`sink`] | publisher, recorder, receivers, keeper of states |
//! | [`files`] | tables, exports, MCAP, `.mat`, stores |
//! | [`report`] | pages and pictures |
//! | [`daemon`] | threads, queues, replay |
//! | [`web`] | the page and the API under it, `/metrics`, `/healthz` |
//! | [`workbench`] | files in the browser: a program of its own, of which the daemon knows nothing |
//! | `cli` | of the program, `main.rs`: a file for each command. The library does not know it |
//!
//! `tests/library/tidy.rs` holds which room may use which.
//!
//! # One sample's way
//! `source::zenoh` (callback, bounded queue) → `daemon::core` (route, decode, record) →
//! [`stiction_monitor::engine::Engine::push`] → [`stiction::signal::align`] (joined by source time) →
//! [`stiction::signal::history`] (bounded memory) → a due window → `daemon::schedule` (in turn) → `daemon::worker` →
//! [`stiction::verdict::assess`] → [`stiction_monitor::alarm`] → `sink::zenoh`, `sink::recorder` and `sink::keeper`.

pub mod cores;
pub mod daemon;
pub mod files;
pub mod report;
pub mod sink;
pub mod source;
pub mod web;
pub mod workbench;

pub use stiction::VERSION;
