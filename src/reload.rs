//! `stictiond reload`: a running daemon takes its changed configuration over.

use std::path::PathBuf;

use anyhow::bail;
use serde_json::json;

use super::reading::config_file;
use super::running::Running;
use super::{Format, Outcome, say};

/// Make a running daemon take over its changed configuration file; print what changed, or why it refuses.
///
/// Finds the daemon by the address of its page. A refused file changes nothing (exit 1). `systemctl reload stictiond` and
/// SIGHUP do the same, without an answer.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  stictiond reload config/monitor.toml
  stictiond reload config/monitor.toml --url http://127.0.0.1:8081")]
pub struct Args {
    /// Configuration file of the daemon.
    pub config: PathBuf,
    /// Address of the daemon's page [default: `[web] listen` of CONFIG].
    #[arg(long)]
    pub url: Option<String>,
}

/// Runs the command.
///
/// # Errors
/// The file has faults, no daemon answers, or it refuses the file.
pub fn run(args: &Args, format: Format) -> anyhow::Result<Outcome> {
    let (text, config) = config_file(&args.config)?;
    let running = Running::of(&config, args.url.as_deref(), "--url")?;
    let changes = running.reload()?;
    let left = running.changes(&text)?;
    if !left.is_empty() {
        let (path, url) = (args.config.display(), &running.url);
        bail!("{path}: the daemon at {url} reads another file, and has not taken over:\n{left}");
    }
    match format {
        Format::Json => say(json!({"schema": "stictiond.reload.v1", "url": running.url, "changes": changes}))?,
        Format::Text => say(format!("{}: in force\n{changes}", running.url))?,
    }
    Ok(Outcome::Done)
}
