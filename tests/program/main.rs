//! Tests of the programs from outside: commands, files, daemons.
//!
//! One binary, so that shared code is compiled and linked once.
#![allow(missing_docs)]
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

#[path = "../common/mod.rs"]
mod common;
#[path = "../common/live.rs"]
mod live;

mod cli_files;
mod cli_gap;
mod cli_neighbours;
mod cli_plant;
mod cli_report;
mod columns;
mod daemon;
mod daemon_gap;
mod daemon_plant;
mod elsewhere;
mod expectations;
mod exports;
mod failover;
mod foreign;
mod generated;
mod golden;
mod judged;
mod pages;
mod play;
mod recordings;
mod shipped;
mod toolbox;
mod workbench;
