//! Writes a recording: one open MCAP file that appears under its final name once complete.
//!
//! The file grows as `NAME.mcap.part`. [`RecordingFile::flush`] closes the open chunk and writes it to the disk, so a crash
//! loses at most what came later. [`RecordingFile::finish`] writes the index, syncs, renames to `NAME.mcap` and syncs the
//! folder. An MCAP file cannot be reopened: rotate instead.

mod samples;

use super::alarm_log::{self, LOG_SCHEMA, log_message, log_topic};
use super::columns::{self, Columns};
use super::disk::{Disk, DiskFile, Handle, MemoryDisk, SystemDisk};
use super::mcap_roster::{Listed, Roster};
use super::schemas;
use super::seal::Sum;
use mcap::records::{MessageHeader, Metadata};
use mcap::{Compression, McapError, WriteOptions, Writer};
use std::collections::{BTreeMap, HashMap};
use std::fs;
use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use stiction_engine::codec::topic::Kind;
use thiserror::Error;

/// Most channels per file: every file repeats its channels, and indexes grow with them.
pub const MAX_CHANNELS: usize = 10_000;

/// Uncompressed size at which a chunk is closed, bytes.
const CHUNK_BYTES: u64 = 1 << 20;

/// Bytes after which the list of all channels is written again, so that it is never far from any place in the file.
const ROSTER_EVERY: u64 = 8 << 20;

/// An error while writing a recording.
#[derive(Debug, Error)]
pub enum WriteError {
    /// The folder or file cannot be created, synced or renamed.
    #[error("{}: {cause}; check that the folder exists, is writable and has free space", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// Error of the system.
        cause: io::Error,
    },
    /// Writing failed; the file ends with its last flush.
    #[error("{}: {cause}; the file is readable up to its last flush; continue in a new file", path.display())]
    Mcap {
        /// The open file.
        path: PathBuf,
        /// Error of the MCAP writer.
        cause: McapError,
    },
    /// An earlier error closed the file.
    #[error("{}: an earlier error closed this file; continue in a new file", path.display())]
    Failed {
        /// The file.
        path: PathBuf,
    },
    /// The file has the most channels allowed.
    #[error("{}: no channel for {topic:?}, all {limit} are in use; record further loops in another file", path.display())]
    Full {
        /// The file.
        path: PathBuf,
        /// [`MAX_CHANNELS`].
        limit: usize,
        /// The topic without a channel.
        topic: String,
    },
}

/// Memory of the index per channel and chunk of the open file, bytes.
const INDEX_ENTRY_BYTES: u64 = 40;

/// One channel of the open file.
struct Channel {
    id: u16,
    sequence: u32,
    /// The last flush that used it.
    flush: u64,
}

type Inner = Counted<BufWriter<Handle>>;

/// A recording being written. Dropping it without [`RecordingFile::finish`] leaves the `.part` file.
pub struct RecordingFile {
    writer: Option<Writer<Inner>>,
    file: Arc<dyn DiskFile>,
    disk: Arc<dyn Disk>,
    part: PathBuf,
    target: PathBuf,
    written: Arc<AtomicU64>,
    sum: Arc<Mutex<Sum>>,
    schemas: HashMap<Kind, u16>,
    channels: HashMap<String, Channel>,
    /// All channels, and those not yet in any list in the file.
    roster: Roster,
    unlisted: Roster,
    /// Size of the file when all channels were last listed.
    listed_at: u64,
    dirty: bool,
    /// Number of flushes, and of channels per closed chunk: the growth of the index.
    flushes: u64,
    indexed: u64,
    /// Whether the file ends with a SHA-256 of its content.
    sealed: bool,
    /// Samples waiting for their message, if written in columns.
    columns: Option<Columns>,
    /// Buffer for one sample's JSON.
    json: Vec<u8>,
    /// Prefix of every topic.
    prefix: String,
}

impl RecordingFile {
    /// Creates `dir/stem.mcap.part` (and a missing folder) and writes the metadata record named [`super::METADATA_NAME`].
    ///
    /// # Errors
    /// [`WriteError::Io`] also if a file of that name exists, open or finished.
    pub fn create(dir: &Path, stem: &str, metadata: &BTreeMap<String, String>) -> Result<Self, WriteError> {
        Self::create_on(&(Arc::new(SystemDisk) as Arc<dyn Disk>), dir, stem, metadata)
    }

