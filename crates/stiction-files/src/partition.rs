//! Loops as Parquet files in folders by loop and day: `loop=FIC101/day=2026-01-05/part-0.parquet`, the layout that query
//! engines read. Loop names are percent-encoded (`u1%2FFIC101`); days are in UTC.

use std::path::{Path, PathBuf};

use super::{FileError, Loaded, LoadedLoop, ReadOptions};

/// Start of a loop's folder name.
const LOOP: &str = "loop=";
/// Start of a day's folder name.
const DAY: &str = "day=";
/// Metadata of a column that this program wrote: its unit, or nothing.
#[cfg(feature = "parquet")]
pub(crate) const METADATA_UNIT: &str = "stictiond.unit";
/// Name of every file.
#[cfg(feature = "parquet")]
const FILE: &str = "part-0.parquet";

/// A loop name as a folder name: all bytes but letters, digits and `-._~` percent-encoded.
#[must_use]
pub fn encoded(name: &str) -> String {
    let mut text = String::with_capacity(name.len());
    for byte in name.bytes() {
        if byte.is_ascii_alphanumeric() || b"-._~".contains(&byte) {
            text.push(byte.into());
        } else {
            text.push_str(&format!("%{byte:02X}"));
        }
    }
    text
}

/// The encoded loop name; `None` if it is not one.
fn decoded(text: &str) -> Option<String> {
    let mut bytes = Vec::with_capacity(text.len());
    let mut rest = text.as_bytes();
    while let Some((first, after)) = rest.split_first() {
        rest = after;
        if *first == b'%' {
            let digits = std::str::from_utf8(after.get(..2)?).ok()?;
            bytes.push(u8::from_str_radix(digits, 16).ok()?);
            rest = &after[2..];
        } else {
            bytes.push(*first);
        }
    }
    String::from_utf8(bytes).ok().filter(|name| !name.is_empty())
}

/// The loop of a file in such folders; `None` for other files.
#[must_use]
pub fn loop_of(path: &Path) -> Option<String> {
    let mut above = path.ancestors().skip(1).map(|folder| folder.file_name().unwrap_or_default().to_string_lossy());
    above.next()?.strip_prefix(DAY)?;
    decoded(above.next()?.strip_prefix(LOOP)?)
}

/// Reads the days of one loop in order.
///
/// # Errors
/// One of them cannot be read.
pub(super) fn load(name: &str, paths: &[PathBuf], options: &ReadOptions) -> Result<Loaded, FileError> {
    let mut all: Option<Loaded> = None;
    for path in paths {
        let mut day = super::load(path, options)?;
        let units = day.loops.first().map(|one| one.units.clone()).unwrap_or_default();
        let samples = day.loops.iter_mut().flat_map(|one| std::mem::take(&mut one.samples)).collect();
        match &mut all {
            None => {
                day.loops = vec![LoadedLoop { units, ..LoadedLoop::new(name, samples) }];
                all = Some(day);
            }
            Some(all) => {
                all.loops[0].samples.extend(samples);
                all.warnings.append(&mut day.warnings);
            }
        }
    }
    let nothing = || FileError::Kind { path: PathBuf::from(name), what: "a loop without a day" };
    all.ok_or_else(nothing)
}

#[cfg(feature = "parquet")]
pub use write::{Part, PartitionError, write};

#[cfg(feature = "parquet")]
mod write {
    //! Writing, in builds with Parquet.

    use std::collections::{BTreeMap, HashMap};
    use std::fs::{self, File};
    use std::io;
    use std::path::{Path, PathBuf};
    use std::sync::Arc;

    use arrow_array::{Array as _, ArrayRef, Float64Array, RecordBatch, StringArray, TimestampNanosecondArray};
    use arrow_schema::{Field, Schema};
    use parquet::arrow::ArrowWriter;
    use parquet::basic::{Compression, ZstdLevel};
    use parquet::file::properties::WriterProperties;
    use thiserror::Error;

    use super::{DAY, FILE, LOOP, METADATA_UNIT, encoded};
    use crate::csv::{COLUMNS, Row, rows_of};
    use crate::{LoadedLoop, sync_folder};
    use stiction::core::record::{Signal, Value};
    use stiction::core::units::format_rfc3339;

    /// An error while writing.
    #[derive(Debug, Error)]
    #[error("{}: {what}", path.display())]
    pub struct PartitionError {
        /// The file or folder.
        pub path: PathBuf,
        /// What is wrong, and the remedy.
        pub what: String,
    }

    /// A file that was written.
    #[derive(Debug, Clone, PartialEq, Eq)]
    pub struct Part {
        /// Its place.
        pub path: PathBuf,
        /// Its rows.
        pub rows: usize,
    }

