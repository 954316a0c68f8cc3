//! `assess_windows`, `over_time`: many windows of one loop.

use std::ops::RangeInclusive;
use std::sync::Mutex;

use pyo3::prelude::*;

use crate::assess::{Told, said};
use crate::columns::Handed;
use crate::options::{config, stamp};
use crate::supervise::{Watch, on_threads, supervised, threads};
use crate::{StictionError, refused};
use stiction::core::verdict::EstimateDocument;
use stiction::over_time::WindowResult;
use stiction_engine::analysis::estimate::span_of;
use stiction_engine::analysis::{Answer, Due, Section, Taken};
use stiction_engine::config::Config;
use stiction_engine::engine::{Request, WindowAnswer};

/// Windows waiting for a fit, per thread; their data are freed after it.
const WAITING: usize = 8;

/// The requested windows.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct Watched {
    config: Option<String>,
    hop_s: Option<f64>,
    max_window_s: Option<f64>,
    ends: Option<(String, String)>,
    threads: Option<usize>,
}

impl Watched {
    /// The daemon's configuration.
    fn config(&self) -> PyResult<Config> {
        let told = |argument| move |faults: Vec<_>| refused(argument, listed(&faults));
        if let Some(text) = &self.config {
            return Config::parse(text).map_err(told("config"));
        }
        let mut table = format!("[site]\nprefix = \"{}\"\n[window]\n", config().site.prefix);
        for (key, value) in [("hop_s", self.hop_s), ("max_window_s", self.max_window_s)] {
            if let Some(value) = value {
                table.push_str(&format!("{key} = {value:?}\n"));
            }
        }
        Config::parse(&table).map_err(told("hop_s"))
    }

    /// The ends of the requested windows, ns since 1970.
    fn ends(&self) -> PyResult<RangeInclusive<i64>> {
        let Some((after, until)) = &self.ends else { return Ok(i64::MIN..=i64::MAX) };
        Ok(stamp("ends", after)?.saturating_add(1)..=stamp("ends", until)?)
    }
}

fn listed(faults: &[impl ToString]) -> String {
    faults.iter().map(ToString::to_string).collect::<Vec<_>>().join("; ")
}

/// Every window that came due, as the daemon would publish it.
#[pyfunction]
pub fn assess_windows(
    py: Python<'_>,
    name: &str,
    columns: Handed,
    watched: Watched,
    progress: Option<Py<PyAny>>,
) -> PyResult<Vec<Told>> {
    let (columns, config, ends) = (columns.read()?, watched.config()?, watched.ends()?);
    let team = threads(watched.threads);
    let name = name.to_owned();
    let work = move |watch: &Watch| {
        let joined = columns.all();
        let total = joined.samples.len();
        watch.expect(total as u64);
        let hash = config.hash();
        let answer = |request: &Request| one(&name, &hash, request, &joined.warnings);
        let mut due = Due::of(&name, &joined.samples, &config);
        let mut told = Vec::new();
        while !watch.stopped() {
            let batch: Vec<Request> =
                due.by_ref().filter(|request| ends.contains(&request.end_ns)).take(WAITING * team).collect();
            if batch.is_empty() {
                break;
            }
            let places: Vec<Mutex<Option<Result<Told, String>>>> = batch.iter().map(|_| Mutex::new(None)).collect();
            on_threads(team, batch.len(), &|at| {
                if watch.stopped() {
                    return;
                }
                if let Ok(mut place) = places[at].lock() {
                    *place = Some(answer(&batch[at]));
                }
            });
            told.extend(places.into_iter().filter_map(|place| place.into_inner().ok().flatten()));
            watch.reached((total - due.left()) as u64);
        }
        watch.reached(total as u64);
        told.into_iter().collect::<Result<Vec<Told>, String>>()
    };
    supervised(py, progress.as_ref(), work)?.map_err(StictionError::new_err)
}

/// A window's document, and its texts.
fn one(name: &str, hash: &str, request: &Request, notes: &[String]) -> Result<Told, String> {
    let WindowAnswer { record, assessment, .. } = request.compute();
    let answer = Answer {
        document: EstimateDocument::new(name, hash, assessment),
        s0: span_of(&record),
        selection: Taken { section: Section::Whole, downsample: None, detrend: None },
        solver: None,
        scored: None,
    };
    let document = serde_json::to_string(&answer.document).map_err(|e| e.to_string())?;
    Ok((document, said(&answer, notes)))
}

/// The combined result of many windows of one valve; both JSON.
#[pyfunction]
pub fn over_time(py: Python<'_>, windows: &str) -> PyResult<String> {
    let windows: Vec<WindowResult> = serde_json::from_str(windows).map_err(|e| refused("windows", e))?;
    let found = supervised(py, None, move |_| stiction::over_time::over_time(&windows))?;
    serde_json::to_string(&found).map_err(|e| StictionError::new_err(e.to_string()))
}