    /// As [`RecordingFile::create`], on the given disk.
    ///
    /// # Errors
    /// As [`RecordingFile::create`].
    pub fn create_on(
        disk: &Arc<dyn Disk>,
        dir: &Path,
        stem: &str,
        metadata: &BTreeMap<String, String>,
    ) -> Result<Self, WriteError> {
        disk.create_folder(dir).map_err(|cause| WriteError::Io { path: dir.to_owned(), cause })?;
        let target = dir.join(format!("{stem}.mcap"));
        if target.exists() {
            let cause = io::Error::new(io::ErrorKind::AlreadyExists, "this recording already exists");
            return Err(WriteError::Io { path: target, cause });
        }
        Ok(Self::begin(disk, dir.join(format!("{stem}.mcap.part")), target, metadata)?.sealed())
    }

    /// Makes the file end with a SHA-256 of its content.
    #[must_use]
    pub fn sealed(self) -> Self {
        Self { sealed: true, ..self }
    }

    /// Creates `part`, which must not exist; [`RecordingFile::finish`] renames it to `target`, replacing an existing file.
    ///
    /// # Errors
    /// [`WriteError`] if the file cannot be created or written.
    pub fn create_at(part: PathBuf, target: PathBuf, metadata: &BTreeMap<String, String>) -> Result<Self, WriteError> {
        Self::begin(&(Arc::new(SystemDisk) as Arc<dyn Disk>), part, target, metadata)
    }

    /// A recording in memory; the disk has its bytes once it is finished.
    ///
    /// # Errors
    /// [`WriteError`] if it cannot be written.
    pub fn create_in_memory(metadata: &BTreeMap<String, String>) -> Result<(Self, MemoryDisk), WriteError> {
        let disk = MemoryDisk::default();
        let shared = Arc::new(disk.clone()) as Arc<dyn Disk>;
        Ok((Self::begin(&shared, PathBuf::new(), PathBuf::new(), metadata)?, disk))
    }

    fn begin(
        disk: &Arc<dyn Disk>,
        part: PathBuf,
        target: PathBuf,
        metadata: &BTreeMap<String, String>,
    ) -> Result<Self, WriteError> {
        let file = disk.create_new(&part).map_err(|cause| WriteError::Io { path: part.clone(), cause })?;
        Self::start(disk.clone(), file, (part.clone(), target), metadata).inspect_err(|_| {
            // An empty file under this name would stand in the way of the next attempt.
            let _ = fs::remove_file(&part);
        })
    }

    fn start(
        disk: Arc<dyn Disk>,
        file: Arc<dyn DiskFile>,
        (part, target): (PathBuf, PathBuf),
        metadata: &BTreeMap<String, String>,
    ) -> Result<Self, WriteError> {
        let written = Arc::new(AtomicU64::new(0));
        let sum = Arc::new(Mutex::new(Sum::default()));
        let inner = BufWriter::with_capacity(1 << 16, Handle(file.clone()));
        let sink = Counted { inner, written: Arc::clone(&written), sum: Arc::clone(&sum) };
        // Whole chunks reach the file at once (no seeking back), so a reader of the open file meets none half written.
        let options = WriteOptions::new()
            .library(format!("stictiond {}", stiction::core::VERSION))
            .compression(Some(Compression::Zstd))
            .compression_threads(0)
            .chunk_size(Some(CHUNK_BYTES))
            .disable_seeking(true);
        let writer = options.create(sink).map_err(|cause| WriteError::Mcap { path: part.clone(), cause })?;
        let mut recording = Self {
            writer: Some(writer),
            file,
            disk,
            part,
            target,
            written,
            sum,
            schemas: HashMap::new(),
            channels: HashMap::new(),
            roster: Roster::default(),
            unlisted: Roster::default(),
            listed_at: 0,
            dirty: true,
            flushes: 1,
            indexed: 0,
            sealed: false,
            columns: samples::wanted(metadata),
            json: Vec::new(),
            prefix: metadata.get(super::METADATA_PREFIX).cloned().unwrap_or_default(),
        };
        let metadata = Metadata { name: super::METADATA_NAME.to_owned(), metadata: metadata.clone() };
        recording.with_writer(|writer| writer.write_metadata(&metadata))?;
        recording.flush()?;
        Ok(recording)
    }

    /// Appends one message; its channel is registered on first use.
    ///
    /// Times are ns since 1970. MCAP cannot store earlier ones; they become 0 there, and the payload keeps them exactly.
    ///
    /// # Errors
    /// After [`WriteError::Full`] the file is still usable; after any other error it rejects further messages.
    pub fn write(
        &mut self,
        topic: &str,
        kind: Kind,
        log_time_ns: i64,
        publish_time_ns: i64,
        payload: &[u8],
    ) -> Result<(), WriteError> {
        self.copy(topic, Some(kind), "json", log_time_ns, publish_time_ns, payload)
    }

