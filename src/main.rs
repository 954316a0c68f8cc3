//! The program `stictiond`: reads its arguments, runs one command, gives its exit code.

use clap::{Parser, Subcommand};
use std::process::ExitCode;
use stictiond::cli::{self, Format, convert, info};

/// Watches control loops for sticking valves
#[derive(Parser)]
#[command(version, about)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
    /// What stands on stdout
    #[arg(long, global = true, value_enum, default_value_t)]
    format: Format,
}

#[derive(Subcommand)]
enum Command {
    Convert(convert::ConvertArgs),
    Info(info::InfoArgs),
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let result = match &arguments.command {
        Command::Convert(args) => convert::run(args, arguments.format),
        Command::Info(args) => info::run(args, arguments.format),
    };
    match result {
        Ok(outcome) => outcome.into(),
        Err(error) => {
            eprintln!("error: {error:#}");
            cli::outcome_of(&error).into()
        }
    }
}
