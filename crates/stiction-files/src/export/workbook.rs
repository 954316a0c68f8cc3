//! Workbooks: every sheet with a table, or the requested one.

use std::io::Cursor;

use calamine::{Data, ExcelDateTime, Reader as _, Xlsx, XlsxError};

use super::cell::{Cell, Rows, Table, Take};
use super::stamp::{Stamp, local_ns};
use super::zone::Said;
use super::{Contents, ExportError, ReadOptions, contents_of, guarded};

/// Most rows above a table.
const MOST_ABOVE: usize = 50;
/// Most cells of a sheet, counting empty ones before filled ones: a few bytes can name a cell at the sheet's far end.
const MOST_CELLS: usize = 50_000_000;

struct Sheet {
    /// Row numbers, from 1, and their cells.
    rows: Vec<(u64, Vec<Data>)>,
    /// Index of the first row of values.
    first: usize,
}

/// Reads the tables of a workbook.
///
/// # Errors
/// Not a workbook, no such sheet, or no sheet with a table.
pub(super) fn read(bytes: &[u8], stem: &str, options: &ReadOptions) -> Result<Contents, ExportError> {
    guarded(|| sheets(bytes, stem, options))
}

fn no_book(error: impl std::fmt::Display) -> ExportError {
    ExportError::at(0, format!("cannot read the workbook: {error}"), "save it as .xlsx or .csv")
}

/// The cells of a sheet, row by row.
fn rows_of(book: &mut Xlsx<Cursor<&[u8]>>, name: &str) -> Result<Vec<(u64, Vec<Data>)>, ExportError> {
    let mut cells = book.worksheet_cells_reader(name).map_err(no_book)?;
    let mut rows: Vec<(u64, Vec<Data>)> = Vec::new();
    let mut count = 0;
    while let Some(cell) = cells.next_cell().map_err(|e: XlsxError| no_book(e))? {
        let (row, column) = cell.get_position();
        let (row, column) = (u64::from(row) + 1, column as usize);
        if rows.last().is_none_or(|(last, _)| *last != row) {
            rows.push((row, Vec::new()));
        }
        let Some((_, own)) = rows.last_mut() else { continue };
        count += (column + 1).saturating_sub(own.len());
        if count > MOST_CELLS {
            return Err(ExportError::at(
                row,
                format!("sheet {name:?} has more than {MOST_CELLS} cells"),
                "save it as .csv",
            ));
        }
        if own.len() <= column {
            own.resize(column + 1, Data::Empty);
        }
        own[column] = cell.get_value().clone().into();
    }
    Ok(rows)
}

fn sheets(bytes: &[u8], stem: &str, options: &ReadOptions) -> Result<Contents, ExportError> {
    let mut book: Xlsx<Cursor<&[u8]>> = Xlsx::new(Cursor::new(bytes)).map_err(|e: XlsxError| no_book(e))?;
    let names = book.sheet_names();
    let wanted: Vec<String> = match &options.sheet {
        None => names,
        Some(one) if names.contains(one) => vec![one.clone()],
        Some(one) => {
            let text = format!("there is no sheet {one:?} among {}", super::columns::listed(&names));
            return Err(ExportError::at(0, text, "name one of these with --sheet"));
        }
    };
    let mut all = Contents::default();
    let (mut read, mut first_fault) = (0, None);
    let several = wanted.len() > 1;
    for name in &wanted {
        let rows = match rows_of(&mut book, name) {
            Ok(rows) => rows,
            Err(fault) => {
                first_fault.get_or_insert(fault);
                continue;
            }
        };
        let Some(sheet) = Sheet::of(rows) else { continue };
        let table = Table { since_1904: book.has_1904_epoch(), ..sheet.table(name) };
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
        (0, None) => Err(ExportError::at(
            0,
            "no sheet holds rows with a time and numbers",
            "export a table with a time column and a column per signal",
        )),
        (_, Some(fault)) if !several => Err(fault),
        (_, Some(fault)) => {
            all.warnings.push(format!("not read: {fault}"));
            Ok(all)
        }
        _ => Ok(all),
    }
}

impl Contents {
    /// Adds another sheet; its unnamed loop gets the sheet's name.
    fn add(&mut self, mut other: Self, sheet: &str) {
        for series in other.series.iter_mut().filter(|s| s.role.loop_name.is_empty()) {
            series.role.loop_name = stiction::core::units::loop_name_from(sheet);
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
    fn of(rows: Vec<(u64, Vec<Data>)>) -> Option<Self> {
        let value = |cell: &Data| match cell {
            Data::Int(_) | Data::Float(_) | Data::DateTime(_) | Data::DateTimeIso(_) => true,
            Data::String(text) => Stamp::read(text).is_some_and(Stamp::is_dated),
            _ => false,
        };
        let is_values = |(_, row): &(u64, Vec<Data>)| filled(row) >= 2 && row.iter().any(value);
        let first = rows.iter().take(MOST_ABOVE).position(is_values)?;
        Some(Self { rows, first })
    }

    fn table(&self, name: &str) -> Table<'_> {
        let mut head = self.first;
        while head > 0 && filled(&self.rows[head - 1].1) >= 2 {
            head -= 1;
        }
        let mut words = vec![format!("sheet {name:?}")];
        let names: Vec<String> = if head < self.first {
            self.rows[head].1.iter().map(|c| c.to_string().trim().to_owned()).collect()
        } else {
            words.push("no header".to_owned());
            Vec::new()
        };
        let mut units = Vec::new();
        if self.first > head + 1 {
            words.push(format!("units in row {}", self.rows[head + 1].0));
            units.extend(self.rows[head + 1].1.iter().map(|c| c.to_string().trim().to_owned()));
        }
        let text = |row: &[Data]| row.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ");
        let above = self.rows[..head].iter().map(|(line, row)| Said::by_line(*line, &text(row)));
        let said = above.into_iter().find(|said| !said.says_nothing()).unwrap_or_default();
        Table { names, line: self.rows[head].0, units, words, said, ..Table::of(Box::new(SheetRows(self))) }
    }
}

struct SheetRows<'s>(&'s Sheet);

impl Rows for SheetRows<'_> {
    fn each(&self, take: &mut Take<'_>) -> Result<(), ExportError> {
        for (number, row) in self.0.rows.iter().skip(self.0.first).filter(|(_, row)| filled(row) > 0) {
            let errors: Vec<String> =
                row.iter().map(|c| if let Data::Error(e) = c { e.to_string() } else { String::new() }).collect();
            let cells: Vec<Cell<'_>> = row.iter().zip(&errors).map(|(c, error)| cell(c, error)).collect();
            if !take(*number, &cells)? {
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
    local_ns(day.at(signed(hour)?, signed(minute)?, signed(second)?, i32::from(milli) * 1_000_000))
}