    /// Appends a message of any kind as read from another file.
    ///
    /// # Errors
    /// As [`RecordingFile::write`].
    pub fn copy(
        &mut self,
        topic: &str,
        kind: Option<Kind>,
        encoding: &str,
        log_time_ns: i64,
        publish_time_ns: i64,
        payload: &[u8],
    ) -> Result<(), WriteError> {
        // What came before stands before.
        self.write_columns()?;
        self.put(topic, kind, encoding, [log_time_ns, publish_time_ns], payload)
    }

    fn put(
        &mut self,
        topic: &str,
        kind: Option<Kind>,
        encoding: &str,
        [log_time_ns, publish_time_ns]: [i64; 2],
        payload: &[u8],
    ) -> Result<(), WriteError> {
        if !self.channels.contains_key(topic) {
            self.register(topic, kind, encoding)?;
        }
        let Some(channel) = self.channels.get_mut(topic) else { return Err(self.refused()) };
        let header = MessageHeader {
            channel_id: channel.id,
            sequence: channel.sequence,
            log_time: mcap_time(log_time_ns),
            publish_time: mcap_time(publish_time_ns),
        };
        channel.sequence = channel.sequence.wrapping_add(1);
        if std::mem::replace(&mut channel.flush, self.flushes) != self.flushes {
            self.indexed += 1;
        }
        self.dirty = true;
        self.with_writer(|writer| writer.write_to_known_channel(&header, payload))
    }

    /// Appends the log message of an alarm, for viewers.
    ///
    /// # Errors
    /// As [`RecordingFile::write`].
    pub fn log_alarm(&mut self, log_time_ns: i64, publish_time_ns: i64, alarm: &[u8]) -> Result<(), WriteError> {
        let Some(message) = log_message(alarm) else { return Ok(()) };
        self.copy(&log_topic(&self.prefix), None, "json", log_time_ns, publish_time_ns, &message)
    }

    /// Closes the open chunk and waits until it is on the disk; does nothing if there are no new messages.
    ///
    /// # Errors
    /// [`WriteError`]; the file then rejects further messages.
    pub fn flush(&mut self) -> Result<(), WriteError> {
        if !self.dirty {
            return if self.writer.is_some() { Ok(()) } else { Err(self.refused()) };
        }
        self.write_columns()?;
        self.list_channels()?;
        self.with_writer(Writer::flush)?;
        self.dirty = false;
        self.flushes += 1;
        self.file.sync(false).map_err(|cause| self.fail(cause))
    }

    /// Lists new channels outside the chunks, and from time to time all of them: a chunk contains only the channels that it is
    /// the first to use, and a damaged one would lose them.
    fn list_channels(&mut self) -> Result<(), WriteError> {
        let written = self.bytes_written();
        let all = written.saturating_sub(self.listed_at) >= ROSTER_EVERY && !self.roster.is_empty();
        if self.unlisted.is_empty() && !all {
            return Ok(());
        }
        let listed = std::mem::take(&mut self.unlisted);
        if all {
            self.listed_at = written;
        }
        let record = (if all { &self.roster } else { &listed }).metadata();
        self.with_writer(|writer| writer.write_metadata(&record))
    }

    /// Bytes written to the file; the open chunk counts once closed.
    #[must_use]
    pub fn bytes_written(&self) -> u64 {
        self.written.load(Ordering::Relaxed)
    }

    /// Memory of the index until the file is finished, bytes. It grows with every flush by the channels in it, however little
    /// was written.
    #[must_use]
    pub const fn index_bytes(&self) -> u64 {
        self.indexed * INDEX_ENTRY_BYTES
    }

    /// Number of channels.
    #[must_use]
    pub fn channels(&self) -> usize {
        self.channels.len()
    }

    /// Whether the topic has a channel or can get one.
    #[must_use]
    pub fn has_room_for(&self, topic: &str) -> bool {
        self.channels.len() < MAX_CHANNELS || self.channels.contains_key(topic)
    }

    /// Whether an earlier error closed the file.
    #[must_use]
    pub fn has_failed(&self) -> bool {
        self.writer.is_none()
    }

    /// Whether the file still exists under its name; data written to a removed file would be lost.
    #[must_use]
    pub fn is_linked(&self) -> bool {
        self.file.is_at(&self.part)
    }

