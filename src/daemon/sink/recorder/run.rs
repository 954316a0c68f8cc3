//! Metadata of a run's files, and the earlier run that it continues.

use std::collections::BTreeMap;

use stiction_engine::config::{Config, RawForm};
use stiction_engine::engine::Origins;
use stiction_files::columns::METADATA_RAW;
use stiction_files::run::{ORIGINS, REFILLED_FROM};

/// Metadata common to all files of a run.
#[derive(Debug, Clone)]
pub struct RunInfo {
    /// First chunks of every topic.
    pub prefix: String,
    /// Id of the run.
    pub run_id: String,
    /// When it started, ns.
    pub started_ns: i64,
    /// Number of the run in its folder, if runs are counted there.
    pub run_number: Option<u64>,
    /// What produced it: `run`, `demo`, `simulate`.
    pub origin: &'static str,
    /// The configuration under which the files are recorded.
    pub config: RecordedConfig,
    /// Id of the daemon, which its documents carry; empty if there is no daemon.
    pub daemon: String,
    /// How its samples are written.
    pub raw: RawForm,
    /// The segments that continue an earlier run.
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
    /// The configurations that the loops' settings come from, as JSON; empty if that is this one alone.
    pub origins: String,
}

impl RecordedConfig {
    /// From a configuration and its text.
    #[must_use]
    pub fn new(config: &Config, text: String) -> Self {
        let loop_map = serde_json::to_string(&config.loops).unwrap_or_default();
        Self { text, hash: config.hash(), loop_map, origins: String::new() }
    }

    /// The same after edits that left the settings of some loops unchanged.
    #[must_use]
    pub fn with_origins(self, origins: &Origins) -> Self {
        let is_plain = *origins == Origins::new(&self.hash);
        let origins = if is_plain { String::new() } else { serde_json::to_string(origins).unwrap_or_default() };
        Self { origins, ..self }
    }
}

/// For a segment with windows that continue over a restart: names of the files they come from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Continued {
    /// The first file that was read.
    pub from: String,
    /// The last file that was read.
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
        // JSON is the default and not stated, as in files from before there was a choice.
        if self.raw == RawForm::Columns {
            metadata.insert(METADATA_RAW.to_owned(), self.raw.name().to_owned());
        }
        let edited = !self.config.origins.is_empty();
        metadata.extend(edited.then(|| (ORIGINS.to_owned(), self.config.origins.clone())));
        metadata.extend((!self.daemon.is_empty()).then(|| ("daemon".to_owned(), self.daemon.clone())));
        metadata
    }

    /// File name without extension.
    #[must_use]
    pub fn stem(&self, segment: usize, file_index: u32) -> String {
        let stamp: String =
            stiction::core::units::format_rfc3339(self.started_ns).chars().filter(char::is_ascii_digit).collect();
        let stamp = &stamp[..stamp.len().min(14)];
        format!("{}-{stamp}-{}-s{segment}-{file_index:05}", self.prefix.replace('/', "_"), self.run_id)
    }
}
