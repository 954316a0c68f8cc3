//! `stictiond bridge`: other systems' data onto the bus, each in a process of its own.

pub mod mqtt;

use super::{Format, Outcome};

/// Bring another system's data onto the bus; reads there, writes nothing.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    command: BridgeCommand,
}

#[derive(Debug, clap::Subcommand)]
enum BridgeCommand {
    Mqtt(mqtt::Args),
}

/// Runs the command.
///
/// # Errors
/// As the bridge that was asked for.
pub fn run(args: &Args, format: Format) -> anyhow::Result<Outcome> {
    match &args.command {
        BridgeCommand::Mqtt(args) => mqtt::run(args, format),
    }
}
