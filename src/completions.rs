//! `stictiond completions SHELL`: completions for a shell, on stdout.

use clap::CommandFactory;
use clap_complete::Shell;

use super::{Cli, Outcome, print};

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
    let mut out = Vec::new();
    clap_complete::generate(args.shell, &mut Cli::command(), "stictiond", &mut out);
    print(&String::from_utf8_lossy(&out))?;
    Ok(Outcome::Done)
}
