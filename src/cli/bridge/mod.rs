//! `stictiond bridge`: other systems' data onto the bus, each in a process of its own.

#[cfg(any(feature = "bridge-mqtt", feature = "bridge-opcua", test))]
mod bus;
#[cfg(feature = "bridge-mqtt")]
pub mod mqtt;
#[cfg(any(feature = "bridge-opcua", test))]
pub mod opcua;

use std::ffi::OsString;

use super::{Format, Outcome, UsageError};

/// Bring another system's data onto the bus; reads there, writes nothing.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    command: BridgeCommand,
}

#[derive(Debug, clap::Subcommand)]
enum BridgeCommand {
    #[cfg(feature = "bridge-mqtt")]
    Mqtt(Box<mqtt::Args>),
    #[cfg(not(feature = "bridge-mqtt"))]
    Mqtt(Absent),
    #[cfg(feature = "bridge-opcua")]
    Opcua(Box<opcua::Args>),
    #[cfg(not(feature = "bridge-opcua"))]
    Opcua(Absent),
}

/// Not in this build: a feature of it that was left out.
#[derive(Debug, clap::Args)]
pub struct Absent {
    #[arg(hide = true, trailing_var_arg = true, allow_hyphen_values = true)]
    rest: Vec<OsString>,
}

impl Absent {
    /// Says what is missing and how it is had.
    ///
    /// # Errors
    /// Always.
    pub fn refuse(&self, what: &str, feature: &str) -> anyhow::Result<Outcome> {
        Err(UsageError(format!("this build has no {what}: cargo install --path . --features {feature}")).into())
    }
}

/// Runs the command.
///
/// # Errors
/// As the bridge that was asked for; this build may have none of that kind.
pub fn run(args: &Args, format: Format) -> anyhow::Result<Outcome> {
    let _ = format;
    match &args.command {
        #[cfg(feature = "bridge-mqtt")]
        BridgeCommand::Mqtt(args) => mqtt::run(args, format),
        #[cfg(not(feature = "bridge-mqtt"))]
        BridgeCommand::Mqtt(absent) => absent.refuse("MQTT bridge", "bridge-mqtt"),
        #[cfg(feature = "bridge-opcua")]
        BridgeCommand::Opcua(args) => opcua::run(args, format),
        #[cfg(not(feature = "bridge-opcua"))]
        BridgeCommand::Opcua(absent) => absent.refuse("OPC UA bridge", "bridge-opcua"),
    }
}

#[cfg(all(test, not(feature = "bridge-opcua")))]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        args: Args,
    }

    #[test]
    fn a_bridge_that_was_left_out_says_how_it_is_had() {
        for words in [&["x", "opcua"][..], &["x", "opcua", "--from", "opc.tcp://plc", "--nodes", "n"]] {
            let error = run(&Line::parse_from(words).args, Format::Text).unwrap_err();
            assert!(error.is::<UsageError>() && error.to_string().contains("--features bridge-opcua"), "{error}");
        }
    }
}
