//! A loop's window: its curves with the last fit, its pictures, and the window as a file.

use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use axum::http::{HeaderValue, header};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use serde::Serialize;

use super::curves::{Curves, known, recorded};
use super::{Answered, Live, Operation, ResponseKind, Shared, of};
use crate::report::detail::Detail;
use crate::report::diagram::Tags;
use crate::report::figures::{Figure, Subject, detailed};
use crate::report::{LoopReport, Report, page};
use crate::runtime::clock::now_ns;
use crate::web::error::ApiError;
use crate::web::extract::PathName;
use stiction::core::record::{Record, Signal};
use stiction::core::units::{file_stem_of, format_rfc3339, from_to, ms_from_ns, ns_from_s};
use stiction::core::verdict::EstimateDocument;
use stiction::repair::{NoRepair, Repair, RepairParams, repair};
use stiction::toolbox::fit_plots::FitPlots;
use stiction_engine::analysis::{Points, Section};
use stiction_engine::engine::LoopSettings;
use stiction_files::LoadedLoop;
use stiction_files::csv;
use stiction_files::transfer::loops_as_recording;

/// Points sent at first for a watched loop.
const FIRST_POINTS: usize = 100;

/// A loop's current window.
#[derive(Debug, Serialize, schemars::JsonSchema)]
struct Window {
    /// Mean sampling time, s.
    ts_s: f64,
    /// Samples in a point. If 1, points are the samples; otherwise PV's mean and the midpoint of OP's extremes.
    box_samples: usize,
    /// Its curves.
    #[serde(flatten)]
    curves: Curves,
    /// Measured valve position, if there is one.
    mv: Option<Vec<Option<f64>>>,
    /// Valve position of the last fit, OP units.
    valve: Option<Vec<Option<f64>>>,
    /// PV simulated by the last fit from OP alone, without measured PV.
    pv_fit: Option<Vec<Option<f64>>>,
    /// Dead time of the last fit, points.
    lag_points: Option<f64>,
}

/// Pictures of the newest window.
#[derive(Debug, Serialize, schemars::JsonSchema)]
struct Pictures {
    /// In display order.
    pictures: Vec<Drawn>,
}

/// One picture.
#[derive(Debug, Serialize, schemars::JsonSchema)]
pub struct Drawn {
    /// Its name within the list.
    pub id: String,
    /// What it shows.
    pub title: String,
    /// How to read it.
    pub caption: String,
    /// Whether it needs the whole width of the page.
    pub wide: bool,
    /// The picture, SVG.
    pub svg: String,
}

pub(super) fn operations() -> Vec<Operation<Shared>> {
    let json = |path, summary, response, handler| Operation {
        method: "get",
        path,
        summary,
        query: &[],
        body: None,
        response,
        handler,
    };
    vec![
        json(
            "/loops/{name}/window",
            "The window that the engine holds now, with the last fit run over it",
            ResponseKind::Json(of::<Window>),
            || get(window),
        ),
        json(
            "/loops/{name}/pictures",
            "Pictures of the newest estimate: curves, phase plot, error over the bands, orders, indicators",
            ResponseKind::Json(of::<Pictures>),
            || get(pictures),
        ),
        json(
            "/loops/{name}/repair",
            "What a repair buys: the closed loop simulated as it is, with a free valve, and with half the gain",
            ResponseKind::Json(of::<Repair>),
            || get(buys),
        ),
        json("/loops/{name}/sheet", "Evidence on one page, to print", ResponseKind::File("text/html"), || get(sheet)),
        json(
            "/loops/{name}/window.csv",
            "The newest estimate's samples as recorded",
            ResponseKind::File("text/csv"),
            || get(window_csv),
        ),
        json(
            "/loops/{name}/window.mcap",
            "The newest estimate's samples as recorded, as a recording",
            ResponseKind::File("application/octet-stream"),
            || get(window_mcap),
        ),
    ]
}

fn stamps_ms(record: &Record) -> Vec<f64> {
    let point_ns = ns_from_s(record.point_s());
    (0..record.len() as i64).map(|k| ms_from_ns(record.start_ns.saturating_add(k.saturating_mul(point_ns)))).collect()
}

fn curves(record: &Record) -> Curves {
    Curves {
        t_ms: stamps_ms(record),
        op: known(&record.op()),
        pv: known(&record.pv),
        sp: record.sp.as_deref().map(known),
    }
}

