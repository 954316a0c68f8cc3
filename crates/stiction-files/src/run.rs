//! What a recording of a run says of the run: its configuration, and the files that it goes on from.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{anyhow, bail};

use crate::rescue::{REMOVED, SAMPLES_KEY};
use crate::{InputKind, RecordingReader};
use stiction_engine::config::Config;
use stiction_engine::engine::{EngineSettings, Origins};

/// Metadata of a run that goes on from another: the first file that its loops were read from.
pub const REFILLED_FROM: &str = "refilled_from";

/// Metadata of files after an edit of the configuration: where the loops' settings come from, as JSON of [`Origins`].
pub const ORIGINS: &str = "settings_from";

/// What a recording says of how it was made.
#[derive(Debug, Clone)]
pub struct RunMetadata {
    /// First chunks of its topics.
    pub prefix: String,
    /// Version of the program.
    pub version: String,
    /// The configuration.
    pub config: Config,
    /// Hash of the configuration, as recorded.
    pub config_hash: String,
    /// Where the loops' settings come from; `None` where that is this configuration alone.
    pub origins: Option<Origins>,
    /// Id of the daemon, as its documents carry it; none in recordings of before.
    pub daemon: Option<String>,
    /// The shard's file before, of the same run or of the one that it goes on from; empty for the first.
    pub previous: String,
    /// Where it begins a run that goes on from another, the first file that its loops were read from.
    pub refilled_from: String,
    /// Messages that the recorder had lost by then.
    pub lost_before: u64,
    /// Whether the file is a daemon's own, with results.
    pub has_results: bool,
}

impl RunMetadata {
    /// Reads it from a file's metadata record.
    ///
    /// # Errors
    /// The file is not ours, or its configuration cannot be read.
    pub fn of(path: &Path, metadata: &BTreeMap<String, String>) -> anyhow::Result<Self> {
        let get = |key: &str| metadata.get(key).cloned().unwrap_or_default();
        let Some(prefix) = metadata.get("prefix").cloned() else {
            bail!("{}: not a recording of this program, so it cannot be replayed; use analyze", path.display());
        };
        if metadata.get(SAMPLES_KEY).is_some_and(|word| word == REMOVED) {
            bail!(
                "{}: its samples are older than [retention] keeps; its results can be read, not re-run",
                path.display()
            );
        }
        let text = get("config");
        let config = if text.is_empty() {
            Config::with_prefix(&prefix)
        } else {
            Config::parse(&text).map_err(|faults| {
                let list: Vec<String> = faults.iter().map(ToString::to_string).collect();
                anyhow!("{}: its configuration: {}", path.display(), list.join("; "))
            })?
        };
        Ok(Self {
            prefix,
            version: get("version"),
            config_hash: get("config_hash"),
            origins: serde_json::from_str(&get(ORIGINS)).ok(),
            daemon: metadata.get("daemon").cloned(),
            config,
            previous: get("previous"),
            refilled_from: get(REFILLED_FROM),
            lost_before: get("lost_before").parse().unwrap_or(0),
            has_results: matches!(get("origin").as_str(), "run" | "demo" | "simulate"),
        })
    }
}

impl RunMetadata {
    /// Settings of the engine that made the file.
    #[must_use]
    pub fn engine(&self) -> EngineSettings {
        let settings = self.config.engine();
        let origins = self.origins.clone().unwrap_or_else(|| settings.origins.clone());
        EngineSettings { origins, ..settings }
    }
}

/// Where a recording stands among those of its run, by its name.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FilePlace {
    /// Its run.
    pub run_id: String,
    /// Which of the files side by side.
    pub shard: usize,
    /// Its place among the shard's files.
    pub index: u32,
}

impl FilePlace {
    /// Of a recording with a name as the recorder gives it, finished or not.
    #[must_use]
    pub fn of(path: &Path) -> Option<Self> {
        let name = path.file_name()?.to_str()?;
        let mut parts = name.strip_suffix(".part").unwrap_or(name).strip_suffix(".mcap")?.rsplitn(4, '-');
        let (index, shard, run_id) = (parts.next()?, parts.next()?, parts.next()?);
        let (shard, index) = (shard.strip_prefix('s')?.parse().ok()?, index.parse().ok()?);
        Some(Self { run_id: run_id.to_owned(), shard, index })
    }
}

/// The configuration that a file was recorded under; the defaults for any other.
///
/// # Errors
/// The file cannot be read, or it is a recording of ours whose configuration cannot be.
pub fn config_of(path: &Path) -> anyhow::Result<Config> {
    if path.is_file() && InputKind::detect(path)? == InputKind::Mcap {
        let reader = RecordingReader::open(path)?;
        if reader.metadata().contains_key("config") {
            return Ok(RunMetadata::of(path, reader.metadata())?.config);
        }
    }
    Ok(Config::with_prefix("plant"))
}
