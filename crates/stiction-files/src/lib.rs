//! Files: recordings (MCAP), tables (CSV and exports), compact stores (MATLAB). The content decides the type, not the name.

mod alarm_log;
pub mod archive;
pub mod columns;
pub mod compact;
mod conventions;
pub mod csv;
pub mod disk;
pub mod even;
pub mod export;
pub mod inputs;
pub mod labelled;
pub mod lock;
pub mod mat;
mod mcap_index;
mod mcap_read;
mod mcap_roster;
mod mcap_write;
mod number;
pub mod pairing;
pub mod partition;
pub mod rescue;
pub mod reviews;
pub mod run;
pub mod schemas;
pub mod seal;
pub mod store;
pub mod transfer;

pub use alarm_log::{LOG_SCHEMA, log_topic};
pub use mcap_index::MAX_RECORD;
pub use mcap_read::{Channel, End, Item, Message, RawSample, ReadError, RecordingReader};
pub use mcap_write::{MAX_CHANNELS, RecordingFile, WriteError, sync_folder};

pub use export::ReadOptions;

use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};
use stiction::core::record::{Sample, Signal, Value};
use stiction::samples::align::Quality;
use stiction_engine::codec;
use stiction_engine::codec::topic::{Leaf, Topic};
use thiserror::Error;

/// Name of the metadata record in the program's recordings.
pub const METADATA_NAME: &str = "stictiond";

/// Metadata key of the prefix of all topics.
pub const METADATA_PREFIX: &str = "prefix";

/// The quality code of OPC UA for bad.
pub(crate) const BAD: u32 = 0x8000_0000;

/// Metadata key of the units of OP and PV by loop, a JSON object.
const METADATA_UNITS: &str = "units";

/// Type of a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum InputKind {
    /// A recording.
    Mcap,
    /// A text table: `t,op,pv…`, or an export.
    Csv,
    /// The toolbox's compact store, a MATLAB file of version 5.
    Mat,
    /// A workbook.
    Xlsx,
    /// A Parquet file.
    Parquet,
    /// An Arrow IPC file or stream (Feather).
    Arrow,
}

impl InputKind {
    /// `mcap`, `csv`, `mat`, `xlsx`, `parquet` or `arrow`.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Mcap => "mcap",
            Self::Csv => "csv",
            Self::Mat => "mat",
            Self::Xlsx => "xlsx",
            Self::Parquet => "parquet",
            Self::Arrow => "arrow",
        }
    }

    /// Recognises a file by its first bytes.
    ///
    /// # Errors
    /// [`FileError`] names what the file seems to be, and the remedy.
    pub fn detect(path: &Path) -> Result<Self, FileError> {
        let failed = |cause| FileError::Io { path: path.to_owned(), cause };
        if path.is_dir() {
            return Err(failed(io::Error::new(io::ErrorKind::IsADirectory, "this is a folder; name a file")));
        }
        // Files are read more than once, and the names of pipes may have no writer.
        if !std::fs::metadata(path).map_err(failed)?.is_file() {
            let what = "this is a pipe or a device; write its content to a file first, such as june.csv";
            return Err(failed(io::Error::other(what)));
        }
        let mut head = Vec::with_capacity(4096);
        File::open(path).map_err(failed)?.take(4096).read_to_end(&mut head).map_err(failed)?;
        match mat::recognise(&head) {
            Ok(true) => return Ok(Self::Mat),
            Ok(false) => {}
            Err(cause) => return Err(FileError::Compact { path: path.to_owned(), cause: cause.into() }),
        }
        Self::of_content(&head).map_err(|what| FileError::Kind { path: path.to_owned(), what })
    }

    /// The type of a file that begins so; otherwise what it seems to be, and the remedy.
    fn of_content(head: &[u8]) -> Result<Self, &'static str> {
        let marks: [(&[u8], Self); 4] = [
            (b"PK\x03\x04", Self::Xlsx),
            (b"PAR1", Self::Parquet),
            (b"ARROW1", Self::Arrow),
            (b"\xff\xff\xff\xff", Self::Arrow),
        ];
        let unsupported: [(&[u8], &str); 3] = [
            (b"\xd0\xcf\x11\xe0", "an old workbook (.xls); save it as .xlsx or .csv"),
            (b"\x1f\x8b", "compressed by gzip; unpack it"),
            (b"FEA1", "Feather of version 1; write it as version 2, Parquet or .csv"),
        ];
        if mcap_read::begins_as_recording(head) {
            return Ok(Self::Mcap);
        }
        if let Some((_, kind)) = marks.iter().find(|(mark, _)| head.starts_with(mark)) {
            return Ok(*kind);
        }
        if let Some((_, what)) = unsupported.iter().find(|(mark, _)| head.starts_with(mark)) {
            return Err(what);
        }
        let marks: [&[u8]; 3] = [b"\xff\xfe", b"\xfe\xff", b"\0\0\xfe\xff"];
        if marks.iter().any(|mark| head.starts_with(mark)) || export::wide(head).is_some() {
            return Ok(Self::Csv);
        }
        if head.iter().all(u8::is_ascii_whitespace) {
            return Err(
                "empty; expected a recording (.mcap), a table (.csv, .xlsx, .parquet) or a compact store (.mat)",
            );
        }
        // Zeros in a text are of a damaged file, which the reader of tables names by their line.
        let other = |b: &&u8| **b < b' ' && !b"\0\t\r\n\x1a".contains(b);
        if head.contains(&0) && (head[0] == 0 || head.iter().any(|b| other(&b)) || !head.contains(&b'\n')) {
            return Err("neither a recording (.mcap), nor a table (.csv, .xlsx, .parquet), nor a compact store (.mat)");
        }
        Ok(Self::Csv)
    }
}

