//! Tables exported by historians, spreadsheets and data tools: bytes → text → table → columns → times → loops.
//!
//! | step | file |
//! |---|---|
//! | encoding | `text` |
//! | separator, comment lines, names, units | `delimited`; workbooks `workbook`; Parquet and Arrow `columnar` |
//! | role of each column | `columns`, `names`, `map` |
//! | numbers, words for missing values, quality codes | `number`, `quality` |
//! | parsing a time, meaning of a time column, zones | `stamp`, `clock`, `zone` |
//! | rows to series, series to loops | `gather`, `series`, `pair` |
//!
//! Nothing is guessed if two readings are possible: such a file is rejected with the line, what was seen, and the option
//! that settles it.

mod cell;
mod clock;
#[cfg(feature = "parquet")]
mod columnar;
mod columns;
mod delimited;
mod gather;
mod map;
pub mod names;
mod options;
mod pair;
mod quality;
mod series;
mod stamp;
mod text;
#[cfg(feature = "xlsx")]
mod workbook;
mod zone;

pub use super::number::Decimal;
pub use clock::TimeFormat;
pub use map::Map;
pub use options::{ReadOptions, delimiter, encoding};
pub use quality::Codes;
pub use zone::Zone;

use std::path::Path;
use std::time::SystemTime;

use thiserror::Error;

use super::{InputKind, LoadedLoop};
use cell::Table;
use series::Series;
use stiction::core::units::{NS_PER_S, parse_time};
pub(crate) use text::wide;

/// What cannot be read, where, and what settles it.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("{}{what}; {remedy}", place(*line))]
pub struct ExportError {
    /// Line in the file (row in a sheet), from 1; 0 if none.
    pub line: u64,
    /// What was seen.
    pub what: String,
    /// The option that settles it, or another remedy.
    pub remedy: String,
}

fn place(line: u64) -> String {
    if line == 0 { String::new() } else { format!("line {line}: ") }
}

impl ExportError {
    /// The first option of the remedy, as it can be pasted; `None` if a person must fill something in.
    #[must_use]
    pub fn flags(&self) -> Option<&str> {
        let flags = &self.remedy[self.remedy.find("--")?..];
        let end = [", ", " or ", " if ", " too", " (", "; ", ": "].iter().filter_map(|mark| flags.find(mark)).min();
        let flags = &flags[..end.unwrap_or(flags.len())];
        let open = ["TAG", "COLUMN", "…"].iter().any(|word| flags.contains(word));
        (flags.contains([' ', '=']) && !open).then_some(flags)
    }

    fn at(line: u64, what: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self { line, what: what.into(), remedy: remedy.into() }
    }
}

/// What was recognised in an export.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Recognised {
    /// Its format in a few words separated by commas; files of one system have it in common.
    pub form: String,
    /// Counts for this file, such as words for missing values.
    pub counts: Vec<String>,
    /// What each column or tag is read as.
    pub columns: Vec<String>,
}

impl std::fmt::Display for Recognised {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.form)?;
        self.counts.iter().try_for_each(|count| write!(f, "; {count}"))
    }
}

/// Parses a time: seconds since 1970, or a date in any format of exports.
///
/// # Errors
/// A sentence that says what settles it.
pub fn moment(text: &str, options: &ReadOptions) -> Result<i64, String> {
    if let Ok(t_ns) = parse_time(text) {
        return Ok(t_ns);
    }
    let stamp = stamp::Stamp::by(options.time_format.as_ref(), text);
    let stamp = stamp.ok_or_else(|| format!("{text:?} is not a time; write one such as 2026-01-05T08:00:00Z"))?;
    let mut axis = clock::Axis::default();
    axis.column.name = text.to_owned();
    axis.push(stamp, 0);
    let asked = clock::TimeOptions { form: options.time_format.as_ref(), zone: options.zone.as_ref(), end_s: end_s() };
    let times = axis.times(&[vec![0]], asked).map_err(|e| e.to_string())?;
    times.t_ns.first().copied().ok_or_else(|| format!("{text:?} is not a time; write one such as 2026-01-05T08:00:00Z"))
}

/// A written time that has one reading, in UTC unless it says otherwise. Numbers are none: their unit is unknown.
pub(crate) fn utc(text: &str) -> Option<i64> {
    let stamp::Stamp::Civil(civil) = stamp::Stamp::read(text)? else { return None };
    let mut readings = stamp::Order::ALL.into_iter().filter_map(|order| civil.local_ns(order));
    let (first, offset_s) = (readings.next()?, civil.offset_s.unwrap_or(0));
    (civil.letters.is_none() && readings.all(|other| other == first)).then(|| first - i64::from(offset_s) * NS_PER_S)
}

/// The loops of an export.
#[derive(Debug, Default)]
pub(super) struct Export {
    /// The loops, in the order of their first tags.
    pub loops: Vec<LoadedLoop>,
    /// What was recognised; `None` for the program's own tables.
    pub recognised: Option<Recognised>,
    /// Warnings for the user.
    pub warnings: Vec<String>,
}

