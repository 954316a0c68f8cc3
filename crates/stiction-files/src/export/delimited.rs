//! Text to a table: cell separator, comment lines, names, units, and the first row.

use super::ExportError;
use super::cell::{Cell, Rows, Table, Take};
use super::names::is_time;
use super::stamp::Stamp;
use crate::number::is_missing_word;

/// Lines examined to find the separator and the first rows.
const LOOKED_AT: usize = 200;
/// Cell separators by preference: a comma also occurs in numbers.
const DELIMITERS: [(u8, &str); 4] = [(b'\t', "tabs"), (b';', "semicolons"), (b'|', "bars"), (b',', "commas")];
/// Most rows between the names and the first row of values, such as units and descriptions.
const MOST_UNITS: usize = 4;

/// Remedy for numbers split at their decimal comma.
const BETWEEN_COMMAS: &str =
    "quote numbers with a decimal comma in a comma-separated file, or export with semicolons or tabs";

/// A line of a text.
#[derive(Clone, Copy)]
struct Line<'t> {
    /// From 1.
    number: u64,
    /// Byte offset of its start.
    start: usize,
    text: &'t str,
}

fn is_remark(line: &str, delimiter: Option<u8>) -> bool {
    let line = line.trim_start_matches('"').trim_start();
    ["#", "//", "%", "!", "--"].iter().any(|mark| line.starts_with(mark))
        || (line.starts_with(';') && delimiter.is_some_and(|d| d != b';'))
}

fn first_lines(text: &str) -> Vec<Line<'_>> {
    let mut start = 0;
    let lines = text.split_inclusive('\n').enumerate().map(|(at, raw)| {
        let line = Line { number: at as u64 + 1, start, text: raw.trim_end_matches(['\n', '\r']) };
        start += raw.len();
        line
    });
    lines.take(LOOKED_AT).collect()
}

/// Cells of one line.
fn cells(line: &str, delimiter: u8) -> Vec<String> {
    let mut reader = reader(line, delimiter);
    let mut row = ::csv::StringRecord::new();
    // One line of valid text cannot fail.
    let _ = reader.read_record(&mut row);
    row.iter().map(str::to_owned).collect()
}

fn reader(text: &str, delimiter: u8) -> ::csv::Reader<&[u8]> {
    ::csv::ReaderBuilder::new()
        .delimiter(delimiter)
        .has_headers(false)
        .flexible(true)
        .trim(::csv::Trim::All)
        .from_reader(text.as_bytes())
}

