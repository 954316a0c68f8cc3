//! `stictiond run`: the daemon.

use std::path::PathBuf;

use anyhow::{Context, bail};

use super::{Outcome, asked_to_stop, block_on, list};
use stiction_monitor::config::Config;
use stictiond::daemon::{self, RunOptions};

/// Run the daemon: subscribe, estimate, publish, record, until SIGTERM or Ctrl-C.
///
/// SIGHUP reads the configuration again, says which of its settings wait for the next start, and begins new recordings.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example: stictiond run --config config/monitor.toml")]
pub struct Args {
    /// The configuration (TOML); `stictiond check FILE` lists every fault in it.
    #[arg(long)]
    pub config: PathBuf,
    /// Workers for fits; all cores but one if not given.
    #[arg(long)]
    pub workers: Option<usize>,
}

/// Runs the command.
///
/// # Errors
/// A configuration with faults, a port that is taken, a folder that cannot be written.
pub fn run(args: &Args) -> anyhow::Result<Outcome> {
    let text = std::fs::read_to_string(&args.config).with_context(|| args.config.display().to_string())?;
    let config = match Config::parse(&text) {
        Ok(config) => config,
        Err(faults) => bail!("{} has faults:\n  {}", args.config.display(), list(&faults)),
    };
    block_on(async {
        let options = RunOptions { origin: "run", workers: args.workers, config_path: Some(args.config.clone()) };
        // Before anything else: a daemon that is asked to stop while it starts ends in order too.
        let stop = asked_to_stop()?;
        daemon::run(config, text, options, stop).await
    })?;
    Ok(Outcome::Done)
}