/// Contents of one file before tags are paired.
#[derive(Debug, Default)]
pub(super) struct Contents {
    series: Vec<Series>,
    words: Vec<String>,
    counts: Vec<String>,
    warnings: Vec<String>,
    /// Names of unrecognised columns.
    ignored: Vec<String>,
    /// Whether it is a table of the program's own form.
    own: bool,
}

fn end_s() -> i64 {
    let now = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).map_or(0, |d| d.as_secs());
    clock::end_of_next_year(i64::try_from(now).unwrap_or(0))
}

/// Whether the names are those of the program's own tables.
fn is_own(names: &[String]) -> bool {
    let has = |wanted: &str| names.iter().any(|n| names::bare(n).eq_ignore_ascii_case(wanted));
    ["t", "op", "pv"].iter().all(|name| has(name))
}

/// Reads an export completely.
///
/// # Errors
/// What cannot be recognised, with its line and the option that settles it.
pub(super) fn read(kind: InputKind, path: &Path, bytes: &[u8], options: &ReadOptions) -> Result<Export, ExportError> {
    pair::loops(vec![(stem_of(path), contents(kind, path, bytes, options)?)], options)
}

/// Reads files that together form loops: a signal each, or the same signals one after the other.
///
/// # Errors
/// As [`read`].
pub(super) fn read_parts(parts: Vec<(String, Contents)>, options: &ReadOptions) -> Result<Export, ExportError> {
    pair::loops(parts, options)
}

/// A file's name without extension.
pub(super) fn stem_of(path: &Path) -> String {
    path.file_stem().map_or_else(|| "loop".into(), |stem| stem.to_string_lossy().into_owned())
}

/// What files have in common that are read together: the loop of a single signal, or all tags of several; `None` for other
/// files.
///
/// Only the first rows are examined.
pub(super) fn together(kind: InputKind, path: &Path, bytes: &[u8], options: &ReadOptions) -> Option<String> {
    if kind != InputKind::Csv {
        return None;
    }
    let decoded = text::decode(bytes, options.encoding).ok()?;
    let table = delimited::table(&decoded.text, options).ok()?;
    let map = options.map.as_ref();
    let layout = columns::layout(&table, map.filter(|m| !m.names_signals()), false).ok()?;
    if let Some(role) = gather::only_role(&layout, &stem_of(path), map) {
        return Some(role.loop_name.to_uppercase());
    }
    let columns::Shape::Wide(columns) = &layout.shape else { return None };
    let roles = columns.iter().filter_map(|column| names::role(&column.tag));
    let mut tags: Vec<String> = roles.map(|role| format!("{}.{}", role.loop_name, role.signal.name())).collect();
    tags.sort();
    // Without a tag a loop has the name of its file.
    (map.is_none() && !tags.is_empty() && !tags.iter().any(|tag| tag.starts_with('.'))).then(|| tags.join(" "))
}

/// Series of a file.
///
/// # Errors
/// As [`read`].
pub(super) fn contents(
    kind: InputKind,
    path: &Path,
    bytes: &[u8],
    options: &ReadOptions,
) -> Result<Contents, ExportError> {
    let stem = stem_of(path);
    match kind {
        #[cfg(feature = "xlsx")]
        InputKind::Xlsx => workbook::read(bytes, &stem, options),
        #[cfg(not(feature = "xlsx"))]
        InputKind::Xlsx => Err(ExportError::at(
            0,
            "this build cannot read workbooks",
            "rebuild with --features full, or save the sheet as .csv",
        )),
        #[cfg(feature = "parquet")]
        InputKind::Parquet | InputKind::Arrow => {
            let table = columnar::table(kind, bytes)?;
            contents_of(&table, &stem, options)
        }
        #[cfg(not(feature = "parquet"))]
        InputKind::Parquet | InputKind::Arrow => Err(ExportError::at(
            0,
            "this build cannot read Parquet or Arrow",
            "rebuild with --features full, or export .csv",
        )),
        _ => {
            let decoded = text::decode(bytes, options.encoding)?;
            let mut table = delimited::table(&decoded.text, options)?;
            table.words.splice(0..0, decoded.encoding);
            table.warnings.extend(decoded.warning);
            contents_of(&table, &stem, options)
        }
    }
}

/// Parsing libraries panic on some damaged files; such a panic becomes an error of the file.
#[cfg(any(feature = "parquet", feature = "xlsx"))]
fn guarded<T>(work: impl FnOnce() -> Result<T, ExportError>) -> Result<T, ExportError> {
    std::panic::catch_unwind(std::panic::AssertUnwindSafe(work))
        .unwrap_or_else(|_| Err(ExportError::at(0, "the file is damaged", "export it again")))
}

fn contents_of(table: &Table<'_>, stem: &str, options: &ReadOptions) -> Result<Contents, ExportError> {
    let layout = columns::layout(table, options.map.as_ref(), options.codes != Some(Codes::Ignore))?;
    gather::gather(table, &layout, stem, options, end_s())
}
