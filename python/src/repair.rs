//! `repair`.

use pyo3::prelude::*;

use crate::StictionError;
use crate::columns::{Handed, enough};
use crate::options::{Fit, Look, config};
use crate::supervise::supervised;
use stiction::core::verdict::{AssessParams, assess};
use stiction::repair::{RepairParams, repair as simulated};
use stiction_engine::analysis::Points;

/// Benefit of a repair; JSON.
#[pyfunction]
pub fn repair(py: Python<'_>, name: &str, columns: Handed, look: Look, fit: Fit) -> PyResult<String> {
    let columns = columns.read()?;
    let (section, cut) = look.read()?;
    let params = fit.over(&config().loop_settings(name).assess)?;
    let told = RepairParams { op_range: params.op_range, seed: params.fit.seed };
    let name = name.to_owned();
    let work = move |_: &_| {
        let (samples, _) = enough(columns.all()).map_err(|e| format!("{name}: {e}"))?;
        let points = Points::of(&name, &samples, &config());
        let most = points.settings.window.max_points;
        let (record, ..) = cut.record(&points, section, most).map_err(|e| e.to_string())?;
        // Identify the simulated loop from the whole record, however long it is.
        let found = assess(&record, &AssessParams { always_fit: true, ..params });
        let bought = simulated(&record, &found, &told).map_err(|e| format!("{name}: {e}"))?;
        serde_json::to_string(&bought).map_err(|e| e.to_string())
    };
    supervised(py, None, work)?.map_err(|e: String| StictionError::new_err(e))
}
