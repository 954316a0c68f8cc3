//! The command line: a file for each command. Results go to stdout, everything else to stderr.

pub mod analyze;
mod analyze_report;
mod browser;
pub mod check;
pub mod compact;
#[cfg(feature = "manual")]
pub mod completions;
pub mod convert;
pub mod demo;
pub mod discover;
mod expect;
mod fleet;
pub mod gap;
pub mod info;
mod judge;
#[cfg(feature = "manual")]
pub mod manual;
mod plant;
pub mod play;
pub mod recover;
pub mod replay;
pub mod run;
pub mod schema;
pub mod simulate;
pub mod solving;
pub mod test;
pub mod workbench;

use std::process::ExitCode;

use crate::cli::{Format, Outcome, OutputArgs, main_of};
use clap::{Parser, Subcommand};

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
    #[command(visible_alias = "diagnose")]
    Gap(gap::Args),
    Workbench(workbench::Args),
    Simulate(simulate::Args),
    Compact(compact::Args),
    Convert(convert::ConvertArgs),
    Check(check::Args),
    Test(test::Args),
    Discover(discover::Args),
    Info(info::InfoArgs),
    Recover(recover::Args),
    Schema(schema::Args),
    #[cfg(feature = "manual")]
    Manual(manual::Args),
    #[cfg(feature = "manual")]
    Completions(completions::Args),
}

/// Reads the command line and runs one command.
#[must_use]
pub fn main() -> ExitCode {
    main_of("stictiond", |cli: &Cli| (cli.output.log, cli.default_filter()), dispatch)
}

fn dispatch(cli: &Cli) -> anyhow::Result<Outcome> {
    let format = cli.output.format;
    match &cli.command {
        CommandArgs::Run(args) => run::run(args),
        CommandArgs::Demo(args) => demo::run(args, format),
        CommandArgs::Play(args) => play::run(args, format),
        CommandArgs::Replay(args) => replay::run(args, format),
        CommandArgs::Analyze(args) => analyze::run(args, format),
        CommandArgs::Gap(args) => gap::run(args, format),
        CommandArgs::Workbench(args) => workbench::run(args, format),
        CommandArgs::Simulate(args) => simulate::run(args, format),
        CommandArgs::Compact(args) => compact::run(args, format),
        CommandArgs::Convert(args) => convert::run(args, format),
        CommandArgs::Check(args) => check::run(args, format),
        CommandArgs::Test(args) => test::run(args, format),
        CommandArgs::Discover(args) => discover::run(args, format),
        CommandArgs::Info(args) => info::run(args, format),
        CommandArgs::Recover(args) => recover::run(args, format),
        CommandArgs::Schema(args) => schema::run(args),
        #[cfg(feature = "manual")]
        CommandArgs::Manual(args) => manual::run(args, format),
        #[cfg(feature = "manual")]
        CommandArgs::Completions(args) => completions::run(args),
    }
}

impl Cli {
    /// The default log filter, used without `RUST_LOG`. The demo prints alarms itself.
    const fn default_filter(&self) -> &'static str {
        match (&self.command, self.output.format) {
            (CommandArgs::Demo(_), Format::Text) => "warn,zenoh=error,stiction_engine::alarm=off",
            // The daemon itself reports a missing listener or router, without source paths.
            _ => "info,zenoh=warn,zenoh::net::runtime::orchestrator=error",
        }
    }
}
