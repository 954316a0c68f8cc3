//! Recovery of a damaged file: by the index at its end, or without one by searching for the marks of chunks and channel
//! lists.

use super::mcap_roster::{self, Roster};
use mcap::parse_record;
use mcap::records::{Record, op};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::Path;

/// Largest record and largest uncompressed chunk accepted, bytes.
pub const MAX_RECORD: usize = 256 << 20;

/// Footer record and end mark, bytes: opcode, length, two offsets, checksum, mark.
const FOOTER_BYTES: usize = 1 + 8 + 20 + 8;

/// Bytes per search step.
const SEARCH_BYTES: u64 = 1 << 20;
/// Bytes needed to recognise a mark.
const OVERLAP: usize = 64;
/// Bytes of a chunk record before the name of its compression: opcode, length, two times, size, checksum.
const BEFORE_COMPRESSION: usize = 9 + 8 + 8 + 8 + 4;
/// Largest channel list accepted, bytes.
const MAX_ROSTER: u64 = 16 << 20;

fn u64_at(bytes: &[u8], at: usize) -> u64 {
    let mut number = [0_u8; 8];
    if let Some(found) = bytes.get(at..at + 8) {
        number.copy_from_slice(found);
    }
    u64::from_le_bytes(number)
}

/// Whether these bytes begin like a chunk of this program that ends within the file.
fn is_chunk(bytes: &[u8], left: u64) -> bool {
    const MARK: &[u8] = b"\x04\0\0\0zstd";
    let (length, after) = (u64_at(bytes, 1), BEFORE_COMPRESSION + MARK.len());
    let records = u64_at(bytes, after);
    bytes.get(BEFORE_COMPRESSION..after) == Some(MARK)
        && records.checked_add((after + 8 - 9) as u64) == Some(length)
        && length.checked_add(9).is_some_and(|all| all <= left)
}

fn is_roster(bytes: &[u8]) -> bool {
    let name = mcap_roster::NAME.as_bytes();
    let length = (name.len() as u32).to_le_bytes();
    u64_at(bytes, 1) <= MAX_ROSTER && bytes.get(9..13) == Some(&length) && bytes.get(13..13 + name.len()) == Some(name)
}

/// Reads the channel list whose content begins at an offset.
fn roster_at(file: &mut File, at: u64, length: u64) -> io::Result<Option<Roster>> {
    file.seek(SeekFrom::Start(at))?;
    let mut data = Vec::new();
    file.take(length.min(MAX_ROSTER)).read_to_end(&mut data)?;
    match parse_record(op::METADATA, &data) {
        Ok(Record::Metadata(metadata)) => Ok(Roster::of(&metadata.metadata)),
        _ => Ok(None),
    }
}

/// The useful records of the index.
#[derive(Debug, Default)]
pub(super) struct Index {
    /// Schema and channel records in file order.
    pub records: Vec<(u8, Vec<u8>)>,
    /// Start offsets of chunks, ascending.
    pub chunk_starts: Vec<u64>,
    /// Channel lists between chunks.
    pub rosters: Vec<Roster>,
    /// Without an index: the offset from which the file was searched.
    searched_from: Option<u64>,
}

impl Index {
    /// Reads the index at the end of a file. If there is none, as in a truncated file, searches the file from an offset.
    pub fn read(path: &Path, from: u64) -> Self {
        let mut index = Self::default();
        // Whatever stood before an error still helps.
        let _ = index.fill(path);
        if index.chunk_starts.is_empty() {
            index.searched_from = Some(from);
            let _ = index.search(path, from);
        }
        index.chunk_starts.sort_unstable();
        index
    }

    /// Whether it covers everything after this offset.
    pub fn covers(&self, from: u64) -> bool {
        self.searched_from.is_none_or(|searched| searched <= from)
    }

    /// Searches for the marks of chunks and channel lists. Candidates are checked by their lengths, and chunks by their checksum
    /// when read.
    fn search(&mut self, path: &Path, from: u64) -> io::Result<()> {
        let mut file = File::open(path)?;
        let size = file.metadata()?.len();
        file.seek(SeekFrom::Start(from))?;
        let (mut window, mut start) = (Vec::new(), from);
        loop {
            let before = window.len();
            (&mut file).take(SEARCH_BYTES).read_to_end(&mut window)?;
            let ended = window.len() == before;
            // A mark near the end is looked at again with what follows it.
            let last = if ended { window.len() } else { window.len().saturating_sub(OVERLAP) };
            for at in 0..last {
                match window[at] {
                    op::CHUNK if is_chunk(&window[at..], size.saturating_sub(start + at as u64)) => {
                        self.chunk_starts.push(start + at as u64);
                    }
                    op::METADATA if is_roster(&window[at..]) => {
                        let length = u64_at(&window[at..], 1);
                        self.rosters.extend(roster_at(&mut file, start + at as u64 + 9, length)?);
                    }
                    _ => {}
                }
            }
            if ended {
                return Ok(());
            }
            window.drain(..last);
            start += last as u64;
            file.seek(SeekFrom::Start(start + window.len() as u64))?;
        }
    }

    /// The first chunk that begins after `offset`.
    pub fn chunk_after(&self, offset: u64) -> Option<u64> {
        let at = self.chunk_starts.partition_point(|start| *start <= offset);
        self.chunk_starts.get(at).copied()
    }

    fn fill(&mut self, path: &Path) -> io::Result<()> {
        let mut file = File::open(path)?;
        let size = file.metadata()?.len();
        if size < (8 + FOOTER_BYTES) as u64 {
            return Ok(());
        }
        file.seek(SeekFrom::Start(size - FOOTER_BYTES as u64))?;
        let mut footer = [0_u8; FOOTER_BYTES];
        file.read_exact(&mut footer)?;
        let mut start = [0_u8; 8];
        start.copy_from_slice(&footer[9..17]);
        let start = u64::from_le_bytes(start);
        if footer[0] != op::FOOTER || footer[FOOTER_BYTES - 8..] != *mcap::MAGIC || start == 0 || start >= size {
            return Ok(());
        }
        file.seek(SeekFrom::Start(start))?;
        let outcome = self.take_records(&mut file.take(size - start));
        self.chunk_starts.retain(|chunk| *chunk < start);
        outcome
    }

    fn take_records(&mut self, source: &mut impl Read) -> io::Result<()> {
        let options = LinearReaderOptions::default()
            .with_skip_start_magic(true)
            .with_skip_end_magic(true)
            .with_emit_chunks(true)
            .with_record_length_limit(MAX_RECORD);
        let mut linear = LinearReader::new_with_options(options);
        while let Some(Ok(event)) = linear.next_event() {
            match event {
                LinearReadEvent::ReadRequest(wanted) => {
                    let read = source.read(linear.insert(wanted.min(1 << 16)))?;
                    linear.notify_read(read);
                }
                LinearReadEvent::Record { opcode: op::CHUNK_INDEX, data } => {
                    if let Ok(Record::ChunkIndex(chunk)) = parse_record(op::CHUNK_INDEX, data) {
                        self.chunk_starts.push(chunk.chunk_start_offset);
                    }
                }
                LinearReadEvent::Record { opcode: opcode @ (op::SCHEMA | op::CHANNEL), data } => {
                    self.records.push((opcode, data.to_vec()));
                }
                LinearReadEvent::Record { .. } => {}
            }
        }
        Ok(())
    }
}
