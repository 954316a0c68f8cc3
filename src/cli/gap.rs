//! `stictiond gap`: what the model leaves out, and the check of that diagnosis on withheld causes.

use super::{Format, Outcome, challenge};

/// Check the gap diagnosis on loops whose cause is withheld from it.
#[derive(Debug, clap::Args)]
#[command(subcommand_required = true, arg_required_else_help = true)]
pub struct Args {
    /// Which of them.
    #[command(subcommand)]
    pub command: Command,
}

/// What `gap` does beside diagnosing one file.
#[derive(Debug, clap::Subcommand)]
pub enum Command {
    /// See [`challenge`].
    Challenge(challenge::Args),
}

/// Runs the command.
///
/// # Errors
/// What the command that was asked for says.
pub fn run(args: &Args, format: Format) -> anyhow::Result<Outcome> {
    match &args.command {
        Command::Challenge(args) => challenge::run(args, format),
    }
}
