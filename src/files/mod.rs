//! Files: recordings (MCAP) and tables (CSV). What a file is, its content says, not its name.

pub mod csv;
mod mcap_index;
mod mcap_read;
mod mcap_write;
pub mod schemas;
pub mod topic;

pub use mcap_read::{Channel, End, MAX_RECORD, Message, ReadError, RecordingReader};
pub use mcap_write::{MAX_CHANNELS, RecordingFile, WriteError, sync_folder};

use crate::codec;
use crate::record::{Sample, Signal, Value};
use crate::units::loop_name_from;
use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};
use thiserror::Error;
use topic::{Leaf, Topic};

/// Name of the metadata record that our recordings carry.
pub const METADATA_NAME: &str = "stictiond";

/// Metadata key of the prefix that every topic of the recording begins with.
pub const METADATA_PREFIX: &str = "prefix";

/// What a file is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum InputKind {
    /// A recording.
    Mcap,
    /// A table `t,op,pv…`.
    Csv,
}

impl InputKind {
    /// `mcap` or `csv`.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Mcap => "mcap",
            Self::Csv => "csv",
        }
    }

    /// Reads a file's first bytes and tells what it is.
    ///
    /// # Errors
    /// [`FileError`] names what the file seems to be, and what to do with it.
    pub fn detect(path: &Path) -> Result<Self, FileError> {
        let failed = |source| FileError::Io { path: path.to_owned(), source };
        if path.is_dir() {
            return Err(failed(io::Error::new(io::ErrorKind::IsADirectory, "this is a folder, give a file")));
        }
        let mut head = Vec::with_capacity(4096);
        File::open(path).map_err(failed)?.take(4096).read_to_end(&mut head).map_err(failed)?;
        Self::of_content(&head).map_err(|what| FileError::Kind { path: path.to_owned(), what })
    }

    /// What begins like this; otherwise, what it seems to be and the remedy.
    fn of_content(head: &[u8]) -> Result<Self, &'static str> {
        let unsupported: [(&[u8], &str); 6] = [
            (b"MATLAB 5.0", "a MATLAB file, which is not supported yet; export t,op,pv as .csv, then convert that"),
            (b"MATLAB 7.3", "a MATLAB file, which is not supported yet; export t,op,pv as .csv, then convert that"),
            (b"\x89HDF", "an HDF5 or MATLAB 7.3 file, which is not supported; export t,op,pv as .csv"),
            (b"PK\x03\x04", "a workbook or zip archive; save the sheet as .csv, or unpack it"),
            (b"\x1f\x8b", "compressed by gzip; unpack it"),
            (b"\xff\xfe", "UTF-16 text; save it as UTF-8"),
        ];
        if head.starts_with(mcap::MAGIC) {
            return Ok(Self::Mcap);
        }
        if let Some((_, what)) = unsupported.iter().find(|(mark, _)| head.starts_with(mark)) {
            return Err(what);
        }
        if head.iter().all(u8::is_ascii_whitespace) {
            return Err("empty; expected a recording (.mcap) or a table with the header t,op,pv");
        }
        if head.contains(&0) {
            return Err("neither a recording (.mcap) nor text; expected one of these");
        }
        Ok(Self::Csv)
    }
}

