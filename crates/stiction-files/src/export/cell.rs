//! Cells and tables of any file format.

use super::zone::Said;
use super::{Decimal, ExportError};

/// One cell.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(not(any(feature = "parquet", feature = "xlsx")), allow(dead_code))] // text files hold `Empty` and `Text` only
pub(super) enum Cell<'r> {
    /// Nothing.
    Empty,
    /// Text, trimmed.
    Text(&'r str),
    /// A number of a typed table.
    Number(f64),
    /// A whole number of a typed table.
    Integer(i64),
    /// A local time without a zone, ns as if it were UTC.
    Local(i64),
    /// An instant, ns since 1970 UTC.
    #[cfg_attr(not(feature = "parquet"), allow(dead_code))] // only typed files hold them
    Instant(i64),
}

impl Cell<'_> {
    /// The cell as shown to a person, shortened.
    pub(super) fn shown(self) -> String {
        match self {
            Self::Empty => String::new(),
            Self::Text(text) => text.chars().take(40).collect(),
            Self::Number(v) => v.to_string(),
            Self::Integer(v) => v.to_string(),
            Self::Local(ns) | Self::Instant(ns) => stiction::core::units::format_rfc3339(ns),
        }
    }
}

/// Receives rows: line in the file, cells. Returns `false` to stop.
pub(super) type Take<'t> = dyn FnMut(u64, &[Cell<'_>]) -> Result<bool, ExportError> + 't;

/// Rows that can be read repeatedly.
pub(super) trait Rows {
    /// Passes on every row, until `take` stops it.
    ///
    /// # Errors
    /// What cannot be read, or an error of `take`.
    fn each(&self, take: &mut Take<'_>) -> Result<(), ExportError>;
}

/// A table with or without column names.
pub(super) struct Table<'f> {
    /// Column names; empty if the file has none.
    pub names: Vec<String>,
    /// Line of the names.
    pub line: u64,
    /// The rows.
    pub rows: Box<dyn Rows + 'f>,
    /// Units of the columns, if a row below the names has them.
    pub units: Vec<String>,
    /// What was recognised.
    pub words: Vec<String>,
    /// The decimal separator where the format fixes it.
    pub decimal: Option<Decimal>,
    /// Warnings for the user.
    pub warnings: Vec<String>,
    /// What the lines above the names say of the zone of the times.
    pub said: Said,
    /// Whether day numbers count from 1904.
    pub since_1904: bool,
}

/// Most letters of a unit; longer texts are descriptions.
const LONGEST_UNIT: usize = 12;

impl<'f> Table<'f> {
    /// A table of these rows, of which nothing else is known.
    pub(super) fn of(rows: Box<dyn Rows + 'f>) -> Self {
        let (names, units, words, warnings) = Default::default();
        Self { names, line: 0, rows, units, words, decimal: None, warnings, said: Said::default(), since_1904: false }
    }

    /// The unit of a column: in square brackets after its name, else in the row below the names.
    pub fn unit_of(&self, column: usize) -> Option<String> {
        let bracketed = self.names.get(column).and_then(|name| name.trim().strip_suffix(']')?.rsplit_once('['));
        let unit = bracketed.map(|(_, unit)| unit).or_else(|| self.units.get(column).map(String::as_str))?.trim();
        (!unit.is_empty() && unit.chars().count() <= LONGEST_UNIT).then(|| unit.to_owned())
    }
}

#[cfg(test)]
mod tests {
    use crate::load_samples;

    #[test]
    fn units_stand_in_brackets_or_below_the_names() {
        let folder = tempfile::tempdir().unwrap();
        let row = |s: usize| format!("2026-01-05T08:00:{s:02}Z,{s},{}\n", 100 - s);
        let rows: String = (0..30).map(row).collect();
        let units = |head: &str| {
            let path = folder.path().join("x.csv");
            std::fs::write(&path, format!("{head}\n{rows}")).unwrap();
            load_samples(&path).unwrap().loops.remove(0).units
        };
        let said = |op: &str, pv: &str| [Some(op.to_owned()), Some(pv.to_owned())];
        assert_eq!(units("Timestamp,F1.OP,F1.PV\n,%,m3/h"), said("%", "m3/h"));
        assert_eq!(units("Timestamp,F1.OP [%],F1.PV [bar]"), said("%", "bar"));
        assert_eq!(units("Timestamp,F1.OP,F1.PV\n,output of the controller,"), [None, None]);
        assert_eq!(units("Timestamp,F1.OP,F1.PV"), [None, None]);
    }
}
