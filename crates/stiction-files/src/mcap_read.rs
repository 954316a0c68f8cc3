//! Reads a recording of any size from start to end, complete or not.
//!
//! Messages come in file order. A truncated file (or one still open) gives every message up to its end; a damaged chunk is
//! skipped and later chunks are still read. How the file ended is known after the last message:
//! [`RecordingReader::end`]. Memory holds one chunk, at most [`MAX_RECORD`] bytes, whatever the file claims.

mod unpack;

use super::mcap_index::{Index, MAX_RECORD};
use super::mcap_roster::{self, Roster};
use super::schemas;
use super::seal::{self, Seal};
use mcap::records::{Record, op};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use mcap::{McapError, parse_record};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use stiction_engine::codec::topic::Kind;
use thiserror::Error;
use unpack::Unpacked;
pub use unpack::{Item, RawSample};

/// Most bytes per read.
const READ_BYTES: usize = 1 << 20;

/// Bytes of a chunk's index before its entries, and of an entry.
const INDEX_HEAD: usize = 6;
const INDEX_ENTRY: usize = 16;
/// Messages outside chunks further from the others in time are none, ns.
const YEAR_NS: u64 = 366 * 86_400 * 1_000_000_000;

/// An error before the first message.
#[derive(Debug, Error)]
pub enum ReadError {
    /// The file cannot be opened or read.
    #[error("{}: {cause}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// Error of the system.
        cause: io::Error,
    },
    /// None of its messages can be read.
    #[error("{}: none of the samples can be read; the first: {first}", path.display())]
    Nothing {
        /// The file.
        path: PathBuf,
        /// Topic and fault of the first.
        first: String,
    },
    /// The file does not begin as MCAP files do.
    #[error("{}: not an MCAP file (its first bytes are not the MCAP mark)", path.display())]
    NotMcap {
        /// The file.
        path: PathBuf,
    },
}

/// How a file ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum End {
    /// Complete, all checksums correct.
    Clean,
    /// Truncated: no end mark. Everything before was read.
    Cut {
        /// Where, and what is missing.
        reason: String,
    },
    /// Complete in length, but damaged parts were skipped.
    Damaged {
        /// Where, and what is wrong.
        reason: String,
    },
}

impl End {
    /// Whether nothing is missing.
    #[must_use]
    pub fn is_clean(&self) -> bool {
        matches!(self, Self::Clean)
    }

    /// `clean`, `cut` or `damaged`.
    #[must_use]
    pub fn word(&self) -> &'static str {
        match self {
            Self::Clean => "clean",
            Self::Cut { .. } => "cut",
            Self::Damaged { .. } => "damaged",
        }
    }

    /// What is wrong, if anything.
    #[must_use]
    pub fn reason(&self) -> Option<&str> {
        match self {
            Self::Clean => None,
            Self::Cut { reason } | Self::Damaged { reason } => Some(reason),
        }
    }
}

/// Description of a channel.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Channel {
    /// The topic.
    pub topic: String,
    /// Kind of its messages, if their schema is one of this program.
    pub kind: Option<Kind>,
    /// Encoding of its messages, `json` in the program's own files; that of their schema if they name none.
    pub encoding: String,
}

/// One message.
#[derive(Debug, Clone, Copy)]
pub struct Message<'a> {
    /// Channel number in this file; stable, so it can serve as an index.
    pub channel_id: u16,
    /// Description of its channel.
    pub channel: &'a Channel,
    /// Sequence number in its channel.
    pub sequence: u32,
    /// Arrival time, ns since 1970.
    pub log_time_ns: i64,
    /// Source time, ns since 1970 (0 for anything earlier).
    pub publish_time_ns: i64,
    /// The payload.
    pub data: &'a [u8],
}

impl<'a> Message<'a> {
    /// Topic of the channel.
    #[must_use]
    pub fn topic(&self) -> &'a str {
        &self.channel.topic
    }
}

/// A message of the current chunk; its payload is in the common buffer.
struct Entry {
    /// `None` if the channel's record has not been read.
    channel: Option<Arc<Channel>>,
    channel_id: u16,
    sequence: u32,
    log_time: u64,
    publish_time: u64,
    start: usize,
    end: usize,
}

