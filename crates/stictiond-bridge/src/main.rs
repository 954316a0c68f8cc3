//! `stictiond-bridge` brings other systems' data onto the bus, each bridge in its own process. Bridges only read from the other
//! system.

mod bus;
#[cfg(feature = "opcua")]
mod discover;
mod mqtt;
#[cfg(any(feature = "opcua", test))]
mod opcua;

use std::process::ExitCode;

use clap::{CommandFactory, Parser, Subcommand};
#[cfg(not(feature = "opcua"))]
use stictiond::cli::UsageError;
#[cfg(feature = "manual")]
use stictiond::cli::manual::{self, ManualArgs, Shell};
use stictiond::cli::{Outcome, OutputArgs, main_of, print};

/// Bring another system's data onto the bus. Bridges only read from the other system.
///
/// Exit codes: 0 done, 1 failed, 2 wrong command line.
#[derive(Debug, Parser)]
#[command(name = "stictiond-bridge", version, max_term_width = 100)]
struct Cli {
    #[command(flatten)]
    output: OutputArgs,
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Mqtt(Box<mqtt::Args>),
    #[cfg(feature = "opcua")]
    Opcua(Box<opcua::Args>),
    #[cfg(feature = "opcua")]
    Discover(Box<discover::Args>),
    /// Republish an OPC UA server's values: not in this build.
    #[cfg(not(feature = "opcua"))]
    Opcua(Absent),
    /// Browse an OPC UA server: not in this build.
    #[cfg(not(feature = "opcua"))]
    Discover(Absent),
    /// Write man pages, one per command.
    #[cfg(feature = "manual")]
    Manual(ManualArgs),
    /// Print completions for a shell.
    #[cfg(feature = "manual")]
    Completions {
        /// The shell.
        shell: Shell,
    },
}

/// The arguments of a command that this build lacks: it is refused whatever they are.
#[cfg(not(feature = "opcua"))]
#[derive(Debug, clap::Args)]
#[command(disable_help_flag = true)]
struct Absent {
    #[arg(hide = true, trailing_var_arg = true, allow_hyphen_values = true)]
    _arguments: Vec<std::ffi::OsString>,
}

/// Reads the command line and runs one bridge.
fn main() -> ExitCode {
    // The bridge itself logs outages, which the OPC UA client would log at every attempt.
    let levels = "info,zenoh=warn,zenoh::net::runtime::orchestrator=error,opcua=off";
    main_of("stictiond-bridge", |cli: &Cli| (cli.output.log, levels), run)
}

fn run(cli: &Cli) -> anyhow::Result<Outcome> {
    let format = cli.output.format;
    match &cli.command {
        Command::Mqtt(args) => mqtt::run(args, format),
        #[cfg(feature = "opcua")]
        Command::Opcua(args) => opcua::run(args, format),
        #[cfg(feature = "opcua")]
        Command::Discover(args) => discover::run(args, format),
        #[cfg(not(feature = "opcua"))]
        Command::Opcua(_) | Command::Discover(_) => {
            let how = "cargo install --path crates/stictiond-bridge --features opcua";
            Err(UsageError(format!("this build has no OPC UA client; rebuild with `{how}`")).into())
        }
        #[cfg(feature = "manual")]
        Command::Manual(args) => manual::run(Cli::command(), args, format),
        #[cfg(feature = "manual")]
        Command::Completions { shell } => {
            print(&manual::completions(Cli::command(), *shell))?;
            Ok(Outcome::Done)
        }
    }
}

#[cfg(all(test, not(feature = "opcua")))]
mod tests {
    use super::*;

    #[test]
    fn a_bridge_that_was_left_out_says_how_it_is_had() {
        for words in
            [&["x", "opcua"][..], &["x", "opcua", "--from", "opc.tcp://plc", "--nodes", "n"], &["x", "discover"]]
        {
            let error = run(&Cli::parse_from(words)).unwrap_err();
            assert!(error.is::<UsageError>() && error.to_string().contains("--features opcua"), "{error}");
        }
    }
}
