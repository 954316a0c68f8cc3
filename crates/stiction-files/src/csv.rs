//! Tables `t,op,pv[,sp][,mv][,mode]`: columns in any order, `t` in seconds since 1970 or RFC 3339.
//!
//! An empty or non-finite cell of OP or PV is a missing sample. In the other columns an empty cell is no sample, because set
//! points and modes are often written on change only; likewise for OP and PV in a table where they are in separate rows,
//! each with its own timestamps. Writing joins samples of equal timestamps into rows and changes nothing else, so a table
//! that was read is written with equal values. A table with the newest row first is sorted, with a warning.

use super::FileError;
use super::number::{Decimal, Hint, hint, number};
use std::collections::HashMap;
use std::fs::File;
use std::io::{self, BufReader, Read, Write};
use std::path::Path;
use stiction::core::record::{Mode, Sample, Signal, Value};
use stiction::core::units::{TimeError, format_seconds, parse_time};
use stiction_engine::analysis::rows::{Joined, Rows};
use thiserror::Error;

/// Columns after `t` in the order of writing.
pub const COLUMNS: [Signal; 5] = [Signal::Op, Signal::Pv, Signal::Sp, Signal::Mv, Signal::Mode];

/// A table that cannot be read.
#[derive(Debug, Error)]
pub enum CsvError {
    /// A required column is missing.
    #[error("the header {header:?} has no column {column:?}; write t,op,pv[,sp][,mv][,mode]{hint}")]
    NoColumn {
        /// The header line.
        header: String,
        /// The column.
        column: &'static str,
        /// Further remedy.
        hint: &'static str,
    },
    /// A column occurs twice.
    #[error("the header {header:?} names column {column:?} twice; rename or remove one")]
    TwiceColumn {
        /// The header line.
        header: String,
        /// The column.
        column: String,
    },
    /// A row whose time cannot be read.
    #[error("line {line}: {cause}")]
    Time {
        /// Line in the file, from 1.
        line: u64,
        /// What is wrong and what would be right.
        cause: TimeError,
    },
    /// A row with more cells than the header.
    #[error("line {line} has {cells} cells, the header has {columns}; separate by commas, write decimals with a point")]
    Cells {
        /// Line in the file, from 1.
        line: u64,
        /// Its cells.
        cells: usize,
        /// The header's.
        columns: usize,
    },
    /// An I/O error or broken quoting.
    #[error(transparent)]
    Read(#[from] ::csv::Error),
}

/// The samples of a table.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Table {
    /// Samples in row order; within a row in the order of [`Signal::ALL`].
    pub samples: Vec<Sample>,
    /// Data rows.
    pub rows: u64,
    /// Cells that are empty or not finite.
    pub missing: u64,
    /// Warnings, one line each.
    pub warnings: Vec<String>,
}

/// Reads a table.
///
/// # Errors
/// [`FileError::Csv`] names the line and the remedy, [`FileError::Io`] what the system said.
pub fn read(path: &Path) -> Result<Table, FileError> {
    let file = File::open(path).map_err(|cause| FileError::Io { path: path.to_owned(), cause })?;
    read_from(BufReader::with_capacity(1 << 16, file)).map_err(|cause| FileError::Csv { path: path.to_owned(), cause })
}

/// Reads a table from any source.
///
/// # Errors
/// [`CsvError`] names the line and the remedy.
pub fn read_from(source: impl Read) -> Result<Table, CsvError> {
    let mut reader = ::csv::ReaderBuilder::new()
        .has_headers(false)
        .flexible(true)
        .trim(::csv::Trim::All)
        .from_reader(NewLines::of(source));
    let mut row = ::csv::ByteRecord::new();
    reader.read_byte_record(&mut row)?;
    let layout = Layout::of_header(&row)?;
    let mut rows = Cells::new(layout);
    while reader.read_byte_record(&mut row)? {
        rows.take(&row)?;
    }
    Ok(rows.finish())
}

/// A text whose lines end with a line feed alone: with a carriage return before it, rows are counted one short.
struct NewLines<R> {
    source: R,
    /// A carriage return whose next byte has not come yet.
    held: bool,
}

impl<R: Read> NewLines<R> {
    const fn of(source: R) -> Self {
        Self { source, held: false }
    }
}

impl<R: Read> Read for NewLines<R> {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        // A place for the one that is held.
        let mut taken = vec![0; out.len().saturating_sub(1)];
        loop {
            let count = self.source.read(&mut taken)?;
            let mut kept = 0;
            let mut keep = |byte| {
                out[kept] = byte;
                kept += 1;
            };
            for byte in &taken[..count] {
                if std::mem::take(&mut self.held) && *byte != b'\n' {
                    keep(b'\r');
                }
                self.held = *byte == b'\r';
                if !self.held {
                    keep(*byte);
                }
            }
            if count == 0 && !taken.is_empty() && std::mem::take(&mut self.held) {
                keep(b'\r');
            }
            // Nothing means the end, which has not come where all that came is held.
            if kept > 0 || count == 0 {
                return Ok(kept);
            }
        }
    }
}