/// Sums over the records of a file.
#[derive(Default)]
struct Contents {
    /// Names and encodings of schemas.
    schemas: BTreeMap<u16, (String, String)>,
    channels: BTreeMap<u16, Arc<Channel>>,
    metadata: BTreeMap<String, String>,
    library: String,
    seal: Option<Seal>,
    entries: Vec<Entry>,
    buffer: Vec<u8>,
    unresolved: u64,
    orphans: u64,
    messages: u64,
    /// Arrival time of the last message, ns.
    last_time: u64,
    stated: Option<u64>,
}

/// Reads one recording.
pub struct RecordingReader {
    path: PathBuf,
    file: File,
    linear: LinearReader,
    offset: u64,
    last_chunk: u64,
    file_bytes: u64,
    contents: Contents,
    next: usize,
    /// The current message of samples.
    unpacked: Unpacked,
    saw_data_end: bool,
    damage: Vec<String>,
    damaged_chunks: u64,
    index: Option<Index>,
    end: Option<End>,
}

fn outer_options() -> LinearReaderOptions {
    LinearReaderOptions::default()
        .with_emit_chunks(true)
        .with_check_finishes_after_end_magic(true)
        .with_validate_summary_section_crc(true)
        .with_record_length_limit(MAX_RECORD)
}

/// Whether a file begins as MCAP. One or two flipped bits make it damaged, not foreign.
pub(super) fn begins_as_recording(head: &[u8]) -> bool {
    let differing = |head: &[u8]| head.iter().zip(mcap::MAGIC).filter(|(a, b)| a != b).count();
    head.get(..mcap::MAGIC.len()).is_some_and(|head| differing(head) <= 1)
}

impl RecordingReader {
    /// Opens a file and reads up to its first message, so that [`RecordingReader::metadata`] is known.
    ///
    /// # Errors
    /// [`ReadError`] if the file cannot be read or is not MCAP.
    pub fn open(path: &Path) -> Result<Self, ReadError> {
        let failed = |cause| ReadError::Io { path: path.to_owned(), cause };
        let mut file = File::open(path).map_err(failed)?;
        let file_bytes = file.metadata().map_err(failed)?.len();
        let mut magic = [0_u8; 8];
        if file.read_exact(&mut magic).is_err() || !begins_as_recording(&magic) {
            return Err(ReadError::NotMcap { path: path.to_owned() });
        }
        let whole = magic == *mcap::MAGIC;
        if whole {
            file.rewind().map_err(failed)?;
        }
        let options = outer_options().with_skip_start_magic(!whole).with_validate_data_section_crc(whole);
        let mut reader = Self {
            path: path.to_owned(),
            file,
            linear: LinearReader::new_with_options(options),
            offset: 8,
            last_chunk: 0,
            file_bytes,
            contents: Contents::default(),
            next: 0,
            unpacked: Unpacked::default(),
            saw_data_end: false,
            damage: Vec::new(),
            damaged_chunks: 0,
            index: None,
            end: None,
        };
        if !whole {
            reader.note("the first bytes are damaged".to_owned());
        }
        reader.fill()?;
        Ok(reader)
    }

    /// The metadata record named [`super::METADATA_NAME`] as far as read; the recorder writes it first.
    #[must_use]
    pub fn metadata(&self) -> &BTreeMap<String, String> {
        &self.contents.metadata
    }

    /// The program that wrote the file, as the file states it.
    #[must_use]
    pub fn library(&self) -> &str {
        &self.contents.library
    }

    /// The SHA-256 from the file's end, once read.
    #[must_use]
    pub fn seal(&self) -> Option<&Seal> {
        self.contents.seal.as_ref()
    }

    /// Size of the file when opened, bytes.
    #[must_use]
    pub fn file_bytes(&self) -> u64 {
        self.file_bytes
    }

    /// The file.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// How the file ended; `None` while messages remain.
    #[must_use]
    pub fn end(&self) -> Option<&End> {
        self.end.as_ref()
    }

    /// Reads records until there is a message or the file ends.
    fn fill(&mut self) -> Result<(), ReadError> {
        self.contents.entries.clear();
        self.contents.buffer.clear();
        self.next = 0;
        while self.contents.entries.is_empty() && self.end.is_none() {
            self.step()?;
            if self.contents.unresolved > 0 {
                self.resolve();
            }
        }
        Ok(())
    }

