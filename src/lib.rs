//! `stictiond` watches control loops for sticking valves.
//!
//! # The map
//! | here | |
//! |---|---|
//! | [`commands`] | a file for each command |
//! | [`cli`] | what commands share: exit codes, output, log, progress, inputs, man pages |
//! | [`daemon`] | the bus, threads, publisher, recorder, webhooks, replay |
//! | [`web`] | the page and the API under it, `/metrics`, `/healthz`; it does not use the daemon, nor the daemon it |
//! | [`web::workbench`] | files in the browser: a server without a daemon |
//! | [`report`] | pages and pictures |
//! | [`runtime`] | clock, queues, metrics, faults, health, overview: what daemon and web share |
//!
//! | crate | |
//! |---|---|
//! | `stiction` | the science: records, physics, identification, verdict, gap. No file, clock, thread or socket |
//! | `stiction-engine` | the deterministic part of the daemon: payloads, settings, the engine, alarms. Neither |
//! | `stiction-files` | tables, exports, MCAP, `.mat`, stores |
//! | `stiction-lab` | simulated loops of known truth, challenge, calibration; the program `stiction-lab`. This one does not use it |
//! | `stictiond-bridge` | the program of that name: MQTT and OPC UA onto the bus |
//!
//! # One sample's way
//! `daemon::source::zenoh` (callback, bounded queue) → `daemon::engine_thread` (router, limits, recorder) →
//! [`stiction_engine::engine::Engine::push`] → [`stiction::core::signal::align`] (joined by source time) →
//! [`stiction::core::signal::history`] (bounded memory) → a due window → `daemon::schedule` (in turn) → `daemon::worker` →
//! [`stiction::core::verdict::assess`] → [`stiction_engine::alarm`] → `sink::zenoh`, `sink::recorder` and `sink::state_writer`.

pub mod cli;
pub mod commands;
pub mod daemon;
pub mod report;
pub mod runtime;
pub mod web;