/// Column positions.
struct Layout {
    time: usize,
    signals: Vec<(Signal, usize)>,
    ignored: Vec<String>,
    columns: usize,
}

impl Layout {
    fn of_header(row: &::csv::ByteRecord) -> Result<Self, CsvError> {
        let names: Vec<String> = row
            .iter()
            .map(|cell| String::from_utf8_lossy(cell).trim_start_matches('\u{feff}').trim().to_lowercase())
            .collect();
        let header: String = names.join(",").chars().take(120).collect();
        for (at, name) in names.iter().enumerate() {
            if !name.is_empty() && names[..at].contains(name) {
                return Err(CsvError::TwiceColumn { header, column: name.clone() });
            }
        }
        let hint = if names.len() == 1 && header.contains([';', '\t']) {
            "; separate by commas (not semicolons or tabs), write decimals with a point"
        } else {
            ""
        };
        let find = |wanted: &str| names.iter().position(|name| name == wanted);
        let need =
            |column: &'static str| find(column).ok_or(CsvError::NoColumn { header: header.clone(), column, hint });
        let time = need("t")?;
        need("op")?;
        need("pv")?;
        let signals = Signal::ALL.into_iter().filter_map(|s| find(s.name()).map(|at| (s, at))).collect();
        let known = |name: &String| name == "t" || name.is_empty() || Signal::from_name(name).is_some();
        let ignored = names.iter().filter(|name| !known(name)).cloned().collect();
        Ok(Self { time, signals, ignored, columns: names.len() })
    }
}

/// Cells in file order.
struct Cells {
    layout: Layout,
    rows: Rows,
    texts: u64,
    first_text: Option<(u64, String)>,
}

impl Cells {
    fn new(layout: Layout) -> Self {
        Self { layout, rows: Rows::default(), texts: 0, first_text: None }
    }

    fn take(&mut self, row: &::csv::ByteRecord) -> Result<(), CsvError> {
        let line = row.position().map_or(0, ::csv::Position::line);
        if row.iter().all(<[u8]>::is_empty) {
            return Ok(());
        }
        if row.len() > self.layout.columns && row.iter().skip(self.layout.columns).any(|cell| !cell.is_empty()) {
            return Err(CsvError::Cells { line, cells: row.len(), columns: self.layout.columns });
        }
        let time = String::from_utf8_lossy(row.get(self.layout.time).unwrap_or_default());
        let t_ns = parse_time(&time).map_err(|cause| CsvError::Time { line, cause })?;
        self.rows.begin(t_ns);
        for at in 0..self.layout.signals.len() {
            let (signal, column) = self.layout.signals[at];
            let cell = row.get(column).unwrap_or_default();
            let value = (!cell.is_empty()).then(|| self.value(signal, cell, line));
            self.rows.cell(signal, value);
        }
        Ok(())
    }

    fn value(&mut self, signal: Signal, cell: &[u8], line: u64) -> Value {
        let text = String::from_utf8_lossy(cell);
        match (text.parse::<f64>(), signal) {
            (Ok(number), _) => Value::number(number),
            (Err(_), Signal::Mode) => Value::Mode(Mode::from_word(&text)),
            // "1,234.5" in quotes is one cell and can be read in one way.
            (Err(_), _) if hint(&text) == Hint::Sure(Decimal::Point) => {
                number(&text, Decimal::Point).map_or(Value::Missing, Value::number)
            }
            (Err(_), _) => {
                self.texts += 1;
                self.first_text.get_or_insert_with(|| (line, text.chars().take(40).collect()));
                Value::Missing
            }
        }
    }

    fn finish(self) -> Table {
        let mut warnings = Vec::new();
        if !self.layout.ignored.is_empty() {
            warnings.push(format!("ignored columns: {}", self.layout.ignored.join(", ")));
        }
        if let Some((line, text)) = &self.first_text {
            let count = self.texts;
            let cells = match count {
                1 => "1 cell without a number counts".to_owned(),
                _ => format!("{count} cells without a number count"),
            };
            warnings.push(format!("{cells} as missing, first {text:?} in line {line}"));
        }
        let Joined { samples, rows, missing, warnings: more } = self.rows.finish();
        warnings.extend(more);
        Table { samples, rows, missing, warnings }
    }
}

/// One row: a timestamp and its cells in the order of [`COLUMNS`].
#[derive(Debug, Clone, Copy)]
pub struct Row {
    /// Timestamp, ns since 1970.
    pub t_ns: i64,
    /// `None` where there is no sample.
    pub cells: [Option<Value>; COLUMNS.len()],
}

