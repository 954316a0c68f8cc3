//! `stictiond manual --out DIR`: man pages, one per command, from the same text as `--help`.

use clap::CommandFactory;

use crate::cli::manual::{self, ManualArgs};
use crate::cli::{Format, Outcome};
use crate::commands::Cli;

/// Write man pages, one per command.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example: stictiond manual --out /usr/local/share/man/man1")]
pub struct Args {
    /// Where to.
    #[command(flatten)]
    pub to: ManualArgs,
}

/// Runs the command.
///
/// # Errors
/// A page exists, or cannot be written.
pub fn run(args: &Args, format: Format) -> anyhow::Result<Outcome> {
    manual::run(Cli::command(), &args.to, format)
}
