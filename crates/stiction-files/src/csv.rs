//! Writes tables `t,op,pv[,sp][,mv][,mode][,op_unit][,pv_unit]`: `t` in seconds since 1970. They are read like other tables, see `export`.
//!
//! An empty or non-finite cell of OP or PV is a missing sample. In the other columns an empty cell is no sample, because set
//! points and modes are often written on change only; likewise for OP and PV in a table where they are in separate rows,
//! each with its own timestamps. Writing joins samples of equal timestamps into rows and changes nothing else, so a table
//! that was read is written with equal values. A table with the newest row first is sorted, with a warning.

use std::collections::HashMap;
use std::io::{self, Write};
use stiction::core::record::{Sample, Signal, Value};
use stiction::core::units::format_seconds;
use stiction::samples::align::Quality;

use super::LoadedLoop;

/// Columns after `t` in the order of writing.
pub const COLUMNS: [Signal; 5] = [Signal::Op, Signal::Pv, Signal::Sp, Signal::Mv, Signal::Mode];

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
/// columns if the loop has such samples; the first row carries the units of OP and PV in columns of their own. A cell is
/// empty if there is no sample, and where a row has OP and PV, if its value is missing or of bad quality; elsewhere, and
/// where empty cells would read otherwise, such a value is `nan`.
///
/// # Errors
/// Error of the writer.
pub fn write(one: &LoadedLoop, out: &mut impl Write) -> io::Result<usize> {
    let samples = one.judged(Quality::Ua).samples;
    let has = |signal: Signal| samples.iter().any(|s| s.signal == signal);
    let shown: Vec<usize> = (0..COLUMNS.len()).filter(|c| *c < 2 || has(COLUMNS[*c])).collect();
    write!(out, "t")?;
    shown.iter().try_for_each(|column| write!(out, ",{}", COLUMNS[*column].name()))?;
    let units = || one.units.iter().enumerate().filter_map(|(at, unit)| Some((at, unit.as_ref()?)));
    units().try_for_each(|(at, _)| write!(out, ",{}_unit", COLUMNS[at].name()))?;
    writeln!(out)?;
    let rows = rows_of(&samples);
    let whole = rows.iter().all(|row| row.cells[0].is_some() == row.cells[1].is_some());
    // Empty cells would read as OP and PV in rows of their own.
    let only = |a: usize, b: usize| {
        let has = |row: &Row, at: usize| row.cells[at].is_some_and(|value| value != Value::Missing);
        rows.iter().filter(|row| has(row, a) && (a == b || !has(row, b))).count()
    };
    let whole = whole && only(0, 1).min(only(1, 0)) <= only(0, 0) - only(0, 1);
    for (at, row) in rows.iter().enumerate() {
        write!(out, "{}", format_seconds(row.t_ns))?;
        for column in &shown {
            match row.cells[*column] {
                Some(Value::Number(number)) if number.is_finite() => write!(out, ",{number}")?,
                Some(Value::Mode(mode)) => write!(out, ",{}", mode.name())?,
                Some(_) if *column > 1 || !whole => write!(out, ",nan")?,
                _ => write!(out, ",")?,
            }
        }
        for (_, unit) in units() {
            let unit = if at == 0 { unit.replace([',', '"', '\n'], " ") } else { String::new() };
            write!(out, ",{unit}")?;
        }
        writeln!(out)?;
    }
    Ok(rows.len())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    use crate::export::ReadOptions;
    use crate::{FileError, Loaded};

    struct Table {
        samples: Vec<Sample>,
        warnings: Vec<String>,
        missing: usize,
    }

    fn read(text: &[u8]) -> Result<Loaded, FileError> {
        let file = tempfile::Builder::new().suffix(".csv").tempfile().unwrap();
        std::fs::write(file.path(), text).unwrap();
        // Bits of any kind make numbers as loggers write them for none.
        crate::load(file.path(), &ReadOptions { missing: vec!["none".to_owned()], ..ReadOptions::default() })
    }

    fn table(text: &str) -> Table {
        let Loaded { mut loops, warnings, .. } = read(text.as_bytes()).unwrap_or_else(|e| panic!("{text:?}: {e}"));
        let samples = loops.remove(0).samples;
        let missing = samples.iter().filter(|s| s.value == Value::Missing).count();
        Table { samples, warnings, missing }
    }

    fn written(samples: &[Sample]) -> String {
        let mut out = Vec::new();
        write(&LoadedLoop::new("a", samples.to_vec()), &mut out).unwrap();
        String::from_utf8(out).unwrap()
    }

    #[test]
    fn columns_stand_in_any_order() {
        let text = "\u{feff}PV , T,Mode,op,note\r\n1.5,0,AUTO,2,x\r\n,1577836800,3,nan,\r\n\r\n";
        let table = table(text);
        assert_eq!((table.samples.len(), table.missing), (6, 2));
        assert!(table.warnings.iter().any(|w| w.contains("ignored") && w.contains("note")), "{:?}", table.warnings);
        assert_eq!(written(&table.samples), "t,op,pv,mode\n0,2,1.5,auto\n1577836800,,,3\n");
    }

    #[test]
    fn faults_name_line_and_remedy() {
        for (text, part) in [
            ("t,op,pv\n0,1,2\nabc,1,2\n", "line 3"),
            ("t,op,pv\n0,1,2\n,1,2\n", "line 3"),
            ("t,op\n0,1\n", "only one signal"),
            ("t,op,pv,OP\n0,1,2,3\n", "twice"),
            ("t,op,pv\n0,1,5,2,5\n", "line 2: 5 cells"),
            ("t,op,pv\n0,Bad,1\n1,Bad,2\n", "no number in any row"),
            ("t,op,pv\n0,Open,1\n1,2,2\n", "line 2: \"op\" contains \"Open\""),
            ("t,op,pv\n0,1,\"1,000\"\n", "--decimal"),
        ] {
            let error = read(text.as_bytes()).unwrap_err().to_string();
            assert!(error.contains(part), "{text:?}: {error}");
        }
    }

    #[test]
    fn quoted_thousands_are_numbers_where_they_have_one_reading() {
        let read = table("t,op,pv\n0,\"1,234.5\",\"-1,150.10\"\n1,\"1,234,567\",2\n");
        let values: Vec<Option<f64>> = read.samples.iter().map(|s| s.value.as_number()).collect();
        assert_eq!(values, [Some(1234.5), Some(-1150.1), Some(1_234_567.0), Some(2.0)]);
    }

    #[test]
    fn bad_quality_is_an_empty_cell_and_units_stand_in_the_first_row() {
        let sample = |signal, t_ns, v, quality| Sample { signal, t_ns, value: Value::Number(v), quality };
        let samples = [
            sample(Signal::Op, 0, 1.0, Some(0)),
            sample(Signal::Pv, 0, 0.0, Some(0x8000_0000)),
            sample(Signal::Sp, 0, 5.0, Some(0x8000_0000)),
        ];
        let one = LoadedLoop { units: [None, Some("bar".to_owned())], ..LoadedLoop::new("a", samples.to_vec()) };
        let mut out = Vec::new();
        write(&one, &mut out).unwrap();
        assert_eq!(String::from_utf8_lossy(&out), "t,op,pv,sp,pv_unit\n0,1,,nan,bar\n");
        let back = read(&out).unwrap().loops.remove(0);
        assert_eq!((back.units, back.samples.len()), (one.units, 3));
        assert_eq!(back.samples[2].value, Value::Missing);
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
        let set_back: Vec<String> = (0..600).map(|k| format!("{},{k},1", k - 200 * (k / 400))).collect();
        assert!(table(&format!("t,op,pv\n{}\n", set_back.join("\n"))).warnings.is_empty());
        let shuffled: Vec<&str> = (0..600).map(|k| rows[k * 251 % 600].as_str()).collect();
        assert_eq!(table(&format!("t,op,pv\n{}\n", shuffled.join("\n"))).samples, forward.samples);
    }

    proptest! {
        #[test]
        fn what_is_written_reads_back_equal(
            rows in proptest::collection::vec((-1_000_000_000_000_000_000..1_700_000_000_000_000_000_i64, any::<u64>(), any::<u64>(), any::<Option<u64>>()), 1..40)
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
            let _ = read(text.as_bytes());
            let _ = read(format!("t,op,pv\n{text}").as_bytes());
        }
    }
}
