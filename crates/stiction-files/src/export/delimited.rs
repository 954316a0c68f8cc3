//! Text to a table: cell separator, comment lines, names, units, and the first row.

use super::cell::{Cell, Rows, Table, Take};
use super::names::is_time;
use super::stamp::Stamp;
use super::zone::Said;
use super::{Decimal, ExportError, ReadOptions};
use crate::number::is_missing_word;

/// Rows examined to find the separator and the first rows.
const LOOKED_AT: usize = 200;
/// Cell separators by preference: a comma also occurs in numbers.
const DELIMITERS: [(u8, &str); 4] = [(b'\t', "tabs"), (b';', "semicolons"), (b'|', "bars"), (b',', "commas")];
/// Most rows between the names and the first row of values, such as units and descriptions.
const MOST_UNITS: usize = 4;

/// Rows above the last one that show whether it is cut.
const ROWS_ABOVE: usize = 60;

/// Remedy for numbers split at their decimal comma.
const BETWEEN_COMMAS: &str =
    "quote numbers with a decimal comma in a comma-separated file, or export with semicolons or tabs";

/// A row with its place.
struct Row {
    /// Line in the file, from 1.
    line: u64,
    /// Byte offset of its start.
    start: usize,
    cells: Vec<String>,
}

impl Row {
    /// Cells up to the last that is filled.
    fn width(&self) -> usize {
        width(self.cells.iter().map(String::as_str))
    }
}

fn width<'c>(cells: impl Iterator<Item = &'c str>) -> usize {
    cells.enumerate().filter(|(_, cell)| !cell.is_empty()).last().map_or(0, |(at, _)| at + 1)
}

fn is_remark(first: &str, delimiter: u8) -> bool {
    ["#", "//", "%", "!", "--"].iter().any(|mark| first.starts_with(mark))
        || (first.starts_with(';') && delimiter != b';')
}

fn reader(text: &str, delimiter: u8) -> ::csv::Reader<&[u8]> {
    ::csv::ReaderBuilder::new()
        .delimiter(delimiter)
        .has_headers(false)
        .flexible(true)
        .trim(::csv::Trim::All)
        .from_reader(text.as_bytes())
}

/// The first rows, without Excel's `sep=` line.
fn first_rows(text: &str, delimiter: u8) -> Vec<Row> {
    let row = |cells: ::csv::StringRecord| {
        let place = cells.position();
        let (line, start) = place.map_or((1, 0), |p| (p.line(), p.byte() as usize));
        Row { line, start, cells: cells.iter().map(str::to_owned).collect() }
    };
    let rows = reader(text, delimiter).into_records().map_while(Result::ok).take(LOOKED_AT).map(row);
    rows.filter(|row| row.width() > 0 && !(row.line == 1 && text.starts_with("sep="))).collect()
}

/// The most frequent number of cells per row, and the share of rows that have it.
fn regularity(rows: &[Row], delimiter: u8) -> (usize, f64) {
    let mut counts = std::collections::BTreeMap::new();
    let mut all = 0_usize;
    for row in rows.iter().filter(|row| !is_remark(&row.cells[0], delimiter)) {
        *counts.entry(row.cells.len()).or_insert(0_usize) += 1;
        all += 1;
    }
    let usual = counts.into_iter().max_by_key(|(cells, rows)| (*rows, *cells));
    usual.map_or((0, 0.0), |(cells, rows)| (cells, rows as f64 / all as f64))
}

