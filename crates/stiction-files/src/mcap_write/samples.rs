//! Writes samples, one message each or gathered in columns.

use std::collections::BTreeMap;

use super::super::columns::{self, Columns, METADATA_COLUMNS, METADATA_RAW, Row};
use super::{RecordingFile, WriteError};
use stiction::core::record::Sample;
use stiction_engine::codec::encode_recorded;
use stiction_engine::codec::topic::Kind;

/// A buffer for columns if the file's metadata says so.
pub(super) fn wanted(metadata: &BTreeMap<String, String>) -> Option<Columns> {
    metadata.get(METADATA_RAW).is_some_and(|word| word == METADATA_COLUMNS).then(Columns::default)
}

impl RecordingFile {
    /// Appends a sample in the form that the file's metadata names. In columns it waits in memory until there are many, another
    /// message comes, or [`RecordingFile::flush`] is called.
    ///
    /// # Errors
    /// As [`RecordingFile::write`]; the error may concern earlier samples.
    pub fn sample(&mut self, topic: &str, arrival_ns: i64, sample: &Sample) -> Result<(), WriteError> {
        let kind = Kind::of_signal(sample.signal);
        if self.columns.is_none() {
            let mut json = std::mem::take(&mut self.json);
            json.clear();
            encode_recorded(sample, &mut json);
            let written = self.write(topic, kind, arrival_ns, sample.t_ns, &json);
            self.json = json;
            return written;
        }
        if !self.channels.contains_key(topic) {
            self.register(topic, Some(kind), "json")?;
        }
        // A file that has failed must not gather what it can never write.
        if self.has_failed() {
            return Err(self.refused());
        }
        let (Some(channel), Some(columns)) = (self.channels.get(topic), &mut self.columns) else {
            return Err(self.refused());
        };
        let Sample { t_ns, value, quality, .. } = *sample;
        columns.push(Row { channel: channel.id, t_ns, arrival_ns, value, quality });
        let is_full = columns.is_full();
        self.dirty = true;
        if is_full { self.write_columns() } else { Ok(()) }
    }

    /// Writes the waiting samples.
    pub(super) fn write_columns(&mut self) -> Result<(), WriteError> {
        let Some(columns) = &mut self.columns else { return Ok(()) };
        let Some(times_ns) = columns.times_ns() else { return Ok(()) };
        let payload = columns.take();
        let topic = columns::topic_of(&self.prefix);
        self.put(&topic, None, columns::ENCODING, times_ns, &payload)
    }

    pub(super) fn add_columns_schema(&mut self) -> Result<u16, WriteError> {
        let text = columns::LAYOUT.as_bytes();
        self.with_writer(|writer| writer.add_schema(columns::SCHEMA, columns::SCHEMA_ENCODING, text))
    }
}
