//! What the index at a file's end can give back when the data before it is damaged.

use super::mcap_read::MAX_RECORD;
use mcap::parse_record;
use mcap::records::{Record, op};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::Path;

/// Footer record and end mark, bytes: opcode, length, two offsets, checksum, mark.
const FOOTER_BYTES: usize = 1 + 8 + 20 + 8;

/// The records of the index that help.
#[derive(Debug, Default)]
pub(super) struct Index {
    /// Schema and channel records, in file order.
    pub records: Vec<(u8, Vec<u8>)>,
    /// Where chunks begin, ascending.
    pub chunk_starts: Vec<u64>,
}

impl Index {
    /// Reads the index at the end of a file; empty when there is none, as in a file that was cut off.
    pub fn read(path: &Path) -> Self {
        let mut index = Self::default();
        // Whatever stood before an error still helps.
        let _ = index.fill(path);
        index.chunk_starts.sort_unstable();
        index
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
