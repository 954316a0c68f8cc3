//! `stictiond manual --out DIR`: man pages, one per command, from the same text as `--help`.

use std::path::{Path, PathBuf};

use anyhow::Context;
use clap::CommandFactory;
use serde_json::json;

use super::{Cli, Format, Outcome, convert, say};

/// Write man pages, one per command.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example: stictiond manual --out /usr/local/share/man/man1")]
pub struct Args {
    /// Output folder; created if missing.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Replace existing man pages.
    #[arg(long)]
    pub force: bool,
}

/// Runs the command.
///
/// # Errors
/// A page exists, or cannot be written.
pub fn run(args: &Args, format: Format) -> anyhow::Result<Outcome> {
    let place = || args.out.display().to_string();
    std::fs::create_dir_all(&args.out).with_context(place)?;
    for path in pages(&args.out)? {
        convert::refuse_existing(&path, args.force)?;
    }
    let command = Cli::command().disable_help_subcommand(true);
    clap_mangen::generate_to(command, &args.out).with_context(place)?;
    let pages = pages(&args.out)?;
    match format {
        Format::Json => say(json!({"schema": "stictiond.manual.v1", "pages": pages}))?,
        Format::Text => say(format!("{} man pages in {}", pages.len(), args.out.display()))?,
    }
    Ok(Outcome::Done)
}

/// The program's man pages in a folder, by name.
fn pages(folder: &Path) -> anyhow::Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).with_context(|| folder.display().to_string())? {
        let path = entry?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        if name.starts_with("stictiond") && name.ends_with(".1") {
            found.push(path);
        }
    }
    found.sort();
    Ok(found)
}
