//! Workbooks: every sheet that holds a table, or the one that was asked for.

use std::io::Cursor;

use calamine::{Data, ExcelDateTime, Reader as _, open_workbook_auto_from_rs};
use jiff::tz::Offset;

use super::cell::{Cell, Rows, Table, Take};
use super::stamp::Stamp;
use super::{Contents, ExportError, ReadOptions, contents_of};

/// Rows above a table, at most.
const MOST_ABOVE: usize = 50;

struct Sheet {
    rows: Vec<Vec<Data>>,
    /// Row of the first values.
    first: usize,
    /// Row of the sheet that `rows` begin with.
    above: u64,
}

/// Reads the tables of a workbook.
///
/// # Errors
/// It is no workbook, the sheet is not there, or no sheet holds a table.
pub(super) fn read(bytes: &[u8], stem: &str, options: &ReadOptions) -> Result<Contents, ExportError> {
    let no_book = |e: calamine::Error| {
        ExportError::at(0, format!("no workbook that can be read: {e}"), "save it as .xlsx or .csv")
    };
    let mut book = open_workbook_auto_from_rs(Cursor::new(bytes)).map_err(no_book)?;
    let names = book.sheet_names();
    let wanted: Vec<String> = match &options.sheet {
        None => names,
        Some(one) if names.contains(one) => vec![one.clone()],
        Some(one) => {
            let text = format!("no sheet {one:?}; there are {}", super::columns::listed(&names));
            return Err(ExportError::at(0, text, "say one of these by --sheet"));
        }
    };
    let mut all = Contents::default();
    let (mut read, mut first_fault) = (0, None);
    let several = wanted.len() > 1;
    for name in &wanted {
        let range = match book.worksheet_range(name) {
            Ok(range) => range,
            Err(error) => {
                first_fault.get_or_insert(no_book(error));
                continue;
            }
        };
        let above = range.start().map_or(0, |(row, _)| u64::from(row));
        let rows: Vec<Vec<Data>> = range.rows().map(<[Data]>::to_vec).collect();
        let Some(sheet) = Sheet::of(rows, above) else { continue };
        let table = sheet.table(name);
        match contents_of(&table, if several { name } else { stem }, options) {
            Ok(contents) => {
                read += 1;
                all.add(contents, if several { name } else { stem });
            }
            Err(fault) => {
                let what = format!("sheet {name:?}: {}", fault.what);
                first_fault.get_or_insert(ExportError { what, ..fault });
            }
        }
    }
    match (read, first_fault) {
        (0, Some(fault)) => Err(fault),
        (0, None) => Err(ExportError::at(0, "no sheet holds rows with a time and numbers", "export such a table")),
        (_, Some(fault)) if !several => Err(fault),
        (_, Some(fault)) => {
            all.warnings.push(format!("not read: {fault}"));
            Ok(all)
        }
        _ => Ok(all),
    }
}

impl Contents {
    /// Takes in another sheet; its nameless loop is called after it.
    fn add(&mut self, mut other: Self, sheet: &str) {
        for series in other.series.iter_mut().filter(|s| s.role.loop_name.is_empty()) {
            series.role.loop_name = crate::units::loop_name_from(sheet);
        }
        if self.words.is_empty() {
            self.words = other.words;
        }
        self.counts.append(&mut other.counts);
        self.series.append(&mut other.series);
        self.warnings.append(&mut other.warnings);
        self.ignored.append(&mut other.ignored);
    }
}

fn filled(row: &[Data]) -> usize {
    row.iter().filter(|c| !matches!(c, Data::Empty)).count()
}

impl Sheet {
    fn of(rows: Vec<Vec<Data>>, above: u64) -> Option<Self> {
        let value = |cell: &Data| match cell {
            Data::Int(_) | Data::Float(_) | Data::DateTime(_) | Data::DateTimeIso(_) => true,
            Data::String(text) => Stamp::read(text).is_some_and(Stamp::is_dated),
            _ => false,
        };
        let is_values = |row: &Vec<Data>| filled(row) >= 2 && row.iter().any(value);
        let first = rows.iter().take(MOST_ABOVE).position(is_values)?;
        Some(Self { rows, first, above })
    }

    fn table(&self, name: &str) -> Table<'_> {
        let mut head = self.first;
        while head > 0 && filled(&self.rows[head - 1]) >= 2 {
            head -= 1;
        }
        let mut words = vec![format!("sheet {name:?}")];
        let names: Vec<String> = if head < self.first {
            self.rows[head].iter().map(|c| c.to_string().trim().to_owned()).collect()
        } else {
            words.push("no header".to_owned());
            Vec::new()
        };
        if self.first > head + 1 {
            words.push(format!("units in row {}", self.above + head as u64 + 2));
        }
        Table { names, line: self.above + head as u64 + 1, rows: Box::new(SheetRows(self)), words }
    }
}

struct SheetRows<'s>(&'s Sheet);

impl Rows for SheetRows<'_> {
    fn each(&self, take: &mut Take<'_>) -> Result<(), ExportError> {
        for (at, row) in self.0.rows.iter().enumerate().skip(self.0.first).filter(|(_, row)| filled(row) > 0) {
            let errors: Vec<String> =
                row.iter().map(|c| if let Data::Error(e) = c { e.to_string() } else { String::new() }).collect();
            let cells: Vec<Cell<'_>> = row.iter().zip(&errors).map(|(c, error)| cell(c, error)).collect();
            if !take(self.0.above + at as u64 + 1, &cells)? {
                break;
            }
        }
        Ok(())
    }
}

fn cell<'c>(data: &'c Data, error: &'c str) -> Cell<'c> {
    match data {
        Data::Empty => Cell::Empty,
        Data::Int(v) => Cell::Integer(*v),
        Data::Float(v) => Cell::Number(*v),
        Data::Bool(v) => Cell::Text(if *v { "true" } else { "false" }),
        Data::DateTime(when) => local(when).map_or(Cell::Number(when.as_f64()), Cell::Local),
        Data::Error(_) => Cell::Text(error),
        other => match other.as_text() {
            Some("") | None => Cell::Empty,
            Some(text) => Cell::Text(text),
        },
    }
}

trait AsText {
    fn as_text(&self) -> Option<&str>;
}

impl AsText for Data {
    fn as_text(&self) -> Option<&str> {
        match self {
            Self::String(text) | Self::DateTimeIso(text) | Self::DurationIso(text) => Some(text.trim()),
            _ => None,
        }
    }
}

/// A date of the sheet, ns as if it were UTC. Excel keeps milliseconds.
fn local(when: &ExcelDateTime) -> Option<i64> {
    if !when.is_datetime() {
        return None;
    }
    let (year, month, day, hour, minute, second, milli) = when.to_ymd_hms_milli();
    let signed = |v: u8| i8::try_from(v).ok();
    let day = jiff::civil::Date::new(i16::try_from(year).ok()?, signed(month)?, signed(day)?).ok()?;
    let stamp = day.at(signed(hour)?, signed(minute)?, signed(second)?, i32::from(milli) * 1_000_000);
    i64::try_from(Offset::UTC.to_timestamp(stamp).ok()?.as_nanosecond()).ok()
}