/// The part of a window's curves after a stamp, and the newest stamp, ns; the last points if the stamp is before the window.
pub(super) fn curves_after(record: &Record, after_ns: i64) -> Option<(Curves, i64)> {
    let point_ns = ns_from_s(record.point_s());
    let newest_ns = record.start_ns.saturating_add((record.len() as i64 - 1).saturating_mul(point_ns));
    if record.is_empty() || newest_ns <= after_ns {
        return None;
    }
    let at = |k: usize| record.start_ns.saturating_add((k as i64).saturating_mul(point_ns));
    let from = if after_ns < record.start_ns {
        record.len().saturating_sub(FIRST_POINTS)
    } else {
        (0..record.len()).find(|k| at(*k) > after_ns)?
    };
    let all = curves(record);
    let part = |values: &[Option<f64>]| values[from..].to_vec();
    let curves = Curves {
        t_ms: all.t_ms[from..].to_vec(),
        op: part(&all.op),
        pv: part(&all.pv),
        sp: all.sp.as_deref().map(part),
    };
    Some((curves, newest_ns))
}

async fn window(State(live): State<Shared>, PathName(name): PathName) -> Answered<Window> {
    let looked = live.request_window(&name, None).await?;
    // A loop without samples has an empty window.
    let record = looked.record.unwrap_or_else(|| Record::uniform(1.0, Vec::new(), Vec::new()));
    let estimate = live.overview.newest(&name).and_then(|newest| newest.estimate);
    let settings = looked.settings;
    live.computations.run(move || Json(window_of(&record, estimate.as_deref(), &settings))).await
}

fn window_of(record: &Record, estimate: Option<&EstimateDocument>, settings: &LoopSettings) -> Window {
    let model = estimate.and_then(|e| e.assessment.model());
    let period_s = estimate.and_then(|e| e.assessment.oscillation.period_s);
    let options = settings.assess.options(period_s.map(|p| p / record.point_s()));
    let run = model.as_ref().and_then(|model| Some(FitPlots::new(record, &options, model)?.free_run()));
    let pv_fit = run.as_ref().map(|run| {
        let before = std::iter::repeat_n(None, run.from);
        before.chain(known(&run.pv)).collect()
    });
    Window {
        ts_s: record.ts_s,
        box_samples: record.box_samples,
        curves: curves(record),
        mv: record.mv.as_deref().map(known),
        valve: run.as_ref().map(|run| known(&run.valve)),
        pv_fit,
        lag_points: model.map(|model| model.dead_time_s / record.point_s()),
    }
}

/// The newest estimate with the record that it was computed from.
struct Estimated {
    document: Arc<EstimateDocument>,
    record: Record,
    settings: Arc<LoopSettings>,
}

impl Live {
    async fn estimated(&self, name: &str) -> Result<Estimated, ApiError> {
        let newest =
            self.overview.newest(name).ok_or_else(|| ApiError::not_found(format!("no loop {name:?} has appeared")))?;
        let none = || ApiError::not_found(format!("{name}: no window has been answered yet"));
        let document = newest.estimate.ok_or_else(none)?;
        let looked = self.request_window(name, Some(document.assessment.window.end_ns)).await?;
        let window = &document.assessment.window;
        let middle_ns = window.start_ns.midpoint(window.end_ns);
        // After a data gap, or when history is played fast, the engine's history no longer reaches back to the estimate.
        let record = match looked.record.filter(|record| record.start_ns <= middle_ns) {
            Some(record) => record,
            None => self.recorded_window(name, window, looked.settings.window.max_points).await?,
        };
        Ok(Estimated { document, record, settings: looked.settings })
    }
}

impl Live {
    /// Rebuilds an estimate's window from the recordings.
    async fn recorded_window(
        &self,
        name: &str,
        window: &stiction::core::verdict::Window,
        max_points: usize,
    ) -> Result<Record, ApiError> {
        let read = samples(self, name, [window.start_ns, window.end_ns]).await?;
        let (config, section) = (self.config.get(), Section::Window(window.start_ns, window.end_ns));
        let made = move || Points::of(&read.name, &read.samples, &config).record(section, max_points);
        let made = self.computations.run(made).await?;
        made.map(|(record, _)| record).map_err(|error| ApiError::not_found(error.to_string()))
    }
}

impl Estimated {
    fn report(self, name: &str) -> LoopReport {
        let a = &self.document.assessment;
        let unit = self.settings.place.op_unit.clone().unwrap_or_else(|| "OP units".to_owned());
        let plain = Tags::of_loop(name, self.record.sp.is_some(), self.record.mv.is_some());
        let tags = Tags { units: [unit, "PV units".to_owned()], ..plain };
        LoopReport {
            detail: Detail::of(&self.record, &self.settings.assess, a),
            document: (*self.document).clone(),
            record: self.record,
            original: None,
            tags,
            comment: None,
            notes: Vec::new(),
            full: true,
        }
    }
}

async fn pictures(State(live): State<Shared>, PathName(name): PathName) -> Answered<Pictures> {
    let estimated = live.estimated(&name).await?;
    let drawn = live
        .drawings
        .run(move || {
            let one = estimated.report(&name);
            let subject = Subject {
                record: &one.record,
                original: None,
                assessment: &one.document.assessment,
                tags: &one.tags,
                detail: one.detail.as_ref(),
            };
            detailed(&subject)
        })
        .await?;
    let figures = drawn.map_err(|error| ApiError::unfit(format!("a picture cannot be drawn: {error}")))?;
    Ok(Json(Pictures { pictures: figures.iter().enumerate().map(drawing).collect() }))
}