    /// Path while the file is open.
    #[must_use]
    pub fn part_path(&self) -> &Path {
        &self.part
    }

    /// Path once the file is complete.
    #[must_use]
    pub fn target_path(&self) -> &Path {
        &self.target
    }

    /// Writes the index, syncs and renames the file, syncs the folder, and returns the final path.
    ///
    /// # Errors
    /// [`WriteError`]; the `.part` file remains, readable at least up to its last flush.
    pub fn finish(mut self) -> Result<PathBuf, WriteError> {
        self.write_columns()?;
        if self.sealed {
            // The open chunk goes into the file first, so that the sum is over everything before the seal.
            self.with_writer(Writer::flush)?;
            let seal = self.sum.lock().unwrap_or_else(PoisonError::into_inner).seal();
            self.with_writer(|writer| writer.write_metadata(&seal))?;
        }
        self.with_writer(|writer| writer.finish().map(|_| ()))?;
        if let Some(writer) = self.writer.take() {
            let buffered = writer.into_inner().inner;
            buffered.into_inner().map_err(|error| self.fail(error.into_error()))?;
        }
        self.file.sync(true).map_err(|cause| self.fail(cause))?;
        self.disk.rename(&self.part, &self.target).map_err(|cause| self.fail(cause))?;
        Ok(self.target.clone())
    }

    fn register(&mut self, topic: &str, kind: Option<Kind>, encoding: &str) -> Result<(), WriteError> {
        if self.channels.len() >= MAX_CHANNELS {
            let (path, topic) = (self.part.clone(), topic.to_owned());
            return Err(WriteError::Full { path, limit: MAX_CHANNELS, topic });
        }
        let schema = match kind.map(|kind| (kind, self.schemas.get(&kind))) {
            None if encoding == columns::ENCODING => self.add_columns_schema()?,
            None if encoding == "json" && topic == log_topic(&self.prefix) => {
                let text = alarm_log::schema().to_string();
                self.with_writer(|w| w.add_schema(LOG_SCHEMA, "jsonschema", text.as_bytes()))?
            }
            // A schema that is not ours is not known: number 0 is none.
            None => 0,
            Some((_, Some(id))) => *id,
            Some((kind, None)) => {
                let text = schemas::json_schema(kind).to_string();
                let id = self.with_writer(|w| w.add_schema(&schemas::name(kind), "jsonschema", text.as_bytes()))?;
                self.schemas.insert(kind, id);
                id
            }
        };
        let id = self.with_writer(|writer| writer.add_channel(schema, topic, encoding, &BTreeMap::new()))?;
        self.channels.insert(topic.to_owned(), Channel { id, sequence: 0, flush: 0 });
        if let Some(listed) = Listed::of(kind, encoding) {
            self.roster.add(id, listed, topic);
            self.unlisted.add(id, listed, topic);
        }
        Ok(())
    }

    /// Makes one call to the writer; an error closes the file for good.
    fn with_writer<T>(
        &mut self,
        call: impl FnOnce(&mut Writer<Inner>) -> Result<T, McapError>,
    ) -> Result<T, WriteError> {
        let Some(writer) = self.writer.as_mut() else { return Err(self.refused()) };
        call(writer).map_err(|cause| {
            self.close();
            WriteError::Mcap { path: self.part.clone(), cause }
        })
    }

    fn fail(&mut self, cause: io::Error) -> WriteError {
        self.close();
        WriteError::Io { path: self.part.clone(), cause }
    }

    fn refused(&self) -> WriteError {
        WriteError::Failed { path: self.part.clone() }
    }

    /// Drops the writer without letting it append an index to a broken file.
    fn close(&mut self) {
        if let Some(writer) = self.writer.take() {
            let (_file, _unwritten) = writer.into_inner().inner.into_parts();
        }
    }
}

/// Makes a file name durable.
///
/// # Errors
/// [`WriteError::Io`] if the folder cannot be opened or synced.
pub fn sync_folder(file: &Path) -> Result<(), WriteError> {
    super::disk::sync_folder_of(file).map_err(|cause| WriteError::Io { path: file.to_owned(), cause })
}

/// Times in MCAP are unsigned.
fn mcap_time(ns: i64) -> u64 {
    u64::try_from(ns).unwrap_or(0)
}

/// Counts and hashes what goes into the file.
struct Counted<W> {
    inner: W,
    written: Arc<AtomicU64>,
    sum: Arc<Mutex<Sum>>,
}