/// Samples of one loop as rows: a sample joins the latest row of its timestamp unless its cell is already filled.
#[must_use]
pub fn rows_of(samples: &[Sample]) -> Vec<Row> {
    let mut rows: Vec<Row> = Vec::with_capacity(samples.len() / 2 + 1);
    let mut latest: HashMap<i64, usize> = HashMap::with_capacity(samples.len() / 2 + 1);
    for sample in samples {
        let Some(column) = COLUMNS.iter().position(|signal| *signal == sample.signal) else { continue };
        let at = match latest.get(&sample.t_ns) {
            Some(at) if rows[*at].cells[column].is_none() => *at,
            _ => {
                rows.push(Row { t_ns: sample.t_ns, cells: [None; COLUMNS.len()] });
                latest.insert(sample.t_ns, rows.len() - 1);
                rows.len() - 1
            }
        };
        rows[at].cells[column] = Some(sample.value);
    }
    rows
}

/// Writes one loop's samples as rows in recorded order and returns how many. `t`, `op` and `pv` are always written, other
/// columns if the loop has such samples. A cell is empty if there is no sample or its value is missing.
///
/// # Errors
/// Error of the writer.
pub fn write(samples: &[Sample], out: &mut impl Write) -> io::Result<usize> {
    let has = |signal: Signal| samples.iter().any(|s| s.signal == signal);
    let shown: Vec<usize> = (0..COLUMNS.len()).filter(|c| *c < 2 || has(COLUMNS[*c])).collect();
    write!(out, "t")?;
    for column in &shown {
        write!(out, ",{}", COLUMNS[*column].name())?;
    }
    writeln!(out)?;
    let rows = rows_of(samples);
    for row in &rows {
        write!(out, "{}", format_seconds(row.t_ns))?;
        for column in &shown {
            match row.cells[*column] {
                Some(Value::Number(number)) if number.is_finite() => write!(out, ",{number}")?,
                Some(Value::Mode(mode)) => write!(out, ",{}", mode.name())?,
                _ => write!(out, ",")?,
            }
        }
        writeln!(out)?;
    }
    Ok(rows.len())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn table(text: &str) -> Table {
        read_from(text.as_bytes()).unwrap()
    }

    fn written(samples: &[Sample]) -> String {
        let mut out = Vec::new();
        write(samples, &mut out).unwrap();
        String::from_utf8(out).unwrap()
    }

    #[test]
    fn columns_stand_in_any_order() {
        let text = "\u{feff}PV , T,Mode,op,note\r\n1.5,0,AUTO,2,x\r\n,2020-01-01T00:00:00Z,3,nan,\r\n\r\n";
        let table = table(text);
        assert_eq!((table.rows, table.missing), (2, 2));
        assert_eq!(table.warnings, ["ignored columns: note"]);
        assert_eq!(written(&table.samples), "t,op,pv,mode\n0,2,1.5,auto\n1577836800,,,3\n");
    }

    #[test]
    fn faults_name_line_and_remedy() {
        for (text, part) in [
            ("t,op,pv\n0,1,2\nabc,1,2\n", "line 3"),
            ("t,op,pv\n,1,2\n", "line 2"),
            ("t;op;pv\n0;1;2\n", "commas"),
            ("time,op,pv\n0,1,2\n", "no column \"t\""),
            ("t,op\n0,1\n", "no column \"pv\""),
            ("t,op,pv,OP\n", "twice"),
            ("t,op,pv\n0,1,5,2,5\n", "line 2 has 5 cells"),
            ("", "no column"),
        ] {
            let error = read_from(text.as_bytes()).unwrap_err().to_string();
            assert!(error.contains(part), "{text:?}: {error}");
        }
    }

    #[test]
    fn quoted_thousands_are_numbers_where_they_have_one_reading() {
        let read = table("t,op,pv\n0,\"1,234.5\",\"-1,150.10\"\n1,\"1,234,567\",2\n2,\"1,234\",\"1.234,5\"");
        let values: Vec<Option<f64>> = read.samples.iter().map(|s| s.value.as_number()).collect();
        assert_eq!(values, [Some(1234.5), Some(-1150.1), Some(1_234_567.0), Some(2.0), None, None]);
        assert!(read.warnings[0].starts_with("2 cells without a number") && read.warnings[0].contains("line 4"));
    }

    #[test]
    fn words_in_number_columns_are_missing_and_told() {
        let table = table("t,op,pv\n0,Bad,1\n1,2,\n2,3");
        assert_eq!((table.rows, table.missing), (3, 3));
        assert!(table.warnings[0].starts_with("1 cell without a number counts"), "{:?}", table.warnings);
        assert!(table.warnings[0].contains("line 2"), "{:?}", table.warnings);
        // However lines end, and wherever a read stops.
        for text in ["t,op,pv\r\n0,1,1\r\n\"1\",Bad,1\r\n2,3,3\r\n", "t,op,pv\n0,1,1\n1,Bad,1\n2,3,3"] {
            let read = read_from(BufReader::with_capacity(2, text.as_bytes())).unwrap();
            assert!(read.rows == 3 && read.warnings[0].contains("line 3"), "{:?}", read.warnings);
        }
    }

    #[test]
    fn rows_of_their_own_are_not_holes() {
        let table = table("t,op,pv\n0,1,\n0.1,,5\n1,2,\n1.1,,6\n");
        assert_eq!((table.samples.len(), table.missing), (4, 0));
        assert_eq!(written(&table.samples), "t,op,pv\n0,1,\n0.1,,5\n1,2,\n1.1,,6\n");
    }

    #[test]
    fn repeated_stamps_and_late_samples_keep_their_rows() {
        let text = "t,op,pv,sp\n5,1,2,\n5,3,4,7\n4,,9,8\n4,,9,8\n";
        assert_eq!(written(&table(text).samples), text);
        let sample = |signal, t_ns, v| Sample { signal, t_ns, value: Value::Number(v), quality: None };
        let late = [sample(Signal::Op, 1, 1.0), sample(Signal::Op, 2, 2.0), sample(Signal::Pv, 1, 3.0)];
        assert_eq!(written(&late), "t,op,pv\n0.000000001,1,3\n0.000000002,2,\n");
    }

    #[test]
    fn a_table_that_stands_newest_first_or_in_disorder_is_read_in_order_of_time() {
        let rows: Vec<String> = (0..600).map(|k| format!("{k},{},{}", k % 7, k % 5)).collect();
        let forward = table(&format!("t,op,pv\n{}\n", rows.join("\n")));
        let turned: Vec<&str> = rows.iter().rev().map(String::as_str).collect();
        let back = table(&format!("t,op,pv\n{}\n", turned.join("\n")));
        assert_eq!(back.samples, forward.samples);
        assert!(forward.warnings.is_empty() && back.warnings[0].contains("newest first"), "{:?}", back.warnings);
        // Now and then late is not newest first, and stands as it came.
        let late = table("t,op,pv\n1,1,1\n3,1,1\n2,1,1\n4,1,1\n");
        assert!(!late.samples.is_sorted_by_key(|s| s.t_ns) && late.warnings.is_empty());
        let blocks: Vec<&str> = rows[300..].iter().chain(&rows[..300]).map(String::as_str).collect();
        let sorted = table(&format!("t,op,pv\n{}\n", blocks.join("\n")));
        assert_eq!(sorted.samples, forward.samples);
        assert_eq!(sorted.warnings, ["the 600 rows are out of order: sorted by time"]);
        // A clock that was set back is no disorder.
        let set_back: Vec<String> = (0..600).map(|k| format!("{},1,1", k - 200 * (k / 400))).collect();
        assert!(table(&format!("t,op,pv\n{}\n", set_back.join("\n"))).warnings.is_empty());
        let shuffled: Vec<&str> = (0..600).map(|k| rows[k * 251 % 600].as_str()).collect();
        assert_eq!(table(&format!("t,op,pv\n{}\n", shuffled.join("\n"))).samples, forward.samples);
    }

    proptest! {
        #[test]
        fn what_is_written_reads_back_equal(
            rows in proptest::collection::vec((-1_000_000_000_000_000_000..4_000_000_000_000_000_000_i64, any::<u64>(), any::<u64>(), any::<Option<u64>>()), 1..40)
        ) {
            let mut samples = Vec::new();
            for (t_ns, op, pv, sp) in rows {
                let mut push = |signal, bits| {
                    samples.push(Sample { signal, t_ns, value: Value::number(f64::from_bits(bits)), quality: None });
                };
                push(Signal::Op, op);
                if let Some(bits) = sp.filter(|b| f64::from_bits(*b).is_finite()) {
                    push(Signal::Sp, bits);
                }
                push(Signal::Pv, pv);
            }
            let text = written(&samples);
            let back = table(&text);
            if back.warnings.iter().any(|w| w.contains("sorted by time")) {
                prop_assert!(back.samples.is_sorted_by_key(|s| s.t_ns));
                return Ok(());
            }
            prop_assert_eq!(written(&back.samples), text);
            if !back.warnings.iter().any(|w| w.contains("rows of their own")) {
                prop_assert_eq!(back.samples, samples);
            }
        }

        #[test]
        fn no_text_panics(text in "[tpov,;0-9.\\-\"\n\r eE]{0,80}") {
            let _ = read_from(text.as_bytes());
            let _ = read_from(format!("t,op,pv\n{text}").as_bytes());
        }
    }
}