/// A file that cannot be read as a whole.
#[derive(Debug, Error)]
pub enum FileError {
    /// The system refuses it.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// Not a kind that is read.
    #[error("{}: the file is {what}", path.display())]
    Kind {
        /// The file.
        path: PathBuf,
        /// What it seems to be, and the remedy.
        what: &'static str,
    },
    /// A recording that cannot be read.
    #[error(transparent)]
    Recording(#[from] ReadError),
    /// A table that cannot be read.
    #[error("{}: {source}", path.display())]
    Csv {
        /// The file.
        path: PathBuf,
        /// Line and remedy.
        source: csv::CsvError,
    },
}

/// One loop of a file.
#[derive(Debug, Clone, PartialEq)]
pub struct LoadedLoop {
    /// Its name.
    pub name: String,
    /// Its samples in recorded order.
    pub samples: Vec<Sample>,
}

impl LoadedLoop {
    /// Samples of a signal, and how many of them are missing values.
    #[must_use]
    pub fn count(&self, signal: Signal) -> (usize, usize) {
        let of_signal = self.samples.iter().filter(|s| s.signal == signal);
        of_signal.fold((0, 0), |(all, missing), s| (all + 1, missing + usize::from(s.value == Value::Missing)))
    }
}

/// The raw data of a file.
#[derive(Debug, Clone, PartialEq)]
pub struct Loaded {
    /// What the file is.
    pub kind: InputKind,
    /// Its loops, in the order in which they first appear.
    pub loops: Vec<LoadedLoop>,
    /// What a person should know, one line each.
    pub warnings: Vec<String>,
    /// Whether the file is cut off or damaged: `loops` hold what could be read.
    pub data_loss: bool,
    /// The recording's metadata; empty for tables.
    pub metadata: BTreeMap<String, String>,
}

/// Reads the raw data of a table or recording. Cut-off and damaged recordings give what can be read, with
/// [`Loaded::data_loss`] set.
///
/// # Errors
/// [`FileError`] if the file is of no known kind, a table is malformed, or the system refuses.
pub fn load_samples(path: &Path) -> Result<Loaded, FileError> {
    match InputKind::detect(path)? {
        InputKind::Mcap => load_recording(path),
        InputKind::Csv => {
            let table = csv::read(path)?;
            let name = path.file_stem().map_or_else(|| "loop".into(), |stem| loop_name_from(&stem.to_string_lossy()));
            Ok(Loaded {
                kind: InputKind::Csv,
                loops: vec![LoadedLoop { name, samples: table.samples }],
                warnings: table.warnings,
                data_loss: false,
                metadata: BTreeMap::new(),
            })
        }
    }
}

fn load_recording(path: &Path) -> Result<Loaded, FileError> {
    let mut reader = RecordingReader::open(path)?;
    let prefix = reader.metadata().get(METADATA_PREFIX).cloned();
    let mut loops = LoopTable::default();
    let mut scratch = Vec::new();
    let (mut unreadable, mut first_fault) = (0_u64, String::new());
    while let Some(message) = reader.next_message()? {
        let Some((at, signal)) = loops.place(prefix.as_deref(), &message) else { continue };
        scratch.clear();
        let own_time = if message.publish_time_ns == 0 { message.log_time_ns } else { message.publish_time_ns };
        match codec::decode(signal, message.data, Some(&message.channel.encoding), None, own_time, &mut scratch) {
            Ok(_) => loops.loops[at].samples.extend_from_slice(&scratch),
            Err(error) => {
                unreadable += 1;
                if first_fault.is_empty() {
                    first_fault = format!("{}: {error}", message.topic());
                }
            }
        }
    }
    let mut warnings = Vec::new();
    if unreadable > 0 {
        warnings.push(format!("{unreadable} messages could not be read and were left out, the first: {first_fault}"));
    }
    let end = reader.end().cloned().unwrap_or(End::Clean);
    if let Some(reason) = end.reason() {
        warnings.push(format!("the recording is {}: {reason}", end.word()));
    }
    Ok(Loaded {
        kind: InputKind::Mcap,
        loops: loops.loops,
        warnings,
        data_loss: !end.is_clean(),
        metadata: reader.metadata().clone(),
    })
}

/// Which loop and signal a channel feeds; each topic is parsed once.
#[derive(Default)]
struct LoopTable {
    loops: Vec<LoadedLoop>,
    by_name: HashMap<String, usize>,
    by_channel: HashMap<u16, Option<(usize, Signal)>>,
}

impl LoopTable {
    fn place(&mut self, prefix: Option<&str>, message: &Message<'_>) -> Option<(usize, Signal)> {
        if let Some(known) = self.by_channel.get(&message.channel_id) {
            return *known;
        }
        let place = match Topic::parse(prefix, message.topic()) {
            Some(Topic { loop_name, leaf: Leaf::Raw(signal), .. }) => {
                let at = *self.by_name.entry(loop_name.to_owned()).or_insert(self.loops.len());
                if at == self.loops.len() {
                    self.loops.push(LoadedLoop { name: loop_name.to_owned(), samples: Vec::new() });
                }
                Some((at, signal))
            }
            _ => None,
        };
        self.by_channel.insert(message.channel_id, place);
        place
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn content_tells_the_kind() {
        assert_eq!(InputKind::of_content(b"\x89MCAP0\r\n..."), Ok(InputKind::Mcap));
        assert_eq!(InputKind::of_content(b"t,op,pv\n0,1,2\n"), Ok(InputKind::Csv));
        assert!(InputKind::of_content(b"MATLAB 5.0 MAT-file, x").unwrap_err().contains("not supported yet"));
        assert!(InputKind::of_content(b" \r\n").unwrap_err().contains("empty"));
        assert!(InputKind::of_content(b"\x00\x01").is_err());
        assert!(InputKind::of_content(b"PK\x03\x04").is_err());
    }
}