impl<W: Write> Write for Counted<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = self.inner.write(bytes)?;
        self.written.fetch_add(written as u64, Ordering::Relaxed);
        self.sum.lock().unwrap_or_else(PoisonError::into_inner).take(&bytes[..written]);
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.inner.flush()
    }
}

// The writer asks where it is and never goes elsewhere.
impl<W> Seek for Counted<W> {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let here = self.written.load(Ordering::Relaxed);
        let stays = matches!(to, SeekFrom::Current(0)) || to == SeekFrom::Start(here);
        if stays { Ok(here) } else { Err(io::ErrorKind::Unsupported.into()) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn metadata() -> BTreeMap<String, String> {
        BTreeMap::from([("run_id".to_owned(), "r1".to_owned())])
    }

    #[test]
    fn recordings_move_between_threads() {
        fn movable<T: Send>() {}
        movable::<RecordingFile>();
        movable::<super::super::RecordingReader>();
    }

    #[test]
    fn a_file_gets_its_name_when_it_is_whole() {
        let dir = tempfile::tempdir().unwrap();
        let mut file = RecordingFile::create(&dir.path().join("new"), "a", &metadata()).unwrap();
        let before = file.bytes_written();
        file.write("p/l/op", Kind::Sample, i64::MIN, i64::MAX, b"{\"t\":1,\"v\":1}").unwrap();
        file.flush().unwrap();
        assert!(file.bytes_written() > before);
        let (part, target) = (file.part_path().to_owned(), file.target_path().to_owned());
        assert!(part.exists() && !target.exists());
        assert_eq!(fs::metadata(&part).unwrap().len(), file.bytes_written());
        assert_eq!(file.finish().unwrap(), target);
        assert!(!part.exists() && target.exists());
        assert!(RecordingFile::create(&dir.path().join("new"), "a", &metadata()).is_err());
    }

    #[test]
    fn the_index_grows_by_channels_a_flush_not_by_messages() {
        let dir = tempfile::tempdir().unwrap();
        let mut file = RecordingFile::create(dir.path(), "a", &metadata()).unwrap();
        for _ in 0..10 {
            for topic in ["p/a/op", "p/b/op", "p/a/op"] {
                file.write(topic, Kind::Sample, 0, 0, b"1").unwrap();
            }
            file.flush().unwrap();
        }
        assert_eq!(file.index_bytes(), 20 * INDEX_ENTRY_BYTES);
    }

    #[test]
    fn channels_are_bounded_and_the_file_stays_usable() {
        let dir = tempfile::tempdir().unwrap();
        let mut file = RecordingFile::create(dir.path(), "a", &metadata()).unwrap();
        for i in 0..MAX_CHANNELS {
            file.write(&format!("p/{i}/op"), Kind::Sample, 0, 0, b"1").unwrap();
        }
        assert!(!file.has_room_for("p/x/op") && file.has_room_for("p/0/op"));
        assert!(matches!(file.write("p/x/op", Kind::Sample, 0, 0, b"1"), Err(WriteError::Full { .. })));
        file.write("p/0/op", Kind::Sample, 0, 0, b"2").unwrap();
        file.finish().unwrap();
    }

    #[test]
    fn a_failed_file_refuses_everything() {
        let dir = tempfile::tempdir().unwrap();
        let mut file = RecordingFile::create(dir.path(), "a", &metadata()).unwrap();
        file.write("p/l/op", Kind::Sample, 0, 0, b"1").unwrap();
        file.flush().unwrap();
        let length = fs::metadata(file.part_path()).unwrap().len();
        file.fail(io::Error::other("gone"));
        assert!(file.has_failed());
        assert!(matches!(file.write("p/l/op", Kind::Sample, 0, 0, b"1"), Err(WriteError::Failed { .. })));
        assert!(matches!(file.flush(), Err(WriteError::Failed { .. })));
        let part = file.part_path().to_owned();
        assert!(matches!(file.finish(), Err(WriteError::Failed { .. })));
        assert_eq!(fs::metadata(part).unwrap().len(), length, "nothing is appended to a failed file");
    }

    #[test]
    fn a_full_disk_is_an_error() {
        let Ok(full) = fs::File::options().write(true).open("/dev/full") else { return };
        let places = ("/dev/full".into(), "/dev/none".into());
        let started = RecordingFile::start(Arc::new(SystemDisk), Arc::new(full), places, &metadata());
        assert!(matches!(started, Err(WriteError::Mcap { .. })));
    }
}
