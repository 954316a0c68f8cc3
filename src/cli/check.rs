//! `stictiond check`: every fault of a configuration at once.

use std::path::PathBuf;

use anyhow::Context;
use serde_json::json;

use super::{Format, Outcome, say};
use crate::config::Config;

/// Check a configuration and list every fault with its line and what to write instead.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example: stictiond check config/monitor.toml")]
pub struct Args {
    /// The configuration (TOML).
    pub config: PathBuf,
}

/// Runs the command; faults end it with exit 1.
///
/// # Errors
/// The file cannot be read.
pub fn run(args: &Args, format: Format) -> anyhow::Result<Outcome> {
    let text = std::fs::read_to_string(&args.config).with_context(|| args.config.display().to_string())?;
    let parsed = Config::parse(&text);
    let faults = parsed.as_ref().err().map(Vec::as_slice).unwrap_or_default();
    let hash = parsed.as_ref().ok().map(Config::hash);
    let path = args.config.display().to_string();
    if format == Format::Json {
        let rows: Vec<_> = faults
            .iter()
            .map(|f| json!({"line": f.line, "key": f.key, "message": f.message, "remedy": f.remedy}))
            .collect();
        let ok = faults.is_empty();
        say(json!({"schema": "stictiond.check.v1", "file": path, "ok": ok, "config_hash": hash, "faults": rows}))?;
    } else if let Some(hash) = hash {
        say(format!("{path}: no faults (config hash {hash})"))?;
    } else {
        for fault in faults {
            say(format!("{path}: {fault}"))?;
        }
    }
    Ok(if faults.is_empty() { Outcome::Done } else { Outcome::Failed })
}