    /// Finds the channels of messages whose channel record was lost; messages without a channel are skipped.
    fn resolve(&mut self) {
        self.use_index(0);
        let Contents { entries, channels, orphans, unresolved, .. } = &mut self.contents;
        entries.retain_mut(|entry| {
            if entry.channel.is_none() {
                entry.channel = channels.get(&entry.channel_id).cloned();
            }
            *orphans += u64::from(entry.channel.is_none());
            entry.channel.is_some()
        });
        *unresolved = 0;
    }

    /// Reads one record, or one piece of the file.
    fn step(&mut self) -> Result<(), ReadError> {
        let wanted = match self.linear.next_event() {
            None => {
                self.finish(None);
                return Ok(());
            }
            Some(Err(error)) => return self.resume_after(&error),
            Some(Ok(LinearReadEvent::ReadRequest(wanted))) => wanted,
            Some(Ok(LinearReadEvent::Record { opcode, data })) => {
                let start = self.offset;
                self.offset += 9 + data.len() as u64;
                self.saw_data_end |= opcode == op::DATA_END;
                if opcode == op::CHUNK {
                    self.last_chunk = start;
                }
                let outcome = match opcode {
                    op::CHUNK => self.contents.take_chunk(data),
                    // A bit makes an index of a chunk into a message, but not of a channel that is known.
                    op::MESSAGE if self.last_chunk > 0 && !self.contents.is_of_known_channel(data) => {
                        self.note(format!("record at byte {start}: message outside a chunk"));
                        Ok(())
                    }
                    // After the data come copies and indexes; only the count of messages is of use.
                    _ if self.saw_data_end && opcode != op::STATISTICS => Ok(()),
                    _ => self.contents.take_record(opcode, data),
                };
                if let Err(error) = outcome {
                    self.damaged_chunks += u64::from(opcode == op::CHUNK);
                    let what = if opcode == op::CHUNK { "chunk" } else { "record" };
                    self.note(format!("{what} at byte {start}: {}", describe(&error)));
                    return self.reread_swallowed();
                }
                return Ok(());
            }
        };
        let room = self.linear.insert(wanted.min(READ_BYTES));
        let read = loop {
            match self.file.read(room) {
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                other => break other.map_err(|cause| ReadError::Io { path: self.path.clone(), cause })?,
            }
        };
        self.linear.notify_read(read);
        Ok(())
    }

    /// Continues at the next chunk in the index, or ends. Data between two chunks are of no use, and a wrong length there may
    /// have hidden whole chunks, so the position is taken from the last chunk read.
    fn resume_after(&mut self, error: &McapError) -> Result<(), ReadError> {
        // Also after what reads as the end of the data or of the file: a bit makes an index of a chunk into one.
        let last = self.last_chunk;
        let next = self.use_index(last).chunk_after(last);
        let Some(next) = next else {
            self.finish(Some(error));
            return Ok(());
        };
        self.note(format!("before byte {next}: {}", describe(error)));
        self.go_to(next)
    }

    /// After a damaged record, whose wrong length may have covered the next chunks.
    fn reread_swallowed(&mut self) -> Result<(), ReadError> {
        let (last, offset) = (self.last_chunk, self.offset);
        match self.use_index(last).chunk_after(last) {
            Some(next) if next < offset => self.go_to(next),
            _ => Ok(()),
        }
    }

    fn go_to(&mut self, offset: u64) -> Result<(), ReadError> {
        let sought = self.file.seek(SeekFrom::Start(offset));
        sought.map_err(|cause| ReadError::Io { path: self.path.clone(), cause })?;
        self.linear = LinearReader::new_with_options(outer_options().with_skip_start_magic(true));
        self.offset = offset;
        self.saw_data_end = false;
        // Whatever stands there, the next attempt is a later one.
        self.last_chunk = offset;
        Ok(())
    }

