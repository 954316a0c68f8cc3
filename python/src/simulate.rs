//! `simulate`.

use pyo3::prelude::*;
use pyo3::types::PyBytes;

use crate::columns::{bytes_of, stamps_of};
use crate::refused;
use crate::supervise::supervised;
use stiction::core::record::Record;
use stiction::core::units::ns_from_s;
use stiction::simulated::scenario::Scenario;

/// A loop: name, truth, sampling time (s), and the columns t (ns), op, pv, sp, mv.
type Loop<'py> = (String, String, f64, [Bound<'py, PyBytes>; 5]);

/// Every loop of a scenario in TOML or, with `json`, in JSON.
#[pyfunction]
pub fn simulate<'py>(py: Python<'py>, scenario: &str, json: bool) -> PyResult<Vec<Loop<'py>>> {
    let text = if json { toml_of(scenario)? } else { scenario.to_owned() };
    let scenario = Scenario::parse(&text).map_err(|e| refused("scenario", e))?;
    let work = move |_: &_| {
        let loops = scenario.loops.iter().enumerate();
        let ran = |(at, spec): (usize, &stiction::simulated::scenario::LoopSpec)| {
            scenario.record(at).map(|record| (spec.name.clone(), spec.truth(), record))
        };
        loops.filter_map(ran).collect::<Vec<_>>()
    };
    let loops = supervised(py, None, work)?;
    Ok(loops.into_iter().map(|(name, truth, record)| columns(py, name, truth, &record)).collect())
}

fn toml_of(json: &str) -> PyResult<String> {
    let table: toml::Table = serde_json::from_str(json).map_err(|e| refused("scenario", e))?;
    toml::to_string(&table).map_err(|e| refused("scenario", e))
}

fn columns<'py>(py: Python<'py>, name: String, truth: String, record: &Record) -> Loop<'py> {
    // Scans are a whole number of ns apart, as in a recording.
    let step_ns = ns_from_s(record.ts_s);
    let stamp = |scan: usize| record.start_ns + i64::try_from(scan).unwrap_or(i64::MAX).saturating_mul(step_ns);
    let column = |values: Option<&Vec<f64>>| bytes_of(py, values.into_iter().flatten().copied());
    let columns = [
        stamps_of(py, (0..record.len()).map(stamp)),
        column(Some(&record.op_path)),
        column(Some(&record.pv)),
        column(record.sp.as_ref()),
        column(record.mv.as_ref()),
    ];
    (name, truth, record.ts_s, columns)
}
