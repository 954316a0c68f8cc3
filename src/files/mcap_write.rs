//! Writing a recording: one open MCAP file that becomes visible under its name when it is whole.
//!
//! The file grows as `NAME.mcap.part`. [`RecordingFile::flush`] closes the open chunk and hands it to the disk, so a
//! crash loses at most what came since. [`RecordingFile::finish`] writes the index, syncs, renames to `NAME.mcap` and
//! syncs the folder. An MCAP file cannot be reopened: rotate instead.

mod samples;

use super::columns::{self, Columns};
use super::disk::{Disk, DiskFile, Handle, SystemDisk};
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
use stiction_monitor::codec::topic::Kind;
use thiserror::Error;

/// Most channels in one file: every file repeats its channels, and indexes grow with them.
pub const MAX_CHANNELS: usize = 10_000;

/// Uncompressed size at which a chunk is closed, bytes.
const CHUNK_BYTES: u64 = 1 << 20;

/// Bytes after which the list of all channels is written again, so that no place in the file is far from one.
const ROSTER_EVERY: u64 = 8 << 20;

/// What stops a recording.
#[derive(Debug, Error)]
pub enum WriteError {
    /// The folder or file cannot be made, synced or renamed.
    #[error("{}: {source}; check that the folder exists, is writable and has room", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// Writing failed; the file ends with its last flush.
    #[error("{}: {source}; the file is readable up to its last flush, go on in a new one", path.display())]
    Mcap {
        /// The open file.
        path: PathBuf,
        /// What the writer said.
        source: McapError,
    },
    /// An earlier error closed the file.
    #[error("{}: refused, an earlier error has closed this file; go on in a new one", path.display())]
    Failed {
        /// The file.
        path: PathBuf,
    },
    /// The file holds as many channels as it may.
    #[error("{}: {limit} channels are open, no room for {topic:?}; put further loops into another file", path.display())]
    Full {
        /// The file.
        path: PathBuf,
        /// [`MAX_CHANNELS`].
        limit: usize,
        /// The topic that found no room.
        topic: String,
    },
}

/// What the open file's index keeps in memory of one channel in one chunk, bytes.
const INDEX_ENTRY_BYTES: u64 = 40;

/// One channel of the open file.
struct Channel {
    id: u16,
    sequence: u32,
    /// The flush after which it was used last.
    flush: u64,
}

type Inner = Counted<BufWriter<Handle>>;

/// One recording while it is written. Dropping it without [`RecordingFile::finish`] leaves the `.part` file.
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
    /// Every channel, and those that no list in the file names yet.
    roster: Roster,
    unlisted: Roster,
    /// Size of the file when all channels were listed last.
    listed_at: u64,
    dirty: bool,
    /// Flushes so far, and channels that each of them closed a chunk of: what the index grows by.
    flushes: u64,
    indexed: u64,
    /// Whether the file ends with a SHA-256 of what stands before.
    sealed: bool,
    /// Samples that wait for their message, where they are written in columns.
    columns: Option<Columns>,
    /// Room for one sample's JSON.
    json: Vec<u8>,
    /// First chunks of every topic.
    prefix: String,
}

impl RecordingFile {
    /// Opens `dir/stem.mcap.part` and writes the metadata record named [`super::METADATA_NAME`] into it; makes the
    /// folder if it is missing.
    ///
    /// # Errors
    /// [`WriteError::Io`] also when a file of that name exists already, open or whole.
    pub fn create(dir: &Path, stem: &str, metadata: &BTreeMap<String, String>) -> Result<Self, WriteError> {
        Self::create_on(&(Arc::new(SystemDisk) as Arc<dyn Disk>), dir, stem, metadata)
    }

    /// The same on a disk of one's own.
    ///
    /// # Errors
    /// As [`RecordingFile::create`].
    pub fn create_on(
        disk: &Arc<dyn Disk>,
        dir: &Path,
        stem: &str,
        metadata: &BTreeMap<String, String>,
    ) -> Result<Self, WriteError> {
        disk.create_folder(dir).map_err(|source| WriteError::Io { path: dir.to_owned(), source })?;
        let target = dir.join(format!("{stem}.mcap"));
        if target.exists() {
            let source = io::Error::new(io::ErrorKind::AlreadyExists, "this recording exists already");
            return Err(WriteError::Io { path: target, source });
        }
        Ok(Self::begin(disk, dir.join(format!("{stem}.mcap.part")), target, metadata)?.sealed())
    }

    /// The same file, to end with a SHA-256 of all that stands before it.
    #[must_use]
    pub fn sealed(self) -> Self {
        Self { sealed: true, ..self }
    }

    /// Opens `part`, which must not exist; [`RecordingFile::finish`] renames it to `target` and replaces what is there.
    ///
    /// # Errors
    /// [`WriteError`] if the file cannot be made or written.
    pub fn create_at(part: PathBuf, target: PathBuf, metadata: &BTreeMap<String, String>) -> Result<Self, WriteError> {
        Self::begin(&(Arc::new(SystemDisk) as Arc<dyn Disk>), part, target, metadata)
    }

