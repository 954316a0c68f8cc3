//! `error_map`.

use pyo3::prelude::*;
use serde_json::{Value, json};

use crate::columns::{Handed, enough};
use crate::options::{Look, config};
use crate::supervise::supervised;
use crate::{StictionError, refused};
use stiction::core::ident::Model;
use stiction::core::signal::stats;
use stiction::core::sim::slips::Law;
use stiction::toolbox::fit_plots::FitPlots;
use stiction_engine::analysis::Points;

/// The error over the (fs, fd) plane for one order of the process, JSON; `step` is a fraction of OP's span.
#[pyfunction]
pub fn error_map(
    py: Python<'_>,
    name: &str,
    columns: Handed,
    look: Look,
    document: &str,
    order: u8,
    step: f64,
) -> PyResult<String> {
    let columns = columns.read()?;
    let (section, cut) = look.read()?;
    let (model, period_s) =
        model_of(document).ok_or_else(|| refused("record", "this result has no model: nothing was fitted"))?;
    let name = name.to_owned();
    let work = move |_: &_| {
        let (samples, _) = enough(columns.all()).map_err(|e| format!("{name}: {e}"))?;
        let points = Points::of(&name, &samples, &config());
        let (record, ..) =
            cut.record(&points, section, points.settings.window.max_points).map_err(|e| e.to_string())?;
        let options = points.settings.assess.options(period_s.map(|period_s| period_s / record.point_s()));
        let nothing = || format!("{name}: the record does not let its model move");
        let plots = FitPlots::new(&record, &options, &model).ok_or_else(nothing)?;
        let map = plots.error_map(order, step).ok_or_else(nothing)?;
        let cells = map.cells.iter().map(|cell| (cell.fs, cell.fd, cell.rms)).collect::<Vec<_>>();
        Ok(json!({
            "order": map.order, "span": plots.span(), "step": map.step, "pv_sd": stats::std_dev(&record.pv),
            "best": [map.best.fs, map.best.fd], "region": map.region, "cells": cells,
        })
        .to_string())
    };
    supervised(py, None, work)?.map_err(|e: String| StictionError::new_err(e))
}

/// The model of an estimate's document, and the period of its oscillation, s.
fn model_of(document: &str) -> Option<(Model, Option<f64>)> {
    let read: Value = serde_json::from_str(document).ok()?;
    let process = &read["process"];
    let lags = process["time_constants_s"].as_array()?.iter().filter_map(Value::as_f64);
    let model = Model {
        law: if read["valve_model"] == Law::Tracking.name() { Law::Tracking } else { Law::He },
        fs: read["fs"].as_f64()?,
        fd: read["fd"].as_f64()?,
        gain: process["gain"].as_f64()?,
        time_constants_s: lags.collect(),
        dead_time_s: process["dead_time_s"].as_f64()?,
        integrating: process["integrating"].as_bool()?,
    };
    Some((model, read["oscillation"]["period_s"].as_f64()))
}
