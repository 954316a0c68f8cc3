//! `stictiond-bridge opcua`: republishes a server's values on Zenoh, one key per node. It browses and subscribes; it never
//! writes and calls no methods.
//!
//! The server's queues bridge short network losses: the session is resumed, and messages in transit are requested again by
//! number. Values from a time without a session cannot be recovered; every such outage is reported with start and end.

#[cfg(feature = "opcua")]
pub(crate) mod browse;
#[cfg(any(feature = "opcua", test))]
mod figures;
#[cfg(any(feature = "opcua", test))]
mod hold;
#[cfg(any(feature = "opcua", test))]
pub(crate) mod nodes;
#[cfg(feature = "opcua")]
pub(crate) mod server;
#[cfg(feature = "opcua")]
mod serving;
#[cfg(feature = "opcua")]
mod subscription;
#[cfg(any(feature = "opcua", test))]
mod values;

#[cfg(feature = "opcua")]
pub use with::{Args, run};

#[cfg(feature = "opcua")]
mod with {
    use std::path::PathBuf;

    use anyhow::Context;

    use super::nodes;
    use super::server::ServerArgs;
    use super::serving::serve;
    use crate::bus::{BusArgs, document};
    use stictiond::cli::{Format, Outcome, UsageError, asked_to_stop, block_on, list, say};

    /// Time that the server's queues cover by default, in addition to the publishing interval, ms.
    const QUEUE_MS: u32 = 10_000;

    /// Republish an OPC UA server's values on Zenoh: a list of nodes, or all variables below a node.
    ///
    /// Reads only. Values keep source timestamp and status code; bad values are published as missing. Outages are reported
    /// with start and end, because a subscription cannot recover the values in between.
    #[derive(Debug, clap::Args)]
    #[command(
        after_help = "Examples: stictiond-bridge opcua --from opc.tcp://plc:4840 --nodes nodes.txt \\\n            \
                        --connect tcp/127.0.0.1:7447 --prefix plant1/area1/opcua\n          \
                        stictiond-bridge opcua --from opc.tcp://plc:4840 --cert-file own.pem \\\n            \
                        --key-file own.key --trust servers/ --browse /Objects/Plant \\\n            \
                        --connect tcp/127.0.0.1:7447 --prefix plant1/opcua"
    )]
    pub struct Args {
        /// Server options.
        #[command(flatten)]
        pub server: ServerArgs,
        /// File with one node per line: NODEID [KEY below the prefix].
        #[arg(long, value_name = "FILE", required_unless_present = "browse", conflicts_with = "browse")]
        pub nodes: Option<PathBuf>,
        /// Node or path of browse names, such as /Objects/Plant; takes all variables below it, browsed once at the start.
        #[arg(long, value_name = "NODEID|PATH")]
        pub browse: Option<String>,
        /// Sampling interval of each node, ms.
        #[arg(long, default_value_t = 1000, value_parser = clap::value_parser!(u32).range(1..))]
        pub sampling_ms: u32,
        /// Publishing interval of the server, ms [default: the sampling interval].
        #[arg(long, value_parser = clap::value_parser!(u32).range(1..))]
        pub publishing_ms: Option<u32>,
        /// Queue length per node at the server, values [default: enough for a publishing interval and ten seconds].
        #[arg(long, value_parser = clap::value_parser!(u32).range(1..))]
        pub queue: Option<u32>,
        /// Most values held in memory while nobody subscribes; beyond it the oldest are dropped.
        #[arg(long, default_value_t = 1_000_000, value_name = "VALUES")]
        pub hold: usize,
        /// Bus options.
        #[command(flatten)]
        pub bus: BusArgs,
    }

    impl Args {
        /// Publishing interval, ms.
        pub fn publishing_ms(&self) -> u32 {
            self.publishing_ms.unwrap_or(self.sampling_ms)
        }

        /// Requested queue length of a node, values.
        pub fn queue(&self) -> u32 {
            let enough = self.publishing_ms().saturating_add(QUEUE_MS) / self.sampling_ms + 1;
            self.queue.unwrap_or(enough)
        }
    }

    /// Runs the command until SIGTERM or Ctrl-C.
    ///
    /// # Errors
    /// Nothing answers on the bus, or a file cannot be read. A server that does not answer is retried for ever.
    pub fn run(args: &Args, format: Format) -> anyhow::Result<Outcome> {
        args.server.check()?;
        let given = match &args.nodes {
            None => Vec::new(),
            Some(path) => {
                let text = std::fs::read_to_string(path).with_context(|| path.display().to_string())?;
                let told = |faults: Vec<String>| UsageError(format!("{}:\n  {}", path.display(), list(&faults)));
                nodes::read(&text).map_err(told)?
            }
        };
        let figures = block_on(async {
            let stop = asked_to_stop()?;
            serve(args, given, stop).await
        })?;
        match format {
            Format::Json => say(document("opcua", &figures))?,
            Format::Text => say(figures.line())?,
        }
        Ok(Outcome::Done)
    }
}
