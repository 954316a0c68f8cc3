//! Copies of recordings: the readable part of a damaged one, or the results without samples.

use std::fs::{self, File};
use std::path::{Path, PathBuf};

use thiserror::Error;

use super::{End, Item, ReadError, RecordingFile, RecordingReader, WriteError};
use stiction_engine::codec::topic::Kind;

/// Metadata key of a recording whose samples were removed.
pub const SAMPLES_KEY: &str = "samples";
/// Its value.
pub const REMOVED: &str = "removed";

/// An error that prevented a copy; none is left behind.
#[derive(Debug, Error)]
pub enum RescueError {
    /// The input cannot be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The copy cannot be written.
    #[error(transparent)]
    Write(#[from] WriteError),
    /// The system refuses an operation.
    #[error("{}: {cause}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// Error of the system.
        cause: std::io::Error,
    },
}

/// A finished copy.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Rescued {
    /// Number of messages in it.
    pub messages: u64,
    /// How the input ended.
    pub end: End,
}

/// Copies every readable message to `out`, which appears once complete. An undamaged recording is copied byte for byte.
///
/// # Errors
/// [`RescueError`]; `out` is then absent or unchanged.
pub fn recover(path: &Path, out: &Path) -> Result<Rescued, RescueError> {
    let rescued = copy(path, out, None)?;
    if rescued.end.is_clean() {
        fs::copy(path, out).map_err(|cause| RescueError::Io { path: out.to_owned(), cause })?;
    }
    Ok(rescued)
}

/// Replaces a recording by its results alone, with the same name and age.
///
/// # Errors
/// [`RescueError`]; the recording is then unchanged.
pub fn take_samples_out(path: &Path, out: &Path) -> Result<Rescued, RescueError> {
    let failed = |cause| RescueError::Io { path: path.to_owned(), cause };
    let modified = fs::metadata(path).and_then(|m| m.modified()).map_err(failed)?;
    let rescued = copy(path, out, Some(REMOVED))?;
    File::options().write(true).open(out).and_then(|file| file.set_modified(modified)).map_err(failed)?;
    if out != path {
        fs::remove_file(path).map_err(failed)?;
    }
    Ok(rescued)
}

/// Temporary name of an incomplete copy; not the name of a recording.
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
        fs::remove_file(&part).map_err(|cause| RescueError::Io { path: part.clone(), cause })?;
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