/// The separator, the first rows, and their usual number of cells.
fn split(text: &str, wanted: Option<u8>) -> Result<(u8, Vec<Row>, usize), ExportError> {
    let of = |delimiter: u8| {
        let rows = first_rows(text, delimiter);
        let (cells, share) = regularity(&rows, delimiter);
        (delimiter, rows, cells, share)
    };
    // Excel's own hint.
    let hint = text.strip_prefix("sep=").and_then(|mark| mark.bytes().next());
    if let Some(delimiter) = wanted.or(hint) {
        let (delimiter, rows, cells, _) = of(delimiter);
        return Ok((delimiter, rows, cells));
    }
    let mut fits: Vec<_> = DELIMITERS.iter().map(|(d, _)| of(*d)).filter(|(_, _, cells, _)| *cells >= 2).collect();
    let plain = fits.iter().position(|(.., share)| *share >= 0.9);
    let best = plain.or_else(|| (0..fits.len()).max_by(|a, b| fits[*a].3.total_cmp(&fits[*b].3)));
    let Some(best) = best else {
        let (number, line) = text.lines().zip(1..).find(|(l, _)| !l.trim().is_empty()).map_or((1, ""), |(l, n)| (n, l));
        let seen: String = line.chars().take(60).collect();
        let text = format!("{seen:?} has no commas, semicolons, tabs or bars between cells");
        let remedy = "export a table with one row per time, or give the separator with --delimiter";
        return Err(ExportError::at(number, text, remedy));
    };
    let (delimiter, rows, cells, _) = fits.swap_remove(best);
    Ok((delimiter, rows, cells))
}

/// Whether a row has values: a time or a number.
fn is_values(row: &[String]) -> bool {
    row.iter().any(|cell| Stamp::read(cell).is_some())
}

/// The row of names among those above the first row of values: of those that fit, the first with a time, or the first.
fn head_of(kept: &[Row], first: usize, usual: usize) -> usize {
    // A row may end with a delimiter that the names lack, and the names with empty ones.
    let open_end = usize::from(kept[first].cells.last().is_some_and(String::is_empty));
    let full = |row: &Row| row.cells.len() + open_end >= usual && row.width() >= usual.min(2);
    let above = first - first.min(MOST_UNITS + 1)..first;
    let near = above.rev().take_while(|at| kept[*at].cells.len() + open_end >= usual);
    let found: Vec<usize> = near.filter(|at| full(&kept[*at])).collect();
    let exact = |at: &&usize| kept[**at].width() <= usual && kept[**at].cells.len() <= usual;
    let timed = |at: &&usize| kept[**at].cells.iter().any(|cell| is_time(cell));
    let best = found.iter().rev().filter(exact).find(timed).or_else(|| found.iter().rev().find(exact));
    best.or(found.last()).copied().unwrap_or(first)
}