    /// Reads the index once, or searches the file from a position. Channels found replace those of a damaged chunk.
    fn use_index(&mut self, from: u64) -> &Index {
        let (path, contents) = (&self.path, &mut self.contents);
        let known = self.index.take().filter(|index| index.covers(from));
        self.index.insert(known.unwrap_or_else(|| {
            let index = Index::read(path, from);
            for (opcode, data) in &index.records {
                // A copy that cannot be read helps nobody and harms nothing.
                let _ = contents.take_record(*opcode, data);
            }
            index.rosters.iter().for_each(|roster| contents.take_roster(roster));
            index
        }))
    }

    fn note(&mut self, damage: String) {
        if self.damage.len() < 3 {
            self.damage.push(damage);
        }
    }

    /// Determines how the file ended.
    fn finish(&mut self, error: Option<&McapError>) {
        let (offset, size) = (self.offset, self.file_bytes);
        let lost = self.contents.stated.map_or(0, |stated| stated.saturating_sub(self.contents.messages));
        let mut reasons = std::mem::take(&mut self.damage);
        if self.damaged_chunks > 0 {
            reasons.insert(
                0,
                match self.damaged_chunks {
                    1 => "skipped 1 damaged chunk".to_owned(),
                    n => format!("skipped {n} damaged chunks"),
                },
            );
        }
        if self.contents.orphans > 0 {
            reasons.push(format!("skipped {} messages of unknown channels", self.contents.orphans));
        }
        self.end = Some(match error {
            Some(McapError::UnexpectedEof) => {
                let place = if self.saw_data_end { "in the index after the last message" } else { "in the data" };
                reasons.insert(0, format!("it ends without an end mark, {place}, after byte {offset} of {size}"));
                End::Cut { reason: reasons.join("; ") }
            }
            Some(error) => {
                let text = format!("after byte {offset} of {size}: {}", describe(error));
                reasons.push(text);
                let reason = reasons.join("; ");
                let whole = self.saw_data_end || matches!(error, McapError::BadDataCrc { .. });
                if whole { End::Damaged { reason } } else { End::Cut { reason } }
            }
            None if lost > 0 || !reasons.is_empty() => {
                if lost > 0 {
                    reasons.push(format!("{lost} messages fewer than the file's count"));
                }
                End::Damaged { reason: reasons.join("; ") }
            }
            None => End::Clean,
        });
    }
}

impl Contents {
    /// Whether a message's channel has been described, and it is no index of a chunk, in which the length of the entries has the
    /// place of a sequence number, nor another record, which has no time of a message.
    fn is_of_known_channel(&self, data: &[u8]) -> bool {
        let Ok(Record::Message { header, .. }) = parse_record(op::MESSAGE, data) else { return false };
        let entries = data.len().saturating_sub(INDEX_HEAD);
        let is_index = header.sequence as usize == entries && entries.is_multiple_of(INDEX_ENTRY);
        let later = self.last_time.max(header.log_time);
        let is_near = later - self.last_time.min(header.log_time) < YEAR_NS;
        self.channels.contains_key(&header.channel_id) && is_near && !is_index
    }

    /// Takes the records of a chunk, or none if its checksum is wrong.
    fn take_chunk(&mut self, chunk: &[u8]) -> Result<(), McapError> {
        let options = LinearReaderOptions::default()
            .with_skip_start_magic(true)
            .with_skip_end_magic(true)
            .with_prevalidate_chunk_crcs(true)
            .with_record_length_limit(MAX_RECORD);
        let mut linear = LinearReader::new_with_options(options);
        let mut head = [op::CHUNK; 9];
        head[1..].copy_from_slice(&(chunk.len() as u64).to_le_bytes());
        let mut source = head.as_slice().chain(chunk);
        let mut first_error = None;
        loop {
            let outcome = match linear.next_event() {
                None => break,
                Some(Err(error)) => {
                    first_error.get_or_insert(error);
                    break;
                }
                Some(Ok(LinearReadEvent::ReadRequest(wanted))) => {
                    let read = source.read(linear.insert(wanted.min(READ_BYTES)))?;
                    linear.notify_read(read);
                    continue;
                }
                Some(Ok(LinearReadEvent::Record { opcode, data })) => self.take_record(opcode, data),
            };
            if let Err(error) = outcome {
                first_error.get_or_insert(error);
            }
        }
        first_error.map_or(Ok(()), Err)
    }

