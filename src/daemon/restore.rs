//! Carries a loop's memory over a restart: alarm and gap watch, from the newest states of the last run's recordings.
//!
//! A file that cannot be read as a recording is put aside under another name; the daemon starts whatever it finds.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use crate::codec::topic::{Kind, Leaf, Topic};
use crate::engine::{Checkpoint, StateDocument};
use crate::files::{ReadError, RecordingReader};

/// Files of the last run that are read per shard: the last one may have been cut before its first flush.
const FILES_PER_SHARD: usize = 2;

/// One recording file of a folder.
#[derive(Debug, Clone)]
pub struct RunFile {
    /// Where it is.
    pub path: PathBuf,
    /// Start of its run, ns.
    pub started_ns: i64,
    /// Its run.
    pub run_id: String,
    /// Which of the files side by side.
    pub shard: usize,
    /// Its place among the shard's files.
    pub index: u32,
}

impl RunFile {
    /// Reads a file's place in its run from its metadata; `None` for recordings of others.
    #[must_use]
    pub fn of(path: &Path, metadata: &BTreeMap<String, String>) -> Option<Self> {
        let number = |key: &str| metadata.get(key)?.parse::<i64>().ok();
        Some(Self {
            path: path.to_owned(),
            started_ns: number("started_ns")?,
            run_id: metadata.get("run_id")?.clone(),
            shard: usize::try_from(number("shard")?).ok()?,
            index: u32::try_from(number("file_index")?).ok()?,
        })
    }
}

/// Whether a name is that of a recording, finished or not.
#[must_use]
pub fn is_recording(path: &Path) -> bool {
    let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    name.ends_with(".mcap") || name.ends_with(".mcap.part")
}

/// What the last run under this prefix ended with, by loop: alarms and gap watches, never the stream of points. Never fails: what cannot be read is logged.
#[must_use]
pub fn memories_of_last_run(dir: &Path, prefix: &str) -> BTreeMap<String, Checkpoint> {
    let mut files = Vec::new();
    let entries = fs::read_dir(dir).into_iter().flatten().flatten();
    for path in entries.map(|e| e.path()).filter(|p| p.is_file() && is_recording(p)) {
        match RecordingReader::open(&path) {
            Ok(reader) if reader.metadata().get("prefix").is_some_and(|p| p == prefix) => {
                files.extend(RunFile::of(&path, reader.metadata()));
            }
            Ok(_) => {}
            Err(ReadError::NotMcap { .. }) => quarantine(&path),
            Err(error) => tracing::warn!(%error, "a recording cannot be read and is left alone"),
        }
    }
    let Some(run_id) = files.iter().max_by_key(|f| f.started_ns).map(|f| f.run_id.clone()) else {
        return BTreeMap::new();
    };
    files.retain(|f| f.run_id == run_id);
    files.sort_by_key(|f| (f.shard, f.index));
    let mut memories = BTreeMap::new();
    for shard in files.chunk_by(|a, b| a.shard == b.shard) {
        for file in &shard[shard.len().saturating_sub(FILES_PER_SHARD)..] {
            if let Err(error) = read_states(&file.path, prefix, &mut memories) {
                tracing::warn!(%error, "states could not be read to the end");
            }
        }
    }
    tracing::info!(loops = memories.len(), run_id, "states carried over");
    memories
}

fn read_states(path: &Path, prefix: &str, memories: &mut BTreeMap<String, Checkpoint>) -> Result<(), ReadError> {
    let mut reader = RecordingReader::open(path)?;
    while let Some(message) = reader.next_message()? {
        let topic = Topic::parse(Some(prefix), message.topic());
        if topic.is_some_and(|t| t.leaf == Leaf::Document(Kind::State))
            && let Ok(state) = serde_json::from_slice::<StateDocument>(message.data)
        {
            memories.insert(state.loop_name, Checkpoint { stream: None, ..state.checkpoint });
        }
    }
    Ok(())
}

fn quarantine(path: &Path) {
    if fs::metadata(path).is_ok_and(|m| m.len() == 0) {
        // Cut before its first byte reached the disk: nothing is lost by taking it away.
        let _ = fs::remove_file(path);
        return;
    }
    let mut aside = path.as_os_str().to_owned();
    aside.push(".broken");
    match fs::rename(path, &aside) {
        Ok(()) => tracing::warn!(file = %path.display(), "this is no recording; it is put aside as .broken"),
        Err(error) => tracing::warn!(file = %path.display(), %error, "this is no recording and cannot be put aside"),
    }
}
