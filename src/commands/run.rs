//! `stictiond run`: the daemon.

use std::os::unix::process::CommandExt;
use std::path::PathBuf;
use std::time::Duration;

use anyhow::bail;

use crate::cli::{Outcome, asked_to_stop, block_on};
use crate::daemon::{ConfigFile, HEALTH_EVERY, RunOptions};
use stiction_engine::config::is_id;
use stiction_engine::shard::Shard;

/// Run the daemon: subscribe, estimate, publish and record until SIGTERM or Ctrl-C.
///
/// SIGHUP reloads the configuration, which adds, changes and removes loops, and starts new recordings. A file that changes
/// what cannot change while the daemon runs is refused as a whole.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  stictiond run --config config/monitor.toml
  stictiond run --config config/monitor.toml --shard 0/3 --id plant-0")]
pub struct Args {
    /// Configuration file (TOML); `stictiond check FILE` lists its faults.
    #[arg(long)]
    pub config: PathBuf,
    /// Name of this daemon in documents and topics; overrides `[daemon] id`.
    #[arg(long)]
    pub id: Option<String>,
    /// Watch part INDEX (from 0) of COUNT parts of all loops; overrides `[shard]`.
    #[arg(long, value_name = "INDEX/COUNT", value_parser = shard_of)]
    pub shard: Option<Shard>,
    /// Worker threads for fits [default: all cores but one].
    #[arg(long)]
    pub workers: Option<usize>,
    /// How often the health documents are made, s: tests wait for them.
    #[arg(long, hide = true, value_parser = seconds)]
    pub health_every_s: Option<f64>,
}

/// Assigns Zenoh's tasks to threads, which Zenoh reads from the environment before its first thread starts. One thread both
/// accepts connections and closes those beyond the limit: on two threads the first could run ahead of the second, and the
/// connections between them would use up all descriptors.
const ZENOH_THREADS: [&str; 2] = ["ZENOH_RUNTIME", "(acc:(handover:net))"];

/// Replaces this process by the same program with the setting. If that fails, continues without it.
fn share_zenoh_threads() {
    let [name, value] = ZENOH_THREADS;
    let (mut args, program) = (std::env::args_os(), std::env::current_exe());
    if std::env::var_os(name).is_some() {
        return;
    }
    let (Some(own_name), Ok(program)) = (args.next(), program) else { return };
    let error = std::process::Command::new(program).arg0(own_name).args(args).env(name, value).exec();
    tracing::warn!(%error, "cannot start with {name}={value}: set it in the environment");
}

/// Parses a number of seconds for a timer.
fn seconds(text: &str) -> Result<f64, String> {
    let number = text.parse::<f64>().ok().filter(|s| (0.01..=3600.0).contains(s));
    number.ok_or_else(|| "write a number of seconds from 0.01 to 3600".to_owned())
}

/// Parses `--shard`.
fn shard_of(text: &str) -> Result<Shard, String> {
    Shard::parse(text).ok_or_else(|| "write INDEX/COUNT, such as 0/3, with INDEX below COUNT".to_owned())
}

/// Runs the command.
///
/// # Errors
/// A faulty configuration, a port in use, or a folder that cannot be written.
pub fn run(args: &Args) -> anyhow::Result<Outcome> {
    if let Some(id) = args.id.as_ref().filter(|id| id.is_empty() || !is_id(id)) {
        bail!("--id {id:?} is not a valid name; use up to 64 letters, digits and . _ -");
    }
    share_zenoh_threads();
    let file = ConfigFile { path: args.config.clone(), id: args.id.clone(), shard: args.shard };
    let (config, text) = file.read()?;
    block_on(async {
        let options = RunOptions {
            workers: args.workers,
            config_file: Some(file),
            health_every: args.health_every_s.map_or(HEALTH_EVERY, Duration::from_secs_f64),
            ..RunOptions::of("run", crate::web::serve)
        };
        // First of all, so that a daemon that is stopped while it starts also shuts down in order.
        let stop = asked_to_stop()?;
        crate::daemon::run(config, text, options, stop).await
    })?;
    Ok(Outcome::Done)
}
