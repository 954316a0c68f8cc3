//! `stictiond-bridge discover`: the address space of a server as a list of nodes and `[[loop]]` entries.

use std::collections::HashSet;
use std::fmt::Write as _;
use std::path::PathBuf;
use std::time::Duration;

use anyhow::{Context, bail};

use crate::opcua::browse::{BrowsedNodes, below};
use crate::opcua::nodes::write;
use crate::opcua::server::{Event, ServerArgs, open};
use stiction_files::pairing::{Listing, Seen};
use stictiond::cli::bus::prefix;
use stictiond::cli::refuse_existing;
use stictiond::cli::{Format, Outcome, block_on, note, put};

/// Time limit for opening and closing the session.
const SESSION_WITHIN: Duration = Duration::from_secs(20);
const GOODBYE: Duration = Duration::from_secs(2);

/// Browse an OPC UA server; write the list of nodes for `opcua` and [[loop]] entries for their keys.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Example: stictiond-bridge discover --from opc.tcp://plc:4840 --browse /Objects/Plant \\\n           \
                        --prefix plant1/area1/opcua --nodes nodes.txt --out loops.toml"
)]
pub struct Args {
    /// Server options.
    #[command(flatten)]
    pub server: ServerArgs,
    /// Node or path of browse names below which to look for variables.
    #[arg(long, default_value = "/Objects", value_name = "NODEID|PATH")]
    pub browse: String,
    /// Key prefix of the values, as given to `opcua`.
    #[arg(long, value_parser = prefix)]
    pub prefix: String,
    /// Output file for the nodes of the loops found, one per line.
    #[arg(long, value_name = "FILE")]
    pub nodes: PathBuf,
    /// Output file for the [[loop]] entries [default: stdout].
    #[arg(long)]
    pub out: Option<PathBuf>,
    /// Replace existing files.
    #[arg(long)]
    pub force: bool,
}

/// Runs the command.
///
/// # Errors
/// The server does not answer, there is nothing to browse, or a file already exists.
pub fn run(args: &Args, format: Format) -> anyhow::Result<Outcome> {
    let (seen, what) = look(args)?;
    let listing = Listing { seen: &seen, keyed: true, what: &what };
    let text = if format == Format::Json { listing.json() } else { listing.toml() };
    put(&text, args.out.as_deref(), args.force)?;
    note(listing.summary());
    listing.check()?;
    Ok(Outcome::Done)
}

/// Browses. Returns what was seen and a description of the source.
///
/// # Errors
/// The server does not answer, there is nothing to browse, or the list already exists.
fn look(args: &Args) -> anyhow::Result<(Seen, String)> {
    refuse_existing(&args.nodes, args.force)?;
    args.server.check()?;
    let found = block_on(async {
        let (link, mut events) = open(&args.server).await?;
        match tokio::time::timeout(SESSION_WITHIN, events.recv()).await {
            Ok(Some(Event::New)) => {}
            Ok(Some(Event::Lost(why) | Event::Ended(why))) => bail!("cannot open a session: {why}"),
            _ => bail!("cannot open a session within {} s; check --from", SESSION_WITHIN.as_secs()),
        }
        let found = below(&link.session, &args.browse).await;
        link.close(GOODBYE).await;
        found
    })
    .with_context(|| args.server.from.clone())?;
    let mut seen = Seen::default();
    for node in &found.nodes {
        let key = format!("{}/{}", args.prefix, node.key);
        if !seen.name(&node.key, key.clone()) {
            seen.unrecognised(key);
        }
    }
    std::fs::write(&args.nodes, list(args, &seen, &found)).with_context(|| args.nodes.display().to_string())?;
    Ok((seen, format!("{} at {}", args.browse, args.server.from)))
}

/// The nodes of complete loops; the others as comments, so that they can be enabled by hand.
fn list(args: &Args, seen: &Seen, found: &BrowsedNodes) -> String {
    let (whole, _) = seen.paired();
    let wanted: HashSet<&str> = whole.iter().flat_map(|name| seen.sources(name)).collect();
    let own = |key: &str| wanted.contains(format!("{}/{key}", args.prefix).as_str());
    let (used, left): (Vec<_>, Vec<_>) = found.nodes.iter().cloned().partition(|node| own(&node.key));
    let mut text = format!("# {} of {} nodes, by stictiond-bridge discover\n", used.len(), found.nodes.len());
    text += &write(&used);
    if !left.is_empty() {
        text += "\n# Not part of a loop with OP and PV:\n";
        for line in write(&left).lines() {
            // Writing into a String cannot fail.
            let _ = writeln!(text, "# {line}");
        }
    }
    text
}
