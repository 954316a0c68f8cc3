//! `stictiond` watches control loops for sticking valves.
//!
//! # The map
//! The crates of the workspace, each using only those above it, which the compiler holds:
//!
//! | crate | |
//! |---|---|
//! | `stiction-core` | the science: records, physics, identification, verdict, gap. No file, clock, thread or socket |
//! | `stiction` | what other Rust programs need of it |
//! | `stiction-monitor` | what is deterministic of a daemon: payloads, settings, the engine, alarms. Neither |
//! | `stiction-truth` | simulated loops of known truth, published methods to compare with |
//! | `stiction-lab` | what proves the science: challenge, calibration. The program does not use it |
//! | `stiction-files` | tables, exports, MCAP, `.mat`, stores |
//! | `stiction-runtime` | clock, queues, metrics, faults, health, overview: what the parts of a running program share |
//! | `stiction-report` | pages and pictures |
//! | `stiction-daemon` | the bus, threads, publisher, recorder, receivers, replay |
//! | `stiction-web` | the page and the API under it, `/metrics`, `/healthz`. It does not know the daemon, nor the daemon it |
//! | `stiction-workbench` | files in the browser: a program of its own, of which the daemon knows nothing |
//! | `stiction-command` | what the programs' command lines share: exit codes, output, log, progress, the way to each other |
//! | `stictiond-bridge` | the program of that name: MQTT and OPC UA onto the bus |
//! | `stiction-lab-cli` | the program `stiction-lab`: challenges and calibrations |
//! | this one | the command line: a file for each command. Results go to stdout, everything else to stderr |
//!
//! # One sample's way
//! `source::zenoh` (callback, bounded queue) → `core` (route, decode, record), both of `stiction-daemon` →
//! [`stiction_monitor::engine::Engine::push`] → [`stiction_core::signal::align`] (joined by source time) →
//! [`stiction_core::signal::history`] (bounded memory) → a due window → `schedule` (in turn) → `worker` →
//! [`stiction_core::verdict::assess`] → [`stiction_monitor::alarm`] → `sink::zenoh`, `sink::recorder` and `sink::keeper`.

pub mod analyze;
mod analyze_report;
pub mod bench;
mod browser;
pub mod check;
pub mod compact;
pub mod completions;
pub mod convert;
pub mod demo;
pub mod discover;
pub mod evaluate;
mod expect;
mod fleet;
pub mod gap;
pub mod info;
mod judge;
pub mod manual;
mod plant;
pub mod play;
pub mod reading;
pub mod recover;
pub mod replay;
pub mod run;
pub mod schema;
pub mod selection;
pub mod simulate;
pub mod solving;
pub mod test;
pub mod workbench;

use std::process::ExitCode;

use clap::{Parser, Subcommand};
use stiction_command::{
    Format, Outcome, OutputArgs, UsageError, asked_to_stop, bar_of, block_on, exit_code, in_order_on_all_cores, list,
    log, note, on_all_cores, parse, print, put, say, stop, warn,
};

/// Find sticking control valves in loop data, live or recorded, with probability, size and interval.
///
/// Two other programs: stictiond-bridge brings data of an MQTT broker or an OPC UA server onto the bus, stiction-lab checks and
/// calibrates what this one says. Exit codes: 0 done (a verdict never changes the exit code), 1 failed, 2 wrong command line,
/// 3 done with data loss.
#[derive(Debug, Parser)]
#[command(name = "stictiond", version, max_term_width = 100)]
struct Cli {
    #[command(flatten)]
    output: OutputArgs,
    #[command(subcommand)]
    command: CommandArgs,
}

#[derive(Debug, Subcommand)]
enum CommandArgs {
    Run(run::Args),
    Demo(demo::Args),
    Play(play::Args),
    Replay(replay::Args),
    Analyze(analyze::Args),
    Gap(gap::Args),
    Workbench(workbench::Args),
    Evaluate(evaluate::Args),
    Simulate(simulate::Args),
    Compact(compact::Args),
    Convert(convert::ConvertArgs),
    Check(check::Args),
    Test(test::Args),
    Discover(discover::Args),
    Info(info::InfoArgs),
    Recover(recover::Args),
    Schema(schema::Args),
    Bench(bench::Args),
    Manual(manual::Args),
    Completions(completions::Args),
}

/// Reads the command line and runs one command.
fn main() -> ExitCode {
    let cli: Cli = match parse() {
        Ok(cli) => cli,
        Err(code) => return code,
    };
    log::start(cli.output.log, cli.default_filter());
    exit_code("stictiond", dispatch(cli))
}

fn dispatch(cli: Cli) -> anyhow::Result<Outcome> {
    let format = cli.output.format;
    match cli.command {
        CommandArgs::Run(args) => run::run(&args),
        CommandArgs::Demo(args) => demo::run(&args, format),
        CommandArgs::Play(args) => play::run(&args, format),
        CommandArgs::Replay(args) => replay::run(&args, format),
        CommandArgs::Analyze(args) => analyze::run(&args, format),
        CommandArgs::Gap(args) => gap::run(&args, format),
        CommandArgs::Workbench(args) => workbench::run(&args, format),
        CommandArgs::Evaluate(args) => evaluate::run(&args, format),
        CommandArgs::Simulate(args) => simulate::run(&args, format),
        CommandArgs::Compact(args) => compact::run(&args, format),
        CommandArgs::Convert(args) => convert::run(&args, format),
        CommandArgs::Check(args) => check::run(&args, format),
        CommandArgs::Test(args) => test::run(&args, format),
        CommandArgs::Discover(args) => discover::run(&args, format),
        CommandArgs::Info(args) => info::run(&args, format),
        CommandArgs::Recover(args) => recover::run(&args, format),
        CommandArgs::Schema(args) => schema::run(&args),
        CommandArgs::Bench(args) => bench::run(&args, format),
        CommandArgs::Manual(args) => manual::run(&args, format),
        CommandArgs::Completions(args) => completions::run(&args),
    }
}

impl Cli {
    /// The default log filter, used without `RUST_LOG`. The demo prints alarms itself.
    const fn default_filter(&self) -> &'static str {
        match (&self.command, self.output.format) {
            (CommandArgs::Demo(_), Format::Text) => "warn,zenoh=error,stiction_monitor::alarm=off",
            // The daemon itself says which listener or router is missing, without paths of sources.
            _ => "info,zenoh=warn,zenoh::net::runtime::orchestrator=error",
        }
    }
}