/// Finds the table in a text.
///
/// # Errors
/// Nothing looks like a table, or its rows do not fit its names.
pub(super) fn table<'t>(text: &'t str, options: &ReadOptions) -> Result<Table<'t>, ExportError> {
    let (delimiter, rows, usual) = split(text, options.delimiter)?;
    let (text, warnings) =
        cut_end(text, delimiter, usual).map_or((text, Vec::new()), |(text, told)| (text, vec![told]));
    let name = DELIMITERS
        .iter()
        .find(|(d, _)| *d == delimiter)
        .map_or_else(|| format!("{:?} between cells", char::from(delimiter)), |(_, name)| (*name).to_owned());
    let (remarks, kept): (Vec<Row>, Vec<Row>) = rows.into_iter().partition(|row| is_remark(&row.cells[0], delimiter));
    let first = kept
        .iter()
        .position(|row| (usual.saturating_sub(1)..=usual).contains(&row.cells.len()) && is_values(&row.cells))
        .ok_or_else(|| {
            let line = kept.first().map_or(1, |row| row.line);
            ExportError::at(
                line,
                format!("no row of values found (with {name})"),
                "export rows with a time and numbers",
            )
        })?;
    let head = head_of(&kept, first, usual);
    if let Some(above) = first.checked_sub(1).map(|at| &kept[at]).filter(|_| head == first)
        && delimiter == b','
        && is_time(&above.cells[0])
    {
        let (cells, names) = (kept[first].cells.len(), above.cells.len());
        let text = format!("{cells} cells, but the header in line {} has {names}", above.line);
        return Err(ExportError::at(kept[first].line, text, BETWEEN_COMMAS));
    }
    let (names, line) =
        if head < first { (kept[head].cells.clone(), kept[head].line) } else { (Vec::new(), kept[first].line) };
    let mut words = vec![name];
    let above = remarks.iter().filter(|row| row.line < kept[first].line).chain(&kept[..head]);
    let said = above.map(|row| Said::by_line(row.line, &row.cells.join(", ")));
    let said = said.into_iter().find(|said| !said.says_nothing()).unwrap_or_default();
    let remarks = remarks.iter().filter(|row| row.line < kept[first].line).count();
    for (count, one) in [(remarks, "comment line"), (head, "title line")] {
        match count {
            0 => {}
            1 => words.push(format!("1 {one}")),
            n => words.push(format!("{n} {one}s")),
        }
    }
    let mut units = Vec::new();
    if names.is_empty() {
        words.push("no header".to_owned());
    } else if first > head + 1 {
        words.push(format!("units in line {}", kept[head + 1].line));
        units.clone_from(&kept[head + 1].cells);
    }
    let begin = &kept[first];
    let by_number = options.map.as_ref().is_some_and(super::Map::names_signals);
    let named = if names.is_empty() || by_number { names.len().max(usual) } else { kept[head].width() };
    let rows = TextRows {
        text: &text[begin.start..],
        before: begin.line - 1,
        delimiter,
        least: if names.is_empty() || by_number || kept[first..].iter().any(|row| row.cells.len() >= named) {
            0
        } else {
            named
        },
        columns: named,
        names: names.clone(),
        line,
    };
    if text[..text.len().min(1 << 16)].contains('"') {
        words.push("quotes".to_owned());
    }
    // Where commas separate cells, Excel and all others write the decimals behind a point.
    let decimal = (delimiter == b',').then_some(Decimal::Point);
    Ok(Table { names, line, units, words, decimal, warnings, said, ..Table::of(Box::new(rows)) })
}

/// The text without a last line that has no end and is shorter than the others, and a warning where it may be; `None` where the
/// last line ends.
fn cut_end(text: &str, delimiter: u8, usual: usize) -> Option<(&str, String)> {
    let at = text.rfind('\n').filter(|at| at + 1 < text.len())? + 1;
    let cells = |line: &str| reader(line, delimiter).into_records().next().and_then(Result::ok).unwrap_or_default();
    let (whole, last) = (&text[..at], cells(&text[at..]));
    let above: Vec<::csv::StringRecord> =
        whole.lines().rev().take(ROWS_ABOVE).map(cells).filter(|row| row.len() == usual).collect();
    let end = last.iter().next_back().unwrap_or_default();
    // A single cell that begins as those above it is no footer.
    let begins =
        |row: &::csv::StringRecord| end.len() > 3 && row.get(0).is_some_and(|cell| cell.get(..4) == end.get(..4));
    let is_short = match last.len() {
        1 => usual > 1 && above.iter().any(begins),
        n if n < usual => !text[at..].contains('"'),
        _ => is_cut(end, &above.iter().filter_map(|row| row.iter().next_back()).collect::<Vec<_>>()),
    };
    if is_short {
        return Some((whole, "the last line is cut short and left out".to_owned()));
    }
    Some((text, "the last line has no end: its last cell may be cut short".to_owned()))
}

/// Whether the last cell of a file is shorter than those above it can be: decimals and times of one length, or a known word.
fn is_cut(end: &str, above: &[&str]) -> bool {
    let decimals = |cell: &str| cell.rfind(['.', ',']).map_or(0, |at| cell.len() - at - 1);
    let is_number = |cell: &str| cell.bytes().all(|b| b.is_ascii_digit() || b"+-.,".contains(&b));
    let length = |cell: &str| if is_number(cell) { decimals(cell) } else { cell.len() };
    if above.len() < 3 || above.contains(&end) {
        return false;
    }
    let longer = above.iter().map(|cell| length(cell)).min().is_some_and(|least| length(end) < least);
    if is_number(end) || Stamp::read(above[0]).is_some() {
        longer
    } else {
        above.iter().any(|cell| cell.starts_with(end))
    }
}

