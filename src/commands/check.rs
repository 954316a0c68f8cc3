//! `stictiond check`: lists every fault of a configuration.

use std::path::{Path, PathBuf};

use anyhow::Context;
use serde_json::json;

use crate::cli::{Format, Outcome, say};
use crate::daemon::sink::deliver;
use crate::daemon::source::zenoh::session_config;
use crate::web::{time_zone_of, token_of};
use stiction_engine::config::{Config, Fault, Places};

/// Check a configuration, the files it names and the recording folder; list every fault with line and remedy.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example: stictiond check config/monitor.toml")]
pub struct Args {
    /// Configuration file (TOML).
    pub config: PathBuf,
}

/// Runs the command; faults give exit code 1.
///
/// # Errors
/// The file cannot be read.
pub fn run(args: &Args, format: Format) -> anyhow::Result<Outcome> {
    let text = std::fs::read_to_string(&args.config).with_context(|| args.config.display().to_string())?;
    let parsed = Config::parse(&text);
    let faults = match &parsed {
        Ok(config) => faults_outside(&text, config),
        Err(faults) => faults.clone(),
    };
    let hash = parsed.as_ref().ok().filter(|_| faults.is_empty()).map(Config::hash);
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
        for fault in &faults {
            say(format!("{path}: {fault}"))?;
        }
    }
    Ok(if faults.is_empty() { Outcome::Done } else { Outcome::Failed })
}

/// Faults in the files and folders that a valid configuration names.
fn faults_outside(text: &str, config: &Config) -> Vec<Fault> {
    let (mut faults, places) = (Vec::new(), Places::of(text));
    let mut refuse = |section: &str, key: &str, message: String, remedy: &str| {
        let (line, key) = (places.line_of(section, key), format!("{section}.{key}"));
        faults.push(Fault { line, key, message, remedy: remedy.to_owned() });
    };
    if let Err(error) = session_config(config) {
        let key = if config.zenoh.config_file.is_empty() { "connect" } else { "config_file" };
        refuse("zenoh", key, error.to_string(), "name a readable Zenoh configuration file (JSON5)");
    }
    if let Err(error) = time_zone_of(&config.web.page) {
        refuse("web", "time_zone", format!("{error:#}"), "see docs/page.md");
    }
    if let Err(error) = token_of(&config.web.page) {
        refuse("web", "token_file", format!("{error:#}"), "see docs/page.md");
    }
    if let Err(why) = can_be_written(Path::new(&config.recording.dir)) {
        refuse("recording", "dir", why, "name a folder that this user may write to or create");
    }
    for d in &config.deliver {
        if let Err(error) = deliver::check(d) {
            let (line, key) = (places.line_of_entry("deliver", &d.name), format!("deliver.{}", d.name));
            let remedy = "name a readable file".to_owned();
            faults.push(Fault { line, key, message: format!("{error:#}"), remedy });
        }
    }
    faults
}

/// Checks whether a folder is writable or can be created, without writing.
fn can_be_written(dir: &Path) -> Result<(), String> {
    let absolute = std::path::absolute(dir).map_err(|e| format!("{}: {e}", dir.display()))?;
    let mut there = absolute.as_path();
    loop {
        match std::fs::metadata(there) {
            Ok(found) if found.is_dir() => break,
            Ok(_) => return Err(format!("{} is not a folder", there.display())),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {}
            Err(error) => return Err(format!("{}: {error}", there.display())),
        }
        let Some(parent) = there.parent() else { break };
        there = parent;
    }
    #[cfg(target_os = "linux")]
    if let Err(error) = rustix::fs::access(there, rustix::fs::Access::WRITE_OK | rustix::fs::Access::EXEC_OK) {
        return Err(format!("cannot write to {}: {}", there.display(), std::io::Error::from(error)));
    }
    Ok(())
}
