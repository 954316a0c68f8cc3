//! Metadata of a run's files, and the earlier run that it continues.

use std::collections::BTreeMap;

use stiction_engine::config::Config;
use stiction_engine::engine::Origins;
use stiction_files::columns::{METADATA_COLUMNS, METADATA_RAW};
use stiction_files::run::{ORIGINS, REFILLED_FROM};

/// Metadata that all files of a run share.
#[derive(Debug, Clone)]
pub struct RunInfo {
    /// First chunks of every topic.
    pub prefix: String,
    /// Names the run.
    pub run_id: String,
    /// When it started, ns.
    pub started_ns: i64,
    /// Which run of its folder, where that is counted.
    pub run_number: Option<u64>,
    /// What made it: `run`, `demo`, `simulate`.
    pub origin: &'static str,
    /// The configuration that files are recorded under.
    pub config: RecordedConfig,
    /// Id of the daemon, which its documents carry; empty where none made them.
    pub daemon: String,
    /// How its samples are written: `json` or `columns`.
    pub raw: String,
    /// The segments that go on where an earlier run ended.
    pub continued: BTreeMap<usize, Continued>,
}

/// The configuration as a file records it.
#[derive(Debug, Clone, Default)]
pub struct RecordedConfig {
    /// Its text.
    pub text: String,
    /// Its hash.
    pub hash: String,
    /// Its mapped loops, as JSON.
    pub loop_map: String,
    /// The configurations that loops' settings come from, as JSON; empty where that is this one alone.
    pub origins: String,
}

impl RecordedConfig {
    /// Of a configuration with this text.
    #[must_use]
    pub fn new(config: &Config, text: String) -> Self {
        let loop_map = serde_json::to_string(&config.loops).unwrap_or_default();
        Self { text, hash: config.hash(), loop_map, origins: String::new() }
    }

    /// The same after edits, which left the settings of some loops as they were.
    #[must_use]
    pub fn with_origins(self, origins: &Origins) -> Self {
        let is_plain = *origins == Origins::new(&self.hash);
        let origins = if is_plain { String::new() } else { serde_json::to_string(origins).unwrap_or_default() };
        Self { origins, ..self }
    }
}

/// Where the loops of a segment come from whose windows go on over a restart: names of files.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Continued {
    /// The first file that was read.
    pub from: String,
    /// The last one.
    pub previous: String,
}

impl RunInfo {
    /// The metadata of one file.
    #[must_use]
    pub fn metadata(&self, segment: usize, file_index: u32, previous: &str, lost: u64) -> BTreeMap<String, String> {
        let number = self.run_number.map(|n| ("run_number".to_owned(), n.to_string()));
        let mut metadata = BTreeMap::from(
            [
                ("prefix", self.prefix.clone()),
                ("version", stiction::core::VERSION.to_owned()),
                ("config", self.config.text.clone()),
                ("config_hash", self.config.hash.clone()),
                ("loop_map", self.config.loop_map.clone()),
                ("run_id", self.run_id.clone()),
                ("started_ns", self.started_ns.to_string()),
                ("origin", self.origin.to_owned()),
                ("shard", segment.to_string()),
                ("file_index", file_index.to_string()),
                ("previous", previous.to_owned()),
                ("lost_before", lost.to_string()),
            ]
            .map(|(k, v)| (k.to_owned(), v)),
        );
        metadata.extend(number);
        if let (0, Some(continued)) = (file_index, self.continued.get(&segment)) {
            metadata.insert(REFILLED_FROM.to_owned(), continued.from.clone());
        }
        // JSON goes without saying, as in the files from before there was anything else.
        if self.raw == METADATA_COLUMNS {
            metadata.insert(METADATA_RAW.to_owned(), self.raw.clone());
        }
        let edited = !self.config.origins.is_empty();
        metadata.extend(edited.then(|| (ORIGINS.to_owned(), self.config.origins.clone())));
        metadata.extend((!self.daemon.is_empty()).then(|| ("daemon".to_owned(), self.daemon.clone())));
        metadata
    }

    /// The name of one file, without its ending.
    #[must_use]
    pub fn stem(&self, segment: usize, file_index: u32) -> String {
        let stamp: String =
            stiction::core::units::format_rfc3339(self.started_ns).chars().filter(char::is_ascii_digit).collect();
        let stamp = &stamp[..stamp.len().min(14)];
        format!("{}-{stamp}-{}-s{segment}-{file_index:05}", self.prefix.replace('/', "_"), self.run_id)
    }
}
