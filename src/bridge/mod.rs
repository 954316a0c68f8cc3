//! `stictiond bridge`: brings other systems' data onto the bus, each bridge in its own process.

#[cfg(any(feature = "bridge-mqtt", feature = "bridge-opcua", test))]
mod bus;
#[cfg(feature = "bridge-mqtt")]
pub mod mqtt;
#[cfg(any(feature = "bridge-opcua", test))]
pub mod opcua;

use std::ffi::OsString;

use super::{Format, Outcome, UsageError};

/// Bring another system's data onto the bus. Bridges only read from the other system.
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

/// A command whose feature is not in this build.
#[derive(Debug, clap::Args)]
pub struct Absent {
    #[arg(hide = true, trailing_var_arg = true, allow_hyphen_values = true)]
    rest: Vec<OsString>,
}

impl Absent {
    /// The error that names the missing feature and how to build it.
    ///
    /// # Errors
    /// Always.
    pub fn refuse(&self, what: &str, feature: &str) -> anyhow::Result<Outcome> {
        Err(UsageError(format!("this build has no {what}; rebuild with `cargo install --path . --features {feature}`"))
            .into())
    }
}

/// Runs the command.
///
/// # Errors
/// Those of the bridge; or this build does not have it.
pub fn run(args: &Args, format: Format) -> anyhow::Result<Outcome> {
    let _ = format;
    match &args.command {
        #[cfg(feature = "bridge-mqtt")]
        BridgeCommand::Mqtt(args) => mqtt::run(args, format),
        #[cfg(not(feature = "bridge-mqtt"))]
        BridgeCommand::Mqtt(absent) => absent.refuse("MQTT bridge", "full"),
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