/// The most frequent number of cells per line, and the share of lines that have it.
fn regularity(lines: &[Line<'_>], delimiter: u8) -> (usize, f64) {
    let mut counts = std::collections::BTreeMap::new();
    let kept = lines.iter().filter(|l| !l.text.trim().is_empty() && !is_remark(l.text, Some(delimiter)));
    let mut all = 0_usize;
    for line in kept {
        *counts.entry(cells(line.text, delimiter).len()).or_insert(0_usize) += 1;
        all += 1;
    }
    let usual = counts.into_iter().max_by_key(|(cells, lines)| (*lines, *cells));
    usual.map_or((0, 0.0), |(cells, lines)| (cells, lines as f64 / all as f64))
}

fn delimiter_of(lines: &[Line<'_>]) -> Result<(u8, usize), ExportError> {
    // Excel's own hint.
    if let Some(mark) = lines.first().and_then(|l| l.text.trim().strip_prefix("sep=")).and_then(|m| m.bytes().next()) {
        return Ok((mark, regularity(&lines[1..], mark).0));
    }
    let fits: Vec<(u8, usize, f64)> = DELIMITERS
        .iter()
        .map(|(d, _)| (*d, regularity(lines, *d)))
        .filter(|(_, (cells, _))| *cells >= 2)
        .map(|(d, (cells, share))| (d, cells, share))
        .collect();
    let plain = fits.iter().find(|(_, _, share)| *share >= 0.9);
    let best = plain.or_else(|| fits.iter().max_by(|a, b| a.2.total_cmp(&b.2)));
    best.map(|(d, cells, _)| (*d, *cells)).ok_or_else(|| {
        let line = lines.iter().find(|l| !l.text.trim().is_empty());
        let (number, seen) = line.map_or((1, String::new()), |l| (l.number, l.text.chars().take(60).collect()));
        let text = format!("{seen:?} has no commas, semicolons, tabs or bars between cells");
        ExportError::at(number, text, "export a table with one row per time, or give the separator with --delimiter")
    })
}

/// Whether a row has values: a time, a number, or a word for a missing value after a time.
fn is_values(row: &[String]) -> bool {
    row.iter().any(|cell| match Stamp::read(cell) {
        Some(Stamp::Number(_)) => true,
        Some(Stamp::Civil(civil)) => super::stamp::Order::ALL.iter().any(|o| civil.date(*o).is_some()),
        _ => false,
    })
}

/// Finds the table in a text.
///
/// # Errors
/// Nothing looks like a table.
pub(super) fn table(text: &str, wanted: Option<u8>) -> Result<Table<'_>, ExportError> {
    let lines = first_lines(text);
    let (delimiter, usual) = match wanted {
        Some(delimiter) => (delimiter, regularity(&lines, delimiter).0),
        None => delimiter_of(&lines)?,
    };
    let name = DELIMITERS
        .iter()
        .find(|(d, _)| *d == delimiter)
        .map_or_else(|| format!("{:?} between cells", char::from(delimiter)), |(_, name)| (*name).to_owned());
    let mut words = vec![name];
    let hint = lines.first().is_some_and(|l| l.text.starts_with("sep="));
    let remark = |l: &Line<'_>| is_remark(l.text, Some(delimiter)) || (hint && l.number == 1);
    let kept: Vec<(Line<'_>, Vec<String>)> = lines
        .iter()
        .filter(|l| !l.text.trim().is_empty() && !remark(l))
        .map(|l| (*l, cells(l.text, delimiter)))
        .collect();
    let remarks = lines.iter().filter(|l| remark(l) && !l.text.starts_with("sep=")).count();
    let first = kept.iter().position(|(_, row)| row.len() + 1 >= usual && is_values(row)).ok_or_else(|| {
        let line = kept.first().map_or(1, |(l, _)| l.number);
        ExportError::at(
            line,
            format!("no row of values found (with {})", words[0]),
            "export rows with a time and numbers",
        )
    })?;
    // A header may lack what rows have at their end: a delimiter with nothing behind it.
    let open_end = usize::from(kept[first].1.last().is_some_and(String::is_empty));
    let full = |row: &[String]| row.len() + open_end >= usual;
    let named = |row: &[String]| row.iter().filter(|c| !c.is_empty()).count() >= usual.min(2);
    let mut head = first;
    while head > 0 && first - head <= MOST_UNITS && full(&kept[head - 1].1) {
        head -= 1;
    }
    // A title that fills its line with delimiters names no columns.
    while head < first && !named(&kept[head].1) {
        head += 1;
    }
    if let Some((line, above)) = first.checked_sub(1).map(|at| &kept[at]).filter(|_| head == first)
        && delimiter == b','
        && is_time(&above[0])
    {
        let (cells, names) = (kept[first].1.len(), above.len());
        let text = format!("{cells} cells, but the header in line {} has {names}", line.number);
        return Err(ExportError::at(kept[first].0.number, text, BETWEEN_COMMAS));
    }
    let titles = head;
    let (names, line) =
        if head < first { (kept[head].1.clone(), kept[head].0.number) } else { (Vec::new(), kept[first].0.number) };
    for (count, one, many) in [(remarks, "1 comment line", "comment lines"), (titles, "1 title line", "title lines")] {
        match count {
            0 => {}
            1 => words.push(one.to_owned()),
            n => words.push(format!("{n} {many}")),
        }
    }
    let mut units = Vec::new();
    if names.is_empty() {
        words.push("no header".to_owned());
    } else if first > head + 1 {
        words.push(format!("units in line {}", kept[head + 1].0.number));
        units.clone_from(&kept[head + 1].1);
    }
    let begin = kept[first].0;
    let columns = if names.is_empty() { usual } else { names.len() };
    let rows = TextRows { text: &text[begin.start..], before: begin.number - 1, delimiter, columns };
    if text[..text.len().min(1 << 16)].contains('"') {
        words.push("quotes".to_owned());
    }
    Ok(Table { names, line, rows: Box::new(rows), units, words })
}

struct TextRows<'t> {
    text: &'t str,
    /// Lines before the first row.
    before: u64,
    delimiter: u8,
    columns: usize,
}

impl Rows for TextRows<'_> {
    fn each(&self, take: &mut Take<'_>) -> Result<(), ExportError> {
        let mut reader = reader(self.text, self.delimiter);
        let mut row = ::csv::StringRecord::new();
        let read = |e: ::csv::Error| ExportError::at(0, e.to_string(), "repair the file");
        while reader.read_record(&mut row).map_err(read)? {
            let line = self.before + row.position().map_or(0, ::csv::Position::line);
            let first = row.get(0).unwrap_or_default();
            if row.iter().all(str::is_empty)
                || is_remark(first, Some(self.delimiter)) && Stamp::read(first).is_none() && !is_missing_word(first)
            {
                continue;
            }
            if row.len() > self.columns && row.iter().skip(self.columns).any(|cell| !cell.is_empty()) {
                let text = format!("{} cells, but earlier lines have {}", row.len(), self.columns);
                let remedy =
                    if self.delimiter == b',' { BETWEEN_COMMAS } else { "remove the extra cells, or quote them" };
                return Err(ExportError::at(line, text, remedy));
            }
            let cells: Vec<Cell<'_>> =
                row.iter().map(|c| if c.is_empty() { Cell::Empty } else { Cell::Text(c) }).collect();
            if !take(line, &cells)? {
                return Ok(());
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(text: &str) -> (Vec<String>, Vec<String>, u64) {
        let table = table(text, None).unwrap();
        let mut first = 0;
        table
            .rows
            .each(&mut |line, _| {
                first = line;
                Ok(false)
            })
            .unwrap();
        (table.names, table.words, first)
    }

    #[test]
    fn delimiters_names_and_remarks_are_told() {
        let (names, words, first) = found(
            "Report of June\n# made by x\nZeit;A.OP;A.PV\n;%;m3/h\n05.01.2026 08:00;50,1;20,2\n05.01.2026 08:01;50,2;20,3\n",
        );
        assert_eq!((names.len(), names[1].as_str(), first), (3, "A.OP", 5));
        assert_eq!(words, ["semicolons", "1 comment line", "1 title line", "units in line 4"]);
        let (names, words, _) = found("2026-01-05T08:00:00Z\t1\t2\n2026-01-05T08:00:01Z\t1\t2\n");
        assert!(names.is_empty() && words == ["tabs", "no header"], "{words:?}");
        let (names, words, _) = found("sep=;\nt;op;pv\n0;1,5;2,5\n1;1,5;2,5\n");
        assert_eq!((names.len(), words[0].as_str()), (3, "semicolons"));
        assert!(table("just words\nand more\n", None).is_err_and(|e| e.to_string().contains("--delimiter")));
    }
}