    /// Writes the days of a loop below a folder, each file completely or not at all. Rows are in time order; a row has the
    /// samples of one timestamp: null where there is none, NaN where it has no value. The unit of a column is in its metadata.
    ///
    /// # Errors
    /// [`PartitionError`]: a file exists and `force` is not set, or a disk error.
    pub fn write(one: &LoadedLoop, folder: &Path, force: bool) -> Result<Vec<Part>, PartitionError> {
        let mut rows = rows_of(&one.samples);
        rows.sort_by_key(|row| row.t_ns);
        let has = |at: usize| one.samples.iter().any(|s| s.signal == COLUMNS[at]);
        let shown: Vec<usize> = (0..COLUMNS.len()).filter(|at| *at < 2 || has(*at)).collect();
        let mut days: BTreeMap<String, Vec<Row>> = BTreeMap::new();
        for row in rows {
            let day = format_rfc3339(row.t_ns).split('T').next().unwrap_or_default().to_owned();
            days.entry(day).or_default().push(row);
        }
        let below = folder.join(format!("{LOOP}{}", encoded(&one.name)));
        let mut parts = Vec::with_capacity(days.len());
        for (day, rows) in &days {
            let place = below.join(format!("{DAY}{day}"));
            let path = place.join(FILE);
            if path.exists() && !force {
                return Err(PartitionError { path, what: "already exists; use --force to replace it".to_owned() });
            }
            let failed = |what: String| PartitionError { path: path.clone(), what };
            fs::create_dir_all(&place).map_err(|error| failed(error.to_string()))?;
            let passing = place.join(format!(".{FILE}.{}", std::process::id()));
            let written = table(rows, &shown, &one.units).and_then(|batch| put(&batch, &passing));
            let named = written.and_then(|()| fs::rename(&passing, &path));
            if let Err(error) = named {
                // Half a file helps nobody.
                let _ = fs::remove_file(&passing);
                return Err(failed(error.to_string()));
            }
            sync_folder(&path).map_err(|error| failed(error.to_string()))?;
            parts.push(Part { path, rows: rows.len() });
        }
        Ok(parts)
    }

    fn table(rows: &[Row], shown: &[usize], units: &[Option<String>; 2]) -> io::Result<RecordBatch> {
        let t: TimestampNanosecondArray = rows.iter().map(|row| Some(row.t_ns)).collect();
        let mut columns = vec![("t", Arc::new(t.with_timezone("UTC")) as ArrayRef)];
        for at in shown {
            let cells = rows.iter().map(|row| row.cells[*at]);
            let column: ArrayRef = if COLUMNS[*at] == Signal::Mode {
                Arc::new(cells.map(word).collect::<StringArray>())
            } else {
                Arc::new(cells.map(|cell| Some(cell?.as_number().unwrap_or(f64::NAN))).collect::<Float64Array>())
            };
            columns.push((COLUMNS[*at].name(), column));
        }
        let field = |(name, column): &(&str, ArrayRef)| {
            let field = Field::new(*name, column.data_type().clone(), *name != "t");
            let at = COLUMNS.iter().position(|signal| signal.name() == *name);
            let unit = at.and_then(|at| units.get(at)?.clone()).unwrap_or_default();
            // Even an empty one says that NaN is a missing value, not a row of another column.
            field.with_metadata(HashMap::from([(METADATA_UNIT.to_owned(), unit)]))
        };
        let schema = Schema::new(columns.iter().map(field).collect::<Vec<_>>());
        let columns = columns.into_iter().map(|(_, column)| column).collect();
        RecordBatch::try_new(Arc::new(schema), columns).map_err(io::Error::other)
    }

    fn word(cell: Option<Value>) -> Option<String> {
        match cell? {
            Value::Mode(mode) => Some(mode.name().to_owned()),
            Value::Number(number) => Some(number.to_string()),
            Value::Missing => Some("nan".to_owned()),
        }
    }

    fn put(batch: &RecordBatch, path: &Path) -> io::Result<()> {
        let compression = Compression::ZSTD(ZstdLevel::default());
        let settings = WriterProperties::builder().set_compression(compression).build();
        let file = File::create(path)?;
        let mut writer =
            ArrowWriter::try_new(file.try_clone()?, batch.schema(), Some(settings)).map_err(io::Error::other)?;
        writer.write(batch).map_err(io::Error::other)?;
        writer.close().map_err(io::Error::other)?;
        file.sync_all()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_written_as_in_addresses_and_read_back() {
        for (name, text) in [("FIC101", "FIC101"), ("u1/FIC 1", "u1%2FFIC%201"), ("Öl=%", "%C3%96l%3D%25")] {
            assert_eq!(encoded(name), text);
            let path = PathBuf::from(format!("data/loop={text}/day=2026-01-05/x.parquet"));
            assert_eq!(loop_of(&path).as_deref(), Some(name));
        }
        for path in ["loop=A/x.parquet", "loop=%2/day=1/x", "loop=/day=1/x", "day=1/loop=A/x", "x"] {
            assert_eq!(loop_of(Path::new(path)), None, "{path}");
        }
    }
}
