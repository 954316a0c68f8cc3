//! Cells and tables, of whatever file they come from.

use super::ExportError;

/// One cell.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Cell<'r> {
    /// Nothing.
    Empty,
    /// Text, trimmed.
    Text(&'r str),
    /// A number of a typed table.
    Number(f64),
    /// A whole number of a typed table.
    Integer(i64),
    /// A clock reading without a zone, ns as if it were UTC.
    Local(i64),
    /// An instant, ns since 1970 UTC.
    #[cfg_attr(not(feature = "parquet"), allow(dead_code))] // only typed files hold them
    Instant(i64),
}

impl Cell<'_> {
    /// As a person would see it, shortened.
    pub(super) fn shown(self) -> String {
        match self {
            Self::Empty => String::new(),
            Self::Text(text) => text.chars().take(40).collect(),
            Self::Number(v) => v.to_string(),
            Self::Integer(v) => v.to_string(),
            Self::Local(ns) | Self::Instant(ns) => crate::units::format_rfc3339(ns),
        }
    }
}

/// What takes rows: line in the file, cells; `false` wants no more.
pub(super) type Take<'t> = dyn FnMut(u64, &[Cell<'_>]) -> Result<bool, ExportError> + 't;

/// Rows that can be read more than once.
pub(super) trait Rows {
    /// Hands out every row, or those until `take` wants no more.
    ///
    /// # Errors
    /// What cannot be read, and what `take` refuses.
    fn each(&self, take: &mut Take<'_>) -> Result<(), ExportError>;
}

/// A table with or without names of columns.
pub(super) struct Table<'f> {
    /// Names of the columns; empty where the file has none.
    pub names: Vec<String>,
    /// Line of the names.
    pub line: u64,
    /// The rows.
    pub rows: Box<dyn Rows + 'f>,
    /// What was recognised.
    pub words: Vec<String>,
}
