//! `stiction-lab` tests and calibrates `stictiond`: challenges with a withheld cause, the fits of the classifier, of the
//! intervals and of the rules for plants, loops of known cause. A plant's daemon needs none of it.

#![allow(clippy::disallowed_methods, clippy::disallowed_types)]

mod bench;
mod calibrate;
mod causes;
mod challenge;
mod evaluate;
mod fleet;
mod repeat;

use std::process::ExitCode;

use clap::{Parser, Subcommand};
use stiction_engine::provenance;
use stictiond::cli::{Outcome, OutputArgs, main_of, of_build};

/// Check the gap diagnosis on withheld causes, and calibrate the classifier, the intervals and the rules for plants.
///
/// Exit codes: 0 done, 1 failed, 2 wrong command line.
#[derive(Debug, Parser)]
#[command(name = "stiction-lab", version, max_term_width = 100)]
struct Cli {
    #[command(flatten)]
    output: OutputArgs,
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Challenge(challenge::Args),
    Calibrate(calibrate::Args),
    Evaluate(evaluate::Args),
    Bench(bench::Args),
    Causes(causes::Args),
    Repeat(repeat::Args),
    /// Time the comparison of 1,000, 10,000 and 100,000 loops, of which one in five oscillates.
    Fleet,
}

/// Reads the command line and runs one command.
fn main() -> ExitCode {
    main_of("stiction-lab", |cli: &Cli| (cli.output.log, "info"), run)
}

fn run(cli: &Cli) -> anyhow::Result<Outcome> {
    let format = cli.output.format;
    match &cli.command {
        Command::Challenge(args) => challenge::run(args, format),
        Command::Calibrate(args) => of_build(calibrate::run(args, format), format, &provenance()),
        Command::Evaluate(args) => of_build(evaluate::run(args, format), format, &provenance()),
        Command::Bench(args) if args.publish.is_some() => bench::run(args, format),
        Command::Bench(args) => of_build(bench::run(args, format), format, &provenance()),
        Command::Causes(args) => of_build(causes::run(args, format), format, &provenance()),
        Command::Repeat(args) => repeat::run(args, format),
        Command::Fleet => fleet::run(format),
    }
}