    fn begin(
        disk: &Arc<dyn Disk>,
        part: PathBuf,
        target: PathBuf,
        metadata: &BTreeMap<String, String>,
    ) -> Result<Self, WriteError> {
        let file = disk.create_new(&part).map_err(|source| WriteError::Io { path: part.clone(), source })?;
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
            .library(format!("stictiond {}", crate::VERSION))
            .compression(Some(Compression::Zstd))
            .compression_threads(0)
            .chunk_size(Some(CHUNK_BYTES))
            .disable_seeking(true);
        let writer = options.create(sink).map_err(|source| WriteError::Mcap { path: part.clone(), source })?;
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
    /// Times are ns since 1970; MCAP holds none before that, so earlier ones stand as 0 there (the payload holds them
    /// exactly).
    ///
    /// # Errors
    /// [`WriteError::Full`] leaves the file usable; after any other error it refuses further messages.
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

    /// Appends a message of whatever kind, as it was read from another file.
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

    /// Closes the open chunk and waits until the disk has it; does nothing if nothing came since the last time.
    ///
    /// # Errors
    /// [`WriteError`]; the file then refuses further messages.
    pub fn flush(&mut self) -> Result<(), WriteError> {
        if !self.dirty {
            return if self.writer.is_some() { Ok(()) } else { Err(self.refused()) };
        }
        self.write_columns()?;
        self.list_channels()?;
        self.with_writer(Writer::flush)?;
        self.dirty = false;
        self.flushes += 1;
        self.file.sync(false).map_err(|source| self.fail(source))
    }

    /// Lists new channels outside the chunks, and from time to time all: a chunk holds only those that it is the first to
    /// use, and would take them along if it were damaged.
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

    /// Bytes handed to the file; the open chunk counts once it is closed.
    #[must_use]
    pub fn bytes_written(&self) -> u64 {
        self.written.load(Ordering::Relaxed)
    }

    /// What the index takes of the memory until the file is finished, bytes: it grows with every flush by the channels
    /// in it, however little was written.
    #[must_use]
    pub const fn index_bytes(&self) -> u64 {
        self.indexed * INDEX_ENTRY_BYTES
    }

    /// Channels registered.
    #[must_use]
    pub fn channels(&self) -> usize {
        self.channels.len()
    }

    /// Whether the topic has its channel, or there is room for one.
    #[must_use]
    pub fn has_room_for(&self, topic: &str) -> bool {
        self.channels.len() < MAX_CHANNELS || self.channels.contains_key(topic)
    }

    /// Whether an earlier error has closed the file.
    #[must_use]
    pub fn has_failed(&self) -> bool {
        self.writer.is_none()
    }

    /// Whether the folder still holds the file under its name: a removed one would be filled for nobody.
    #[must_use]
    pub fn is_linked(&self) -> bool {
        self.file.is_at(&self.part)
    }

    /// The file while it is open.
    #[must_use]
    pub fn part_path(&self) -> &Path {
        &self.part
    }

    /// The file's name once it is whole.
    #[must_use]
    pub fn target_path(&self) -> &Path {
        &self.target
    }

    /// Writes the index, syncs the file, gives it its name, syncs the folder, and returns the name.
    ///
    /// # Errors
    /// [`WriteError`]; the `.part` file stays and is readable up to its last flush at least.
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
        self.file.sync(true).map_err(|source| self.fail(source))?;
        self.disk.rename(&self.part, &self.target).map_err(|source| self.fail(source))?;
        sync_folder(&self.target)?;
        Ok(self.target.clone())
    }

    fn register(&mut self, topic: &str, kind: Option<Kind>, encoding: &str) -> Result<(), WriteError> {
        if self.channels.len() >= MAX_CHANNELS {
            let (path, topic) = (self.part.clone(), topic.to_owned());
            return Err(WriteError::Full { path, limit: MAX_CHANNELS, topic });
        }
        let schema = match kind.map(|kind| (kind, self.schemas.get(&kind))) {
            None if encoding == columns::ENCODING => self.add_columns_schema()?,
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

    /// Runs one call on the writer; an error closes the file for good.
    fn with_writer<T>(
        &mut self,
        call: impl FnOnce(&mut Writer<Inner>) -> Result<T, McapError>,
    ) -> Result<T, WriteError> {
        let Some(writer) = self.writer.as_mut() else { return Err(self.refused()) };
        call(writer).map_err(|source| {
            self.close();
            WriteError::Mcap { path: self.part.clone(), source }
        })
    }

    fn fail(&mut self, source: io::Error) -> WriteError {
        self.close();
        WriteError::Io { path: self.part.clone(), source }
    }

    fn refused(&self) -> WriteError {
        WriteError::Failed { path: self.part.clone() }
    }

    /// Takes the writer away without letting it append an index to a broken file.
    fn close(&mut self) {
        if let Some(writer) = self.writer.take() {
            let (_file, _unwritten) = writer.into_inner().inner.into_parts();
        }
    }
}

/// Makes a file's name durable.
///
/// # Errors
/// [`WriteError::Io`] if the folder cannot be opened or synced.
pub fn sync_folder(file: &Path) -> Result<(), WriteError> {
    super::disk::sync_folder_of(file).map_err(|source| WriteError::Io { path: file.to_owned(), source })
}

/// MCAP's times are unsigned.
fn mcap_time(ns: i64) -> u64 {
    u64::try_from(ns).unwrap_or(0)
}

/// Counts and sums up what goes into the file.
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
