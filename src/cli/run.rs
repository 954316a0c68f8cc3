//! `stictiond run`: the daemon.

use std::path::PathBuf;

use anyhow::{Context, bail};

use super::{Outcome, asked_to_stop, block_on, list};
use stiction_monitor::config::{Config, ShardKeys, is_id};
use stiction_monitor::ownership::Shard;
use stictiond::daemon::{self, RunOptions};

/// Run the daemon: subscribe, estimate, publish, record, until SIGTERM or Ctrl-C.
///
/// SIGHUP reads the configuration again, says which of its settings wait for the next start, and begins new recordings.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  stictiond run --config config/monitor.toml
  stictiond run --config config/monitor.toml --shard 0/3 --id plant-0")]
pub struct Args {
    /// The configuration (TOML); `stictiond check FILE` lists every fault in it.
    #[arg(long)]
    pub config: PathBuf,
    /// This daemon's name in documents and topics, in place of `[daemon] id`.
    #[arg(long)]
    pub id: Option<String>,
    /// Watch one part of all loops, as INDEX/COUNT with INDEX from 0, in place of `[shard]`.
    #[arg(long, value_name = "INDEX/COUNT", value_parser = shard_of)]
    pub shard: Option<ShardKeys>,
    /// Workers for fits; all cores but one if not given.
    #[arg(long)]
    pub workers: Option<usize>,
}

/// Reads `--shard`.
fn shard_of(text: &str) -> Result<ShardKeys, String> {
    let [index, count] = Shard::parse(text).ok_or("write INDEX/COUNT, such as 0/3, with INDEX below COUNT")?.parts();
    Ok(ShardKeys { index, count })
}

/// Runs the command.
///
/// # Errors
/// A configuration with faults, a port that is taken, a folder that cannot be written.
pub fn run(args: &Args) -> anyhow::Result<Outcome> {
    let text = std::fs::read_to_string(&args.config).with_context(|| args.config.display().to_string())?;
    let mut config = match Config::parse(&text) {
        Ok(config) => config,
        Err(faults) => bail!("{} has faults:\n  {}", args.config.display(), list(&faults)),
    };
    if let Some(shard) = args.shard {
        if config.cluster.is_on() {
            bail!("--shard beside [cluster]: leave one of the two out");
        }
        config.shard = shard;
    }
    if let Some(id) = &args.id {
        if id.is_empty() || !is_id(id) {
            bail!("--id {id:?} cannot stand in a key: write up to 64 letters, digits and . _ -");
        }
        config.daemon.id.clone_from(id);
    }
    block_on(async {
        let options = RunOptions { origin: "run", workers: args.workers, config_path: Some(args.config.clone()) };
        // Before anything else: a daemon that is asked to stop while it starts ends in order too.
        let stop = asked_to_stop()?;
        daemon::run(config, text, options, stop).await
    })?;
    Ok(Outcome::Done)
}