/// A file that cannot be read at all.
#[derive(Debug, Error)]
pub enum FileError {
    /// The system refuses to read it.
    #[error("{}: {cause}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// Error of the system.
        cause: io::Error,
    },
    /// Not a supported type.
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
    #[error("{}: {cause}", path.display())]
    Export {
        /// The file.
        path: PathBuf,
        /// Line, what was seen, and the option that settles it.
        cause: export::ExportError,
    },
    /// A compact store that cannot be read.
    #[error("{}: {cause}", path.display())]
    Compact {
        /// The file.
        path: PathBuf,
        /// Place and remedy.
        cause: compact::CompactError,
    },
}

/// Additional information on a loop in a compact store.
#[derive(Debug, Clone, PartialEq)]
pub struct About {
    /// Tags of OP and PV.
    pub tags: [String; 2],
    /// Sampling time, s.
    pub ts_s: f64,
    /// Comment.
    pub comment: String,
}

/// One loop of a file.
#[derive(Debug, Clone, PartialEq)]
pub struct LoadedLoop {
    /// Its name.
    pub name: String,
    /// Its samples in recorded order.
    pub samples: Vec<Sample>,
    /// Tags, sampling time and comment, from compact stores.
    pub about: Option<About>,
    /// Units of OP and PV, from exports that give them.
    pub units: [Option<String>; 2],
}

impl LoadedLoop {
    /// A loop with samples only.
    #[must_use]
    pub fn new(name: impl Into<String>, samples: Vec<Sample>) -> Self {
        Self { name: name.into(), samples, about: None, units: [None, None] }
    }

    /// The loop with values of bad quality missing, and the quality of all by the convention of OPC UA.
    #[must_use]
    pub fn judged(&self, convention: Quality) -> Self {
        let judge = |sample: &Sample| match sample.quality.filter(|code| !convention.is_good(*code)) {
            Some(code) => {
                let code = if Quality::Ua.is_good(code) { BAD } else { code };
                Sample { value: Value::Missing, quality: Some(code), ..*sample }
            }
            None => Sample { quality: None, ..*sample },
        };
        Self { samples: self.samples.iter().map(judge).collect(), ..self.clone() }
    }

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
    /// Type of the file.
    pub kind: InputKind,
    /// Its loops in order of first appearance.
    pub loops: Vec<LoadedLoop>,
    /// Format recognised in an export; `None` for the program's own formats.
    pub recognised: Option<export::Recognised>,
    /// Warnings, one line each.
    pub warnings: Vec<String>,
    /// Whether the file is truncated or damaged; `loops` then has what could be read.
    pub data_loss: bool,
    /// The recording's metadata; empty for tables.
    pub metadata: BTreeMap<String, String>,
}

/// Reads the raw data of a table, recording or compact store. Of truncated and damaged recordings it returns the readable
/// part, with [`Loaded::data_loss`] set.
///
/// # Errors
/// [`FileError`] if the file's type is unknown, a table is malformed, or the system refuses.
pub fn load_samples(path: &Path) -> Result<Loaded, FileError> {
    load(path, &ReadOptions::default())
}

/// As [`load_samples`], with options for exports.
///
/// # Errors
/// As [`load_samples`].
pub fn load(path: &Path, options: &ReadOptions) -> Result<Loaded, FileError> {
    load_as(path, path, options)
}

/// As [`load_samples`], under another name: loops of tables are named after their files.
///
/// # Errors
/// As [`load_samples`]; faults in a table are reported under the given name.
pub fn load_as(path: &Path, called: &Path, options: &ReadOptions) -> Result<Loaded, FileError> {
    match InputKind::detect(path)? {
        InputKind::Mcap => load_recording(path),
        InputKind::Mat => load_store(path),
        kind => {
            let bytes = std::fs::read(path).map_err(|cause| FileError::Io { path: path.to_owned(), cause })?;
            let read = export::read(kind, called, &bytes, options);
            let named = |cause| named_mat(called, FileError::Export { path: called.to_owned(), cause });
            let read = read.map_err(named)?;
            Ok(Loaded::of_export(kind, read))
        }
    }
}

