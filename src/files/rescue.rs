//! Copies of recordings: all that can be read of a damaged one, or its results without the samples.

use std::fs::{self, File};
use std::path::{Path, PathBuf};

use thiserror::Error;

use super::{End, Item, ReadError, RecordingFile, RecordingReader, WriteError};
use stiction_monitor::codec::topic::Kind;

/// Metadata key of a recording whose samples were taken out.
pub const SAMPLES_KEY: &str = "samples";
/// What it says then.
pub const REMOVED: &str = "removed";

/// Why a copy could not be made; there is none then.
#[derive(Debug, Error)]
pub enum RescueError {
    /// The recording.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The copy.
    #[error(transparent)]
    Write(#[from] WriteError),
    /// The system refuses.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
}

/// What a copy holds.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Rescued {
    /// Messages in it.
    pub messages: u64,
    /// How the recording that was read ended.
    pub end: End,
}

/// Copies every message that can be read into `out`, which appears once it is whole. A recording without damage is
/// copied byte for byte.
///
/// # Errors
/// [`RescueError`]; `out` is not there then, or is what it was.
pub fn recover(path: &Path, out: &Path) -> Result<Rescued, RescueError> {
    let rescued = copy(path, out, None)?;
    if rescued.end.is_clean() {
        fs::copy(path, out).map_err(|source| RescueError::Io { path: out.to_owned(), source })?;
    }
    Ok(rescued)
}

/// Replaces a recording by one of its results alone, under the same name and with the same age.
///
/// # Errors
/// [`RescueError`]; the recording is what it was then.
pub fn take_samples_out(path: &Path, out: &Path) -> Result<Rescued, RescueError> {
    let failed = |source| RescueError::Io { path: path.to_owned(), source };
    let modified = fs::metadata(path).and_then(|m| m.modified()).map_err(failed)?;
    let rescued = copy(path, out, Some(REMOVED))?;
    File::options().write(true).open(out).and_then(|file| file.set_modified(modified)).map_err(failed)?;
    if out != path {
        fs::remove_file(path).map_err(failed)?;
    }
    Ok(rescued)
}

/// What is written until a copy is whole; does not look like a recording.
#[must_use]
pub fn under_way(out: &Path) -> PathBuf {
    let mut name = out.as_os_str().to_owned();
    name.push(".copying");
    PathBuf::from(name)
}

fn copy(path: &Path, out: &Path, without_samples: Option<&str>) -> Result<Rescued, RescueError> {
    let mut reader = RecordingReader::open(path)?;
    let mut metadata = reader.metadata().clone();
    metadata.extend(without_samples.map(|word| (SAMPLES_KEY.to_owned(), word.to_owned())));
    let part = under_way(out);
    if part.exists() {
        fs::remove_file(&part).map_err(|source| RescueError::Io { path: part.clone(), source })?;
    }
    let written = write(&mut reader, &part, out, &metadata, without_samples.is_some());
    if written.is_err() {
        // Half a copy helps nobody.
        let _ = fs::remove_file(&part);
    }
    let messages = written?;
    Ok(Rescued { messages, end: reader.end().cloned().unwrap_or(End::Clean) })
}

fn write(
    reader: &mut RecordingReader,
    part: &Path,
    out: &Path,
    metadata: &std::collections::BTreeMap<String, String>,
    results_only: bool,
) -> Result<u64, RescueError> {
    let mut file = RecordingFile::create_at(part.to_owned(), out.to_owned(), metadata)?.sealed();
    let mut messages = 0;
    while let Some(item) = reader.next_item()? {
        if results_only && matches!(item.channel().1.kind, Some(Kind::Sample | Kind::Mode)) {
            continue;
        }
        let m = match item {
            Item::Message(message) => message,
            Item::Sample(raw) => {
                file.sample(&raw.channel.topic, raw.log_time_ns, &raw.sample)?;
                messages += 1;
                continue;
            }
        };
        let (topic, kind, encoding) = (m.topic(), m.channel.kind, m.channel.encoding.as_str());
        file.copy(topic, kind, encoding, m.log_time_ns, m.publish_time_ns, m.data)?;
        messages += 1;
    }
    file.finish()?;
    Ok(messages)
}
