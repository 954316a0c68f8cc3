//! `stictiond completions SHELL`: completions for a shell, on stdout.

use clap::CommandFactory;

use crate::cli::manual::{Shell, completions};
use crate::cli::{Outcome, print};
use crate::commands::Cli;

/// Print completions for a shell.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  stictiond completions bash > /etc/bash_completion.d/stictiond
  stictiond completions zsh > ~/.zfunc/_stictiond
  stictiond completions fish > ~/.config/fish/completions/stictiond.fish")]
pub struct Args {
    /// The shell.
    pub shell: Shell,
}

/// Runs the command.
///
/// # Errors
/// Stdout is closed.
pub fn run(args: &Args) -> anyhow::Result<Outcome> {
    print(&completions(Cli::command(), args.shell))?;
    Ok(Outcome::Done)
}
