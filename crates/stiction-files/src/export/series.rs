//! The values of one tag, and what holds for all of them: one unit, and one value at a time.

use super::ExportError;
use super::cell::Cell;
use super::clock::Axis;
use super::names::Role;
use super::quality::Mark;
use crate::number::same_unit;
use stiction::core::record::Value;

/// The values of one tag.
#[derive(Debug, Clone)]
pub(super) struct Series {
    /// The tag.
    pub tag: String,
    /// Its loop and signal.
    pub role: Role,
    /// Its unit, if the file gives it.
    pub unit: Option<String>,
    /// Name of the column of its quality.
    pub quality: Option<String>,
    /// The samples in the order of the rows.
    pub samples: Vec<Taken>,
    /// The time axis.
    pub axis: usize,
    /// The first text that counts as missing, with its line.
    pub first_text: Option<(u64, String)>,
    /// The unit of its numbers, of the heading or behind the first number; `None` before the first.
    pub of_cells: Option<Option<String>>,
    /// Whether its heading has a unit.
    pub by_heading: bool,
}

/// One cell of a series.
#[derive(Debug, Clone, Copy)]
pub(super) struct Taken {
    /// Row of the time axis.
    pub row: u32,
    /// Time, ns since 1970.
    pub t_ns: i64,
    /// The value; missing where its quality is bad.
    pub value: Value,
    /// Whether the cell was empty.
    pub empty: bool,
    /// Its quality.
    pub mark: Mark,
}

/// A tag that has two values at most of its times is that of several loops, or its times lack their seconds.
pub(super) fn check_once(series: &Series, axis: &Axis) -> Result<(), ExportError> {
    // OP and PV in separate rows leave an empty cell at every time.
    let mut taken: Vec<&Taken> = series.samples.iter().filter(|taken| taken.value != Value::Missing).collect();
    taken.sort_by_key(|taken| taken.t_ns);
    let same = || taken.windows(2).filter(|w| w[0].t_ns == w[1].t_ns);
    let mut different = same().filter(|w| w[0].value != w[1].value);
    let (Some(first), others) = (different.next(), different.count()) else { return Ok(()) };
    if others == 0 || 5 * same().count() < 2 * taken.len() || 10 * others < same().count() {
        return Ok(());
    }
    let line = axis.lines.get(first[1].row as usize).copied().unwrap_or(0);
    let what = format!("the tag {:?} has two values at most of its times", series.tag);
    let remedy = "export times with their seconds; if these are several loops, name the column that tells them apart: --map tag=COLUMN";
    Err(ExportError::at(line, what, remedy))
}

impl Series {
    /// Its unit in a column beside the value is the same in all rows.
    pub(super) fn take_unit(&mut self, line: u64, cell: Option<Cell<'_>>) -> Result<(), ExportError> {
        let Some(Cell::Text(unit)) = cell else { return Ok(()) };
        let known = self.unit.get_or_insert_with(|| unit.to_owned());
        if same_unit(known, unit) {
            return Ok(());
        }
        let what = format!("{:?} is in {unit:?}, and in {known:?} before", self.tag);
        Err(ExportError::at(line, what, "export one unit for each tag"))
    }

    /// A number has the unit of the others, or that of the heading.
    pub(super) fn take_number(&mut self, line: u64, cell: Cell<'_>, unit: Option<&str>) -> Result<(), ExportError> {
        let known = self.of_cells.get_or_insert_with(|| unit.map(str::to_owned)).as_deref();
        let by_heading = unit.is_none() && self.by_heading;
        if known == unit || by_heading || known.zip(unit).is_some_and(|(a, b)| same_unit(a, b)) {
            return Ok(());
        }
        let other = known.map_or_else(|| "no unit".to_owned(), |known| format!("{known:?}"));
        let what = format!("{:?} contains {:?}, and {other} in other lines", self.tag, cell.shown());
        let remedy = match unit {
            Some(_) => {
                format!("export one unit for each column, or leave this value out: --missing {:?}", cell.shown())
            }
            None => "export one unit for each column, with the unit in its heading".to_owned(),
        };
        Err(ExportError::at(line, what, remedy))
    }
}