impl Loaded {
    fn of_export(kind: InputKind, export: export::Export) -> Self {
        let export::Export { loops, recognised, warnings } = export;
        Self { kind, loops, recognised, warnings, data_loss: false, metadata: BTreeMap::new() }
    }

    /// Joins inputs, given by name, into one, and lists those that could not be read. Warnings of the second and later inputs
    /// begin with the input's name.
    pub fn join(inputs: impl IntoIterator<Item = (String, Result<Self, FileError>)>) -> (Option<Self>, Vec<FileError>) {
        let (mut all, mut faults): (Option<Self>, Vec<FileError>) = (None, Vec::new());
        for (name, loaded) in inputs {
            match (loaded, &mut all) {
                (Ok(loaded), None) => all = Some(loaded),
                (Ok(mut more), Some(all)) => {
                    all.loops.append(&mut more.loops);
                    all.warnings.extend(more.warnings.iter().map(|warning| format!("{name}: {warning}")));
                    all.data_loss |= more.data_loss;
                }
                (Err(fault), _) => faults.push(fault),
            }
        }
        (all, faults)
    }
}

/// An error for a text named .mat that is not a table either.
fn named_mat(path: &Path, error: FileError) -> FileError {
    let named = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("mat"));
    match error {
        FileError::Export { .. } if named => FileError::Kind {
            path: path.to_owned(),
            what: "named .mat but is text, and not a table t,op,pv; save it in MATLAB with save -v7",
        },
        other => other,
    }
}

fn load_store(path: &Path) -> Result<Loaded, FileError> {
    let store = compact::read(path).map_err(|cause| FileError::Compact { path: path.to_owned(), cause })?;
    let loops = store.loops.into_iter().map(|one| {
        let samples = one.samples();
        let about = Some(About { tags: one.tags, ts_s: one.ts_s, comment: one.comment });
        LoadedLoop { about, units: one.units, ..LoadedLoop::new(one.name, samples) }
    });
    Ok(Loaded {
        kind: InputKind::Mat,
        loops: loops.collect(),
        recognised: None,
        warnings: store.warnings,
        data_loss: store.incomplete,
        metadata: BTreeMap::new(),
    })
}

/// Finds a loop by its name; in compact stores also by number, tag, or the common part of both tags.
///
/// # Errors
/// A sentence that lists the loops.
pub fn choose_loop<'l>(loops: &'l [LoadedLoop], wanted: &str) -> Result<&'l LoadedLoop, String> {
    let named: Vec<&LoadedLoop> = loops.iter().filter(|one| one.name == wanted).collect();
    match named[..] {
        [] => {}
        [one] => return Ok(one),
        _ => return Err(format!("{} of the files have a loop {wanted:?}; name one of them", named.len())),
    }
    let number = |one: &LoadedLoop| one.name.strip_prefix("loop") == Some(wanted);
    let tagged =
        |about: &About| about.tags.iter().any(|tag| tag == wanted) || compact::stem_of(&about.tags) == Some(wanted);
    let means = |one: &&LoadedLoop| one.about.as_ref().is_some_and(|about| number(one) || tagged(about));
    let found: Vec<&LoadedLoop> = loops.iter().filter(means).collect();
    let names = |of: &[&LoadedLoop]| of.iter().take(20).map(|one| one.name.as_str()).collect::<Vec<_>>().join(", ");
    match found[..] {
        [one] => Ok(one),
        [] => Err(format!("there is no loop {wanted:?}; choose one of {}", names(&loops.iter().collect::<Vec<_>>()))),
        _ => Err(format!("{wanted:?} matches {}; choose one of these", names(&found))),
    }
}

