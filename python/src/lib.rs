//! The native half of the Python package `stiction`. It takes columns as bytes and options as dictionaries from
//! `stiction/__init__.py`, and returns the documents of the command line as JSON.
//!
//! | file | |
//! |---|---|
//! | `columns.rs` | bytes to samples |
//! | `options.rs` | words and numbers to fit options |
//! | `supervise.rs` | work on threads without Python's lock, watched for Ctrl-C and progress |
//! | `assess.rs`, `windows.rs`, `diagnose.rs`, `error_map.rs`, `read.rs`, `repair.rs`, `simulate.rs` | the functions |

mod assess;
mod columns;
mod diagnose;
mod error_map;
mod options;
mod read;
mod repair;
mod simulate;
mod supervise;
mod windows;

use pyo3::create_exception;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

create_exception!(
    stiction,
    StictionError,
    PyValueError,
    "Unusable input; the message names the argument and the remedy."
);

/// An error that names the argument and the remedy.
fn refused(argument: &str, why: impl core::fmt::Display) -> PyErr {
    StictionError::new_err(format!("{argument}: {why}"))
}

/// Native functions of the package `stiction`; use the package instead.
#[pymodule]
mod _stiction {
    #[pymodule_export]
    use super::StictionError;
    #[pymodule_export]
    use super::assess::{assess, assess_many, assess_plant, screen};
    #[pymodule_export]
    use super::diagnose::diagnose;
    #[pymodule_export]
    use super::error_map::error_map;
    #[pymodule_export]
    use super::read::read;
    #[pymodule_export]
    use super::repair::repair;
    #[pymodule_export]
    use super::simulate::simulate;
    #[pymodule_export]
    use super::windows::{assess_windows, over_time};
    #[pymodule_export]
    #[allow(non_upper_case_globals)]
    const __version__: &str = stiction::core::VERSION;
}
