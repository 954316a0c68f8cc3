//! `stictiond recover`: complete recordings from truncated and damaged ones.

use std::collections::HashSet;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use serde_json::json;

use crate::cli::{Format, Outcome, say};
use stiction_files::rescue;

/// Rescue the readable part of a truncated or damaged recording, or of a folder of recordings.
///
/// Exit 0: the recording was complete and was copied. Exit 3: the readable part was written. Exit 1: not a recording;
/// nothing is written.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  stictiond recover plant.mcap.part --out plant.mcap
  stictiond recover recordings --out rescued")]
pub struct Args {
    /// Recording, or folder of recordings.
    pub input: PathBuf,
    /// Output file or folder [default: NAME.recovered.mcap next to the input].
    #[arg(long)]
    pub out: Option<PathBuf>,
    /// Replace existing files.
    #[arg(long)]
    pub force: bool,
}

/// Runs the command.
///
/// # Errors
/// Not a recording, an output that exists, or a disk error.
pub fn run(args: &Args, format: Format) -> anyhow::Result<Outcome> {
    if !args.input.is_dir() {
        let out = args.out.clone().unwrap_or_else(|| beside(&args.input));
        return one(&args.input, &out, args.force, format);
    }
    let Some(folder) = &args.out else {
        bail!("name a folder for the rescued recordings of {} with --out", args.input.display())
    };
    std::fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
    let entries = std::fs::read_dir(&args.input).with_context(|| args.input.display().to_string())?;
    let mut files: Vec<PathBuf> = entries.flatten().map(|e| e.path()).filter(|p| p.is_file() && is_one(p)).collect();
    files.sort();
    if files.is_empty() {
        bail!("{}: contains no recordings (.mcap, .mcap.part)", args.input.display());
    }
    let (mut worst, mut taken) = (Outcome::Done, HashSet::new());
    for path in files {
        let out = folder.join(name_among(&path, &mut taken));
        match one(&path, &out, args.force, format) {
            Ok(Outcome::DataLoss) => worst = Outcome::DataLoss,
            Ok(_) => {}
            Err(error) => {
                crate::cli::warn(format_args!("{}", crate::cli::causes_without_repeats(&error)));
                worst = Outcome::DataLoss;
            }
        }
    }
    Ok(worst)
}

fn one(path: &Path, out: &Path, force: bool, format: Format) -> anyhow::Result<Outcome> {
    // Writing over the recording while reading it would destroy what the command should rescue.
    if let (Ok(read), Ok(written)) = (std::fs::canonicalize(path), std::fs::canonicalize(out))
        && read == written
    {
        bail!("{}: is the input itself; name another file or folder with --out", out.display());
    }
    if out.exists() && !force {
        bail!("{}: already exists; use --force to replace it", out.display());
    }
    let rescued = rescue::recover(path, out)?;
    let (messages, end) = (rescued.messages, rescued.end);
    match format {
        Format::Json => say(json!({"schema": "stictiond.recover.v1", "file": path, "out": out, "messages": messages,
            "state": end.word(), "reason": end.reason()}))?,
        Format::Text => {
            let reason = end.reason().map(|r| format!(" ({r})")).unwrap_or_default();
            say(format!("{}: was {}{reason}; {messages} messages in {}", path.display(), end.word(), out.display()))?;
        }
    }
    Ok(if end.is_clean() { Outcome::Done } else { Outcome::DataLoss })
}

/// Whether a file name is that of a recording: finished, open or set aside.
fn is_one(path: &Path) -> bool {
    path.file_name().is_some_and(|name| name.to_string_lossy().contains(".mcap"))
}

/// The name of the rescued file.
fn name_of(path: &Path) -> String {
    let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let stem = name.split(".mcap").next().unwrap_or(&name);
    format!("{stem}.mcap")
}

/// The name of the rescued file in a folder where an open and a finished file may share a name.
fn name_among(path: &Path, taken: &mut HashSet<String>) -> String {
    let name = name_of(path);
    let stem = name.trim_end_matches(".mcap");
    let others = (2..).map(|number| format!("{stem}.{number}.mcap"));
    let free = std::iter::once(name.clone()).chain(others).find(|name| taken.insert(name.clone()));
    free.unwrap_or(name)
}

fn beside(path: &Path) -> PathBuf {
    let name = name_of(path);
    path.with_file_name(format!("{}.recovered.mcap", name.trim_end_matches(".mcap")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_of_one_stem_do_not_overwrite_each_other() {
        let mut taken = HashSet::new();
        let names =
            ["a.mcap", "a.mcap.broken", "a.mcap.part", "b.mcap.part"].map(|n| name_among(Path::new(n), &mut taken));
        assert_eq!(names, ["a.mcap", "a.2.mcap", "a.3.mcap", "b.mcap"]);
    }
}