fn load_recording(path: &Path) -> Result<Loaded, FileError> {
    let mut reader = RecordingReader::open(path)?;
    let prefix = reader.metadata().get(METADATA_PREFIX).cloned();
    let mut loops = LoopTable::default();
    let mut scratch = Vec::new();
    let (mut unreadable, mut first_fault) = (0_u64, String::new());
    while let Some(item) = reader.next_item()? {
        let Some((at, signal)) = loops.place(prefix.as_deref(), item.channel()) else {
            if loops.loops.is_empty() && first_fault.is_empty() {
                first_fault = foreign(prefix.as_deref(), item.channel().1).unwrap_or_default();
            }
            continue;
        };
        let message = match item {
            Item::Message(message) => message,
            Item::Sample(raw) => {
                loops.loops[at].samples.push(raw.sample);
                continue;
            }
        };
        scratch.clear();
        let own_time = if message.publish_time_ns == 0 { message.log_time_ns } else { message.publish_time_ns };
        match codec::decode(signal, message.data, Some(&message.channel.encoding), None, own_time, &mut scratch) {
            Ok(_) => loops.loops[at].samples.extend_from_slice(&scratch),
            Err(error) => {
                if unreadable == 0 {
                    first_fault = format!("{}: {error}", message.topic());
                }
                unreadable += 1;
            }
        }
    }
    let mut warnings = Vec::new();
    if unreadable > 0 {
        warnings.push(format!("skipped {unreadable} unreadable messages, the first: {first_fault}"));
    }
    let end = reader.end().cloned().unwrap_or(End::Clean);
    if !first_fault.is_empty() && loops.loops.iter().all(|one| one.samples.is_empty()) {
        return Err(ReadError::Nothing { path: path.to_owned(), first: first_fault }.into());
    }
    if let Some(units) = reader.metadata().get(METADATA_UNITS) {
        let units: BTreeMap<String, [Option<String>; 2]> = serde_json::from_str(units).unwrap_or_default();
        for one in &mut loops.loops {
            one.units = units.get(&one.name).cloned().unwrap_or_default();
        }
    }
    if let Some(reason) = end.reason() {
        warnings.push(format!("the recording is {}: {reason}", end.word()));
    }
    Ok(Loaded {
        kind: InputKind::Mcap,
        loops: loops.loops,
        recognised: None,
        warnings,
        data_loss: !end.is_clean(),
        metadata: reader.metadata().clone(),
    })
}

/// What is wrong with a channel that is none of this program's.
#[must_use]
pub fn foreign(prefix: Option<&str>, channel: &Channel) -> Option<String> {
    let (topic, encoding) = (&channel.topic, &channel.encoding);
    let is_own = topic.contains("@stiction/") || Topic::parse(prefix, topic).is_some();
    (!is_own)
        .then(|| format!("{topic}, encoding {encoding:?}: the topic does not end in a signal (op, pv, sp, mode, mv)"))
}

/// Loop and signal of each channel; each topic is parsed once.
#[derive(Default)]
struct LoopTable {
    loops: Vec<LoadedLoop>,
    by_name: HashMap<String, usize>,
    by_channel: HashMap<u16, Option<(usize, Signal)>>,
}

impl LoopTable {
    fn place(&mut self, prefix: Option<&str>, (id, channel): (u16, &Channel)) -> Option<(usize, Signal)> {
        if let Some(known) = self.by_channel.get(&id) {
            return *known;
        }
        let place = match Topic::parse(prefix, &channel.topic) {
            Some(Topic { loop_name, leaf: Leaf::Raw(signal), .. }) => {
                let at = *self.by_name.entry(loop_name.to_owned()).or_insert(self.loops.len());
                if at == self.loops.len() {
                    self.loops.push(LoadedLoop::new(loop_name, Vec::new()));
                }
                Some((at, signal))
            }
            _ => None,
        };
        self.by_channel.insert(id, place);
        place
    }
}

/// Whether two reads were of the same file, whatever its name.
#[cfg(unix)]
fn same_file(a: &std::fs::Metadata, b: &std::fs::Metadata) -> bool {
    use std::os::unix::fs::MetadataExt as _;
    (a.dev(), a.ino()) == (b.dev(), b.ino())
}

#[cfg(not(unix))]
fn same_file(a: &std::fs::Metadata, b: &std::fs::Metadata) -> bool {
    a.len() == b.len()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fault_is_stated_once() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.csv");
        std::fs::write(&path, "t,op,pv\nnever,1,2\n").unwrap();
        for path in [path, dir.path().join("gone.csv")] {
            let error = anyhow::Error::from(load_samples(&path).unwrap_err());
            assert_eq!(format!("{error:#}"), error.to_string());
        }
    }

    #[test]
    fn content_tells_the_kind() {
        assert_eq!(InputKind::of_content(b"\x89MCAP0\r\n..."), Ok(InputKind::Mcap));
        assert_eq!(InputKind::of_content(b"t,op,pv\n0,1,2\n"), Ok(InputKind::Csv));
        assert!(mat::recognise(b"MATLAB 5.0 MAT-file, x").unwrap());
        assert!(InputKind::of_content(b" \r\n").unwrap_err().contains("empty"));
        assert!(InputKind::of_content(b"\x00\x01").is_err());
        assert_eq!(InputKind::of_content(b"PK\x03\x04"), Ok(InputKind::Xlsx));
        assert_eq!(InputKind::of_content(b"t\0,\0o\0p\0,\0p\0v\0"), Ok(InputKind::Csv));
        assert!(InputKind::of_content(b"\x1f\x8b").unwrap_err().contains("gzip"));
    }
}