struct TextRows<'t> {
    text: &'t str,
    /// Lines before the first row.
    before: u64,
    delimiter: u8,
    /// Columns with a name.
    columns: usize,
    /// Least cells of a row.
    least: usize,
    names: Vec<String>,
    /// Line of the names.
    line: u64,
}

impl Rows for TextRows<'_> {
    fn each(&self, take: &mut Take<'_>) -> Result<(), ExportError> {
        let mut reader = reader(self.text, self.delimiter);
        let mut row = ::csv::StringRecord::new();
        let read = |e: ::csv::Error| ExportError::at(0, e.to_string(), "repair the file");
        while reader.read_record(&mut row).map_err(read)? {
            let (at, start) = row.position().map_or((0, 0), |p| (p.line(), p.byte() as usize));
            let line = self.before + at;
            let raw = &self.text[start..(reader.position().byte() as usize).min(self.text.len())];
            if raw.contains('"') {
                check_quotes(raw, self.delimiter, self.columns)
                    .map_err(|what| ExportError::at(line, what, "correct the quotes in this line"))?;
            }
            if self.says_nothing(&row) {
                continue;
            }
            self.fits(&row, line)?;
            let cells: Vec<Cell<'_>> =
                row.iter().map(|c| if c.is_empty() { Cell::Empty } else { Cell::Text(c) }).collect();
            if !take(line, &cells)? {
                return Ok(());
            }
        }
        Ok(())
    }
}

impl TextRows<'_> {
    /// Empty lines, remarks, rules of dashes, the names once more, and the count of rows that SQL clients write.
    fn says_nothing(&self, row: &::csv::StringRecord) -> bool {
        let first = row.get(0).unwrap_or_default();
        let remark = || is_remark(first, self.delimiter) && Stamp::read(first).is_none() && !is_missing_word(first);
        let again = || !self.names.is_empty() && row.iter().eq(self.names.iter().map(String::as_str));
        let count = || {
            let text = first.trim_start_matches('(').trim_end_matches(')').to_lowercase();
            let (number, rest) = text.split_once(' ').unwrap_or_default();
            first.starts_with('(') && number.bytes().all(|b| b.is_ascii_digit()) && rest.starts_with("row")
        };
        let filled = width(row.iter());
        filled == 0 || remark() || again() || (filled == 1 && count())
    }

    /// Whether the cells fit the names.
    fn fits(&self, row: &::csv::StringRecord, line: u64) -> Result<(), ExportError> {
        let filled = width(row.iter());
        let named = self.columns;
        if filled > named {
            let what = format!("{filled} cells, but the header in line {} names {named} columns", self.line);
            let remedy = if self.delimiter == b',' { BETWEEN_COMMAS } else { "remove the extra cells, or quote them" };
            return Err(ExportError::at(line, what, remedy));
        }
        if filled == 1 && named > 1 && row.len() == 1 && Stamp::read(&row[0]).is_none() && !is_missing_word(&row[0]) {
            let seen: String = row[0].chars().take(40).collect();
            return Err(ExportError::at(line, format!("{seen:?} is no row of the table"), "remove this line"));
        }
        if row.len() < self.least {
            let what = format!("{} cells, but the header in line {} names {named} columns", row.len(), self.line);
            let remedy = "quote names that contain the separator, or name the columns by number: --map t=1,op=2,pv=3";
            return Err(ExportError::at(line, what, remedy));
        }
        Ok(())
    }
}

