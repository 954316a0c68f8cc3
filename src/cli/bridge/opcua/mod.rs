//! `stictiond bridge opcua`: a server's values onto Zenoh, one key a node. It subscribes and browses; it never writes
//! and calls no method.
//!
//! The server's queues hold what a short loss of the network keeps back: the session is taken up again, and messages
//! that were on the way are asked for again by their numbers. What a server made while there was no session cannot be
//! had afterwards: every such stretch is told with start and end.

#[cfg(feature = "bridge-opcua")]
pub(crate) mod browse;
#[cfg(any(feature = "bridge-opcua", test))]
mod figures;
#[cfg(any(feature = "bridge-opcua", test))]
mod hold;
#[cfg(any(feature = "bridge-opcua", test))]
pub(crate) mod nodes;
#[cfg(feature = "bridge-opcua")]
pub(crate) mod server;
#[cfg(feature = "bridge-opcua")]
mod serving;
#[cfg(feature = "bridge-opcua")]
mod subscription;
#[cfg(any(feature = "bridge-opcua", test))]
mod values;

#[cfg(feature = "bridge-opcua")]
pub use with::{Args, run};

#[cfg(feature = "bridge-opcua")]
mod with {
    use std::path::PathBuf;

    use anyhow::Context;

    use super::nodes;
    use super::server::ServerArgs;
    use super::serving::serve;
    use crate::cli::bridge::bus::{BusArgs, document};
    use crate::cli::{Format, Outcome, UsageError, asked_to_stop, block_on, list, say};

    /// How long the server's queues last where nothing is said, beside the publishing interval, ms.
    const QUEUE_MS: u32 = 10_000;

    /// Bring an OPC UA server's values onto Zenoh: nodes of a list, or the variables below a node.
    ///
    /// Reads only. Values keep the source's stamp and their status code; what is bad goes as missing. Stretches without
    /// a session are told with start and end: what the server made in them cannot be had by a subscription.
    #[derive(Debug, clap::Args)]
    #[command(
        after_help = "Examples: stictiond bridge opcua --from opc.tcp://plc:4840 --nodes nodes.txt \\\n            \
                        --connect tcp/127.0.0.1:7447 --prefix plant1/area1/opcua\n          \
                        stictiond bridge opcua --from opc.tcp://plc:4840 --cert-file own.pem \\\n            \
                        --key-file own.key --trust servers/ --browse /Objects/Plant \\\n            \
                        --connect tcp/127.0.0.1:7447 --prefix plant1/opcua"
    )]
    pub struct Args {
        /// The server.
        #[command(flatten)]
        pub server: ServerArgs,
        /// File of nodes, one a line: NODEID [KEY below the prefix].
        #[arg(long, value_name = "FILE", required_unless_present = "browse", conflicts_with = "browse")]
        pub nodes: Option<PathBuf>,
        /// Node or path of names, such as /Objects/Plant, below which all variables are taken; looked at once.
        #[arg(long, value_name = "NODEID|PATH")]
        pub browse: Option<String>,
        /// How often the server looks at each node, ms.
        #[arg(long, default_value_t = 1000, value_parser = clap::value_parser!(u32).range(1..))]
        pub sampling_ms: u32,
        /// How often it sends what it has, ms; as often as it looks if not given.
        #[arg(long, value_parser = clap::value_parser!(u32).range(1..))]
        pub publishing_ms: Option<u32>,
        /// Values of a node that the server keeps; those of a publishing interval and ten seconds if not given.
        #[arg(long, value_parser = clap::value_parser!(u32).range(1..))]
        pub queue: Option<u32>,
        /// Values that are held in memory while nobody listens on the bus; then the oldest are dropped.
        #[arg(long, default_value_t = 1_000_000, value_name = "VALUES")]
        pub hold: usize,
        /// Where to, and what is told.
        #[command(flatten)]
        pub bus: BusArgs,
    }

    impl Args {
        /// How often the server sends, ms.
        pub fn publishing_ms(&self) -> u32 {
            self.publishing_ms.unwrap_or(self.sampling_ms)
        }

        /// Values of a node that the server is asked to keep.
        pub fn queue(&self) -> u32 {
            let enough = self.publishing_ms().saturating_add(QUEUE_MS) / self.sampling_ms + 1;
            self.queue.unwrap_or(enough)
        }
    }

    /// Runs the command until SIGTERM or Ctrl-C.
    ///
    /// # Errors
    /// Nobody answers on the bus, or a file cannot be read. A server that does not answer is tried for ever.
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
