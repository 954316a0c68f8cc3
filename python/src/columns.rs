//! Columns of numbers to samples, by the same rules as tables.

use pyo3::prelude::*;
use pyo3::types::PyBytes;

use crate::refused;
use stiction::core::record::{Mode, Sample, Signal, Value};
use stiction::core::units::parse_time;
use stiction_engine::analysis::rows::{Joined, Rows};

/// Numbers of eight bytes each, little-endian.
fn words(bytes: &[u8]) -> impl Iterator<Item = [u8; 8]> + '_ {
    bytes.as_chunks::<8>().0.iter().copied()
}

/// A column of doubles; NaN if missing.
#[derive(Debug, Clone)]
pub struct Numbers(pub Vec<f64>);

impl<'py> FromPyObject<'_, 'py> for Numbers {
    type Error = PyErr;

    fn extract(ob: Borrowed<'_, 'py, PyAny>) -> PyResult<Self> {
        let bytes = ob.cast::<PyBytes>()?;
        Ok(Self(words(bytes.as_bytes()).map(f64::from_le_bytes).collect()))
    }
}

/// Timestamps as given.
pub enum Stamps {
    /// Nanoseconds since 1970.
    Ns(Vec<i64>),
    /// Seconds since 1970.
    Seconds(Vec<f64>),
}

impl<'py> FromPyObject<'_, 'py> for Stamps {
    type Error = PyErr;

    fn extract(ob: Borrowed<'_, 'py, PyAny>) -> PyResult<Self> {
        let (unit, bytes): (String, Bound<'py, PyBytes>) = ob.extract()?;
        let words = words(bytes.as_bytes());
        Ok(match unit.as_str() {
            "ns" => Self::Ns(words.map(i64::from_le_bytes).collect()),
            _ => Self::Seconds(words.map(f64::from_le_bytes).collect()),
        })
    }
}

impl Stamps {
    /// In ns since 1970. Seconds are converted by their shortest text, so that 0.1 equals a table's 0.1.
    fn read(self) -> PyResult<Vec<i64>> {
        let stamp = |(row, seconds): (usize, f64)| {
            let told = |e| refused("t", format!("row {row}: {e}; drop the row"));
            parse_time(&format!("{seconds}")).map_err(told)
        };
        match self {
            Self::Ns(stamps) => Ok(stamps),
            Self::Seconds(seconds) => seconds.into_iter().enumerate().map(stamp).collect(),
        }
    }
}

/// The columns of one loop, or of several in sequence; all of equal length.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct Handed {
    t: Stamps,
    op: Numbers,
    pv: Numbers,
    sp: Option<Numbers>,
    mv: Option<Numbers>,
    mode: Option<Vec<Option<String>>>,
}

impl Handed {
    /// Parses the timestamps.
    ///
    /// # Errors
    /// A stamp that is not a time.
    pub fn read(self) -> PyResult<Columns> {
        let Self { t, op, pv, sp, mv, mode } = self;
        Ok(Columns { t_ns: t.read()?, op, pv, sp, mv, mode })
    }
}

/// The columns, ready for use.
pub struct Columns {
    /// Timestamps, ns since 1970.
    t_ns: Vec<i64>,
    op: Numbers,
    pv: Numbers,
    sp: Option<Numbers>,
    mv: Option<Numbers>,
    /// A word or a number as text; `None` if missing.
    mode: Option<Vec<Option<String>>>,
}

impl Columns {
    /// The samples of the rows `from` to `to`, excluding `to`.
    pub fn samples(&self, from: usize, to: usize) -> Joined {
        let mut rows = Rows::default();
        let number = |column: &Numbers, row: usize| {
            let value = column.0.get(row).copied().filter(|v| !v.is_nan());
            value.map(Value::number)
        };
        for row in from..to.min(self.t_ns.len()) {
            rows.begin(self.t_ns[row]);
            for signal in Signal::ALL {
                let cell = match signal {
                    Signal::Op => number(&self.op, row),
                    Signal::Pv => number(&self.pv, row),
                    Signal::Sp => self.sp.as_ref().and_then(|sp| number(sp, row)),
                    Signal::Mv => self.mv.as_ref().and_then(|mv| number(mv, row)),
                    Signal::Mode => {
                        self.mode.as_ref().and_then(|mode| mode.get(row)).and_then(|word| word.as_deref()).map(mode_of)
                    }
                };
                rows.cell(signal, cell.map(|value| (value, None)));
            }
        }
        rows.finish()
    }

    /// The samples of all rows.
    pub fn all(&self) -> Joined {
        self.samples(0, self.t_ns.len())
    }
}

fn mode_of(word: &str) -> Value {
    word.parse::<f64>().map_or_else(|_| Value::Mode(Mode::from_word(word)), Value::number)
}

/// Numbers as bytes, for Python.
pub fn bytes_of(py: Python<'_>, numbers: impl Iterator<Item = f64>) -> Bound<'_, PyBytes> {
    PyBytes::new(py, &numbers.flat_map(f64::to_le_bytes).collect::<Vec<u8>>())
}

/// Timestamps as bytes, for Python.
pub fn stamps_of(py: Python<'_>, stamps: impl Iterator<Item = i64>) -> Bound<'_, PyBytes> {
    PyBytes::new(py, &stamps.flat_map(i64::to_le_bytes).collect::<Vec<u8>>())
}

/// The samples, if there are enough for a fit, counted as on the command line.
pub fn enough(joined: Joined) -> Result<(Vec<Sample>, Vec<String>), String> {
    let needed = stiction_engine::analysis::MIN_SAMPLES;
    let there = stiction_engine::analysis::usable(&joined.samples);
    if there < needed {
        return Err(format!("{there} usable samples, {needed} with both OP and PV are needed; give a longer record"));
    }
    Ok((joined.samples, joined.warnings))
}