/// Whether the quotes of a row are those of RFC 4180, and none has swallowed other rows.
fn check_quotes(raw: &str, delimiter: u8, columns: usize) -> Result<(), &'static str> {
    let bytes = raw.as_bytes();
    let find = |from: usize, what: u8| bytes[from..].iter().position(|b| *b == what).map(|at| from + at);
    let mut at = 0;
    while at < bytes.len() {
        if bytes[at] == b'"' {
            loop {
                at = find(at + 1, b'"').ok_or("a quote opens here and never closes")?;
                if bytes.get(at + 1) != Some(&b'"') {
                    break;
                }
                at += 1;
            }
            at += 1 + bytes[at + 1..].iter().take_while(|b| **b == b' ').count();
            if bytes.get(at).is_some_and(|b| *b != delimiter && *b != b'\n') {
                return Err("a quote in this line closes inside a cell");
            }
        }
        at = find(at, delimiter).map_or(bytes.len(), |end| end + 1);
    }
    let inner = |line: &str| line.bytes().filter(|b| *b == delimiter).count() + 1 >= columns.max(2);
    if raw.trim_end().lines().skip(1).any(inner) {
        return Err("a quote that opens here has swallowed the next lines");
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(text: &str) -> (Vec<String>, Vec<String>, u64) {
        let table = table(text, &ReadOptions::default()).unwrap();
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
        let none = table("just words\nand more\n", &ReadOptions::default());
        assert!(none.is_err_and(|e| e.to_string().contains("--delimiter")));
        // Campbell's TOA5 has a title of more cells than the table.
        let (names, words, first) = found(
            "\"TOA5\",\"s\",\"CR\",\"1\",\"2\",\"x\"\n\"TIMESTAMP\",\"A.OP\",\"A.PV\"\n\"TS\",\"%\",\"C\"\n\"\",\"Smp\",\"Smp\"\n\"2026-01-05 08:00:00\",1,2\n\"2026-01-05 08:00:01\",1,2\n",
        );
        assert_eq!((names[0].as_str(), first), ("TIMESTAMP", 5), "{words:?}");
    }

    fn rows(text: &str) -> Result<usize, String> {
        let told = |e: ExportError| e.to_string();
        let table = table(text, &ReadOptions::default()).map_err(told)?;
        let mut count = 0;
        table
            .rows
            .each(&mut |_, _| {
                count += 1;
                Ok(true)
            })
            .map_err(told)?;
        Ok(count)
    }

    #[test]
    fn rows_that_are_none_are_passed_over_and_rows_that_do_not_fit_are_refused() {
        let body = |k: usize| format!("2026-01-05T08:00:{k:02}Z,{k},2\n");
        let five: String = (0..5).map(body).collect();
        for (text, count) in [
            (format!("Time,A.OP,A.PV\n{five}Time,A.OP,A.PV\n{five}"), 10),
            (format!("Time,A.OP,A.PV\n----,----,----\n{five}\n(5 rows affected)\n"), 5),
            (format!("Time,A.OP,A.PV,\n{five}"), 5),
            (format!("Time,A.OP,A.PV,note\n{}", five.replace(",2\n", ",2,\"two\nlines\"\n")), 5),
        ] {
            assert_eq!(rows(&text), Ok(count), "{text}");
        }
        assert_eq!(rows(&format!("Time,A.OP,A.PV\n{five}2026-01-05T08:00:05Z,4")), Ok(5));
        for (text, part) in [
            (format!("Time,A.OP,A.PV\n{five}end of report\n"), "line 7: \"end of report\" is no row"),
            (format!("Time,Area 4, A.OP,Area 4, A.PV\n{five}"), "line 2: 3 cells"),
            (format!("Time,A.OP,A.PV,,\n{}", five.replace(",2\n", ",5,2,5\n")), "line 2: 5 cells"),
            (
                format!("Time,A.OP,A.PV\n{five}").replace("02Z,2", "02Z,\"2"),
                "line 4: a quote opens here and never closes",
            ),
            (
                format!("Time,A.OP,A.PV\n{five}").replace("01Z,1,2", "01Z,\"1,2").replace("03Z,3,2", "03Z,3,2\""),
                "line 3: a quote that opens here has swallowed",
            ),
            (format!("Time,A.OP,A.PV\n{five}").replace("02Z,2", "02Z,\"2\"5"), "line 4: a quote in this line"),
        ] {
            let told = rows(&text).unwrap_err();
            assert!(told.contains(part), "{text}: {told}");
        }
    }
}
