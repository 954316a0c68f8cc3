//! Man pages and completions from the text of `--help`.

use std::path::{Path, PathBuf};

use anyhow::Context;
use clap::Command;
pub use clap_complete::Shell;
use serde_json::json;

use crate::cli::{Format, Outcome, refuse_existing, say};

/// Options of a program's `manual`.
#[derive(Debug, clap::Args)]
pub struct ManualArgs {
    /// Output folder; created if missing.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Replace existing man pages.
    #[arg(long)]
    pub force: bool,
}

/// Writes a program's man pages, one per command, and says where.
///
/// # Errors
/// A page exists, or cannot be written.
pub fn run(command: Command, args: &ManualArgs, format: Format) -> anyhow::Result<Outcome> {
    let pages = write(command, args)?;
    match format {
        Format::Json => say(json!({"schema": "stictiond.manual.v1", "pages": pages}))?,
        Format::Text => say(format!("{} man pages in {}", pages.len(), args.out.display()))?,
    }
    Ok(Outcome::Done)
}

/// Writes a program's man pages, one per command. Returns their paths.
fn write(command: Command, args: &ManualArgs) -> anyhow::Result<Vec<PathBuf>> {
    let place = || args.out.display().to_string();
    let program = command.get_name().to_owned();
    std::fs::create_dir_all(&args.out).with_context(place)?;
    for path in pages(&args.out, &program)? {
        refuse_existing(&path, args.force)?;
    }
    clap_mangen::generate_to(command.disable_help_subcommand(true), &args.out).with_context(place)?;
    pages(&args.out, &program)
}

/// A program's man pages in a folder, by name.
fn pages(folder: &Path, program: &str) -> anyhow::Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).with_context(|| folder.display().to_string())? {
        let path = entry?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        if name.starts_with(program) && name.ends_with(".1") {
            found.push(path);
        }
    }
    found.sort();
    Ok(found)
}

/// Completions of a program for a shell.
#[must_use]
pub fn completions(mut command: Command, shell: Shell) -> String {
    let (mut out, program) = (Vec::new(), command.get_name().to_owned());
    clap_complete::generate(shell, &mut command, program, &mut out);
    String::from_utf8_lossy(&out).into_owned()
}