    /// Channels whose records may have been in a damaged chunk.
    fn take_roster(&mut self, roster: &Roster) {
        for (id, holds, topic) in roster.channels() {
            let (kind, encoding) = holds.parts();
            let channel = || Channel { topic: topic.to_owned(), kind, encoding: encoding.to_owned() };
            self.channels.entry(id).or_insert_with(|| Arc::new(channel()));
        }
    }

    fn take_record(&mut self, opcode: u8, data: &[u8]) -> Result<(), McapError> {
        // Indexes and records that others invented are none of ours; parsing them would only cost.
        let ours = [op::HEADER, op::SCHEMA, op::CHANNEL, op::MESSAGE, op::METADATA, op::STATISTICS];
        if !ours.contains(&opcode) {
            return Ok(());
        }
        match parse_record(opcode, data)? {
            Record::Header(header) => self.library = header.library,
            Record::Schema { header, .. } => {
                self.schemas.insert(header.id, (header.name, header.encoding));
            }
            Record::Channel(channel) => {
                let schema = self.schemas.get(&channel.schema_id);
                let kind = schema.and_then(|(name, _)| schemas::kind_of(name));
                // Where the messages' encoding is left out, that of their schema names it.
                let encoding = match (channel.message_encoding, schema) {
                    (empty, Some((_, of_schema))) if empty.is_empty() => of_schema.clone(),
                    (named, _) => named,
                };
                let encoding = if encoding == "jsonschema" { "json".to_owned() } else { encoding };
                let known = Channel { topic: channel.topic, kind, encoding };
                match self.channels.get(&channel.id) {
                    // Its schema may have stood in a damaged chunk.
                    Some(old) if known.kind.is_none() && old.topic == known.topic => {}
                    Some(old) if **old != known => return Err(McapError::ConflictingChannels(known.topic)),
                    Some(_) => {}
                    None => {
                        self.channels.insert(channel.id, Arc::new(known));
                    }
                }
            }
            Record::Message { header, data } => {
                self.messages += 1;
                self.last_time = header.log_time;
                let channel = self.channels.get(&header.channel_id).cloned();
                self.unresolved += u64::from(channel.is_none());
                let start = self.buffer.len();
                self.buffer.extend_from_slice(&data);
                self.entries.push(Entry {
                    channel,
                    channel_id: header.channel_id,
                    sequence: header.sequence,
                    log_time: header.log_time,
                    publish_time: header.publish_time,
                    start,
                    end: self.buffer.len(),
                });
            }
            Record::Metadata(metadata) if metadata.name == super::METADATA_NAME => {
                self.metadata.extend(metadata.metadata);
            }
            Record::Metadata(metadata) if metadata.name == seal::NAME => self.seal = Seal::of(&metadata.metadata),
            Record::Metadata(metadata) if metadata.name == mcap_roster::NAME => {
                Roster::of(&metadata.metadata).iter().for_each(|roster| self.take_roster(roster));
            }
            Record::Statistics(statistics) => self.stated = Some(statistics.message_count),
            _ => {}
        }
        Ok(())
    }
}

fn signed(time: u64) -> i64 {
    i64::try_from(time).unwrap_or(i64::MAX)
}

/// An error with its cause in one line. The parser's errors carry a backtrace, with the cause behind `Error:`.
fn describe(error: &McapError) -> String {
    use std::error::Error as _;
    let text = match error.source() {
        Some(cause) => format!("{error}: {cause}"),
        None => error.to_string(),
    };
    let plain = without_colours(&text);
    let plain = match plain.split_once("Backtrace").map(|(before, trace)| (before, trace.rsplit_once("Error: "))) {
        Some((_, Some((_, cause)))) => format!("record parse failed: {}", cause.lines().next().unwrap_or_default()),
        Some((before, None)) => before.to_owned(),
        None => plain,
    };
    let kept: String = plain.chars().filter(|c| !('\u{2500}'..='\u{257f}').contains(c)).collect();
    kept.split_whitespace().collect::<Vec<_>>().join(" ").chars().take(200).collect()
}

/// A text without the sequences that colour it in a terminal.
fn without_colours(text: &str) -> String {
    let mut parts = text.split('\u{1b}');
    let first = parts.next().unwrap_or_default().to_owned();
    parts.fold(first, |all, part| all + part.split_once('m').map_or("", |(_, rest)| rest))
}