/// A figure in the form that the page expects.
#[must_use]
pub fn drawing((k, figure): (usize, &Figure)) -> Drawn {
    Drawn {
        id: k.to_string(),
        title: figure.picture.title.clone(),
        caption: figure.caption.clone(),
        wide: figure.wide,
        svg: figure.picture.svg(),
    }
}

async fn buys(State(live): State<Shared>, PathName(name): PathName) -> Answered<Repair> {
    simulated(&live, &name).await?.map(Json).map_err(|why| ApiError::unfit(why.to_string()))
}

/// Simulates the repair of a loop from its newest estimate.
pub(super) async fn simulated(live: &Shared, name: &str) -> Result<Result<Repair, NoRepair>, ApiError> {
    let Estimated { document, record, settings } = live.estimated(name).await?;
    let params = RepairParams { op_range: settings.assess.op_range, ..RepairParams::default() };
    live.computations.run(move || repair(&record, &document.assessment, &params)).await
}

async fn sheet(State(live): State<Shared>, PathName(name): PathName) -> Result<Response, ApiError> {
    let estimated = live.estimated(&name).await?;
    let alarm = live.overview.newest(&name).and_then(|newest| newest.alarm);
    let prefix = live.config.get().site.prefix.clone();
    let made = live
        .drawings
        .run(move || {
            let warnings = alarm.iter().map(|alarm| alarm.line()).collect();
            let w = &estimated.document.assessment.window;
            let window = from_to(w.start_ns, w.end_ns);
            let command =
                format!("evidence sheet of loop {name}, window {window}, written {}", format_rfc3339(now_ns()));
            let input = format!("live data of {prefix}");
            page(&Report { input, command, warnings, loops: vec![estimated.report(&name)], groups: None })
        })
        .await?;
    let html = made.map_err(|error| ApiError::unfit(format!("a picture cannot be drawn: {error}")))?;
    // The page carries its styles and script inline, and its policy admits nothing else.
    let rule = "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; frame-ancestors 'none'";
    let headers = [(header::CONTENT_TYPE, "text/html; charset=utf-8"), (header::CONTENT_SECURITY_POLICY, rule)];
    Ok((headers, html).into_response())
}

/// A loop's samples in the recordings.
async fn samples(live: &Live, name: &str, range_ns: [i64; 2]) -> Result<LoadedLoop, ApiError> {
    let (archive, of) = (live.archive.clone(), name.to_owned());
    let read = live.looks.run(move || recorded(&archive, &of, &Signal::ALL, range_ns)).await?;
    if read.samples.is_empty() {
        return Err(ApiError::not_found(format!(
            "{name}: the samples of its newest estimate are not in the recordings"
        )));
    }
    Ok(read)
}

/// The recorded samples of a loop's newest estimate.
async fn newest_samples(live: &Shared, name: &str) -> Result<LoadedLoop, ApiError> {
    let newest = live.overview.newest(name).and_then(|newest| newest.estimate);
    let none = || ApiError::not_found(format!("{name}: no window has been answered yet"));
    let window = newest.ok_or_else(none)?.assessment.window;
    samples(live, name, [window.start_ns, window.end_ns]).await
}

fn file(name: &str, extension: &str, kind: &'static str, content: Vec<u8>) -> Response {
    let text = format!("attachment; filename=\"{}.{extension}\"", file_stem_of(name));
    let attachment = HeaderValue::from_str(&text).unwrap_or(HeaderValue::from_static("attachment"));
    ([(header::CONTENT_TYPE, HeaderValue::from_static(kind)), (header::CONTENT_DISPOSITION, attachment)], content)
        .into_response()
}

async fn window_csv(State(live): State<Shared>, PathName(name): PathName) -> Result<Response, ApiError> {
    let one = newest_samples(&live, &name).await?;
    let write = move || {
        let mut out = Vec::new();
        csv::write(&one, &mut out).map(|_| out)
    };
    let written = live.computations.run(write).await?.map_err(|e| ApiError::busy(e.to_string()))?;
    Ok(file(&name, "csv", "text/csv; charset=utf-8", written))
}

async fn window_mcap(State(live): State<Shared>, PathName(name): PathName) -> Result<Response, ApiError> {
    let one = newest_samples(&live, &name).await?;
    let archive = live.archive.clone();
    let write = move || loops_as_recording(archive.prefix(), ["page", "recordings"], &[one]);
    let written = live.computations.run(write).await?;
    let bytes = written.map_err(|e| ApiError::busy(format!("the recording cannot be written: {e}")))?;
    Ok(file(&name, "mcap", "application/octet-stream", bytes))
}
