//! `stictiond` watches control loops for sticking valves.
//!
//! # The map
//! | here | |
//! |---|---|
//! | [`commands`] | a file for each command |
//! | [`cli`] | shared by the commands: exit codes, output, log, progress, inputs, man pages |
//! | [`daemon`] | the bus, threads, publisher, recorder, webhooks, replay |
//! | [`web`] | the page and its API, `/metrics`, `/healthz`; independent of the daemon in both directions |
//! | [`web::workbench`] | files in the browser: a server without a daemon |
//! | [`report`] | pages and pictures |
//! | [`runtime`] | shared by daemon and web: clock, queues, metrics, faults, health, overview |
//!
//! | crate | |
//! |---|---|
//! | `stiction` | the science: records, physics, identification, verdict, gap; no files, clock, threads or sockets |
//! | `stiction-engine` | the deterministic part of the daemon: payloads, settings, the engine, alarms; none of these either |
//! | `stiction-files` | tables, exports, MCAP, `.mat`, stores |
//! | `stiction-lab` | simulated loops with known truth, challenge, calibration; the program `stiction-lab`; not used here |
//! | `stictiond-bridge` | the program of that name: brings MQTT and OPC UA onto the bus |
//!
//! # The path of a sample
//! `daemon::source::zenoh` (callback, bounded queue) → `daemon::engine_thread` (router, limits, recorder) →
//! [`stiction_engine::engine::Engine::push`] → [`stiction::samples::align`] (joined by source time) →
//! [`stiction::samples::history`] (bounded memory) → a due window → `daemon::schedule` (in turn) → `daemon::worker` →
//! [`stiction::core::verdict::assess`] → [`stiction_engine::alarm`] → `sink::zenoh`, `sink::recorder` and `sink::state_writer`.

pub mod cli;
pub mod commands;
pub mod daemon;
pub mod report;
pub mod runtime;
pub mod web;
