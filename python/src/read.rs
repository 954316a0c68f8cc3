//! `read`.

use std::path::PathBuf;

use clap::ValueEnum;
use pyo3::prelude::*;
use pyo3::types::PyBytes;

use crate::columns::{bytes_of, stamps_of};
use crate::supervise::supervised;
use crate::{StictionError, refused};
use stiction::core::record::Value;
use stiction_files::csv::{COLUMNS, Row, rows_of};
use stiction_files::export::{Map, TimeFormat, Zone, delimiter, encoding};
use stiction_files::inputs::{Unit, units};
use stiction_files::{Loaded, ReadOptions};

/// Options of the command line for exports, as words.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct Format {
    map: Option<String>,
    time_format: Option<String>,
    tz: Option<String>,
    decimal: Option<String>,
    delimiter: Option<String>,
    encoding: Option<String>,
    sheet: Option<String>,
    quality: Option<String>,
    missing: Option<String>,
}

/// A loop: name, times (ns since 1970), numbers of op, pv, sp and mv, and words of mode; NaN and None if missing.
type Loop<'py> = (String, Bound<'py, PyBytes>, [Bound<'py, PyBytes>; 4], Vec<Option<String>>);

fn parsed<T, E: core::fmt::Display>(
    argument: &str,
    text: Option<&String>,
    parse: impl Fn(&str) -> Result<T, E>,
) -> PyResult<Option<T>> {
    text.map(|text| parse(text).map_err(|why| refused(argument, why))).transpose()
}

impl Format {
    fn options(&self) -> PyResult<ReadOptions> {
        Ok(ReadOptions {
            map: parsed("map", self.map.as_ref(), Map::parse)?,
            time_format: parsed("time_format", self.time_format.as_ref(), TimeFormat::parse)?,
            zone: parsed("tz", self.tz.as_ref(), Zone::parse)?,
            decimal: parsed("decimal", self.decimal.as_ref(), |text| ValueEnum::from_str(text, true))?,
            delimiter: parsed("delimiter", self.delimiter.as_ref(), delimiter)?,
            encoding: parsed("encoding", self.encoding.as_ref(), encoding)?,
            sheet: self.sheet.clone(),
            missing: self.missing.iter().flat_map(|text| text.split(',')).map(|word| word.trim().to_owned()).collect(),
            codes: parsed("quality", self.quality.as_ref(), |text| ValueEnum::from_str(text, true))?,
        })
    }
}

/// Every loop of the files, folders and patterns, and warnings. One of several files that cannot be read is a warning.
#[pyfunction]
pub fn read<'py>(py: Python<'py>, paths: Vec<PathBuf>, format: Format) -> PyResult<(Vec<Loop<'py>>, Vec<String>)> {
    let options = format.options()?;
    let loaded = supervised(py, None, move |_: &_| load(&paths, &options))?;
    let loaded = loaded.map_err(StictionError::new_err)?;
    Ok((loaded.loops.iter().map(|one| columns(py, &one.name, &rows_of(&one.samples))).collect(), loaded.warnings))
}

fn load(paths: &[PathBuf], options: &ReadOptions) -> Result<Loaded, String> {
    let units: Vec<Unit> = units(paths, options).map_err(|error| error.to_string())?;
    let (all, faults) = Loaded::join(units.iter().map(|unit| (unit.name(), unit.load(options))));
    let mut faults = faults.iter().map(ToString::to_string);
    match all {
        Some(mut all) => {
            all.warnings.extend(faults);
            Ok(all)
        }
        None => Err(faults.next().unwrap_or_else(|| "no file was given".to_owned())),
    }
}

fn columns<'py>(py: Python<'py>, name: &str, rows: &[Row]) -> Loop<'py> {
    let number = |row: &Row, column: usize| row.cells[column].and_then(|value| value.as_number()).unwrap_or(f64::NAN);
    let numbers = [0, 1, 2, 3].map(|column| bytes_of(py, rows.iter().map(|row| number(row, column))));
    let mode = |row: &Row| match row.cells[COLUMNS.len() - 1] {
        Some(Value::Mode(mode)) => Some(mode.name().to_owned()),
        Some(Value::Number(number)) => Some(number.to_string()),
        _ => None,
    };
    (name.to_owned(), stamps_of(py, rows.iter().map(|row| row.t_ns)), numbers, rows.iter().map(mode).collect())
}
