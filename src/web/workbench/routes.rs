//! The workbench's part of the API.

use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;

use axum::body::Bytes;
use axum::extract::rejection::{BytesRejection, QueryRejection};
use axum::extract::{DefaultBodyLimit, Path, Query, State};
use axum::http::{StatusCode, header};
use axum::response::sse::{Event, KeepAlive, Sse};
use axum::response::{IntoResponse, Response};
use axum::routing::{delete, get, post};
use axum::{Extension, Json};
use futures_util::stream::{self, Stream};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use tokio::sync::OwnedSemaphorePermit;

use super::Bench;
use super::choices::{self, Choices};
use super::documents::{JobDocument, JobList};
use super::fault::Fault;
use super::jobs::{Job, SectionResult, State as JobState};
use super::preview::{Preview, preview};
use super::record::{RecordAnswer, RecordQuery, record};
use super::request::Request;
use super::shelf::{FileInfo, Shelf};
use super::upload::upload;
use crate::web::server::IdleTimer;
use crate::web::table::{Operation, Parameter, ResponseKind, of};
use crate::web::thin::thin;
use stiction::core::units::format_seconds;
use stiction_engine::analysis::predictions::Row;

/// Largest request for a job, bytes; it may contain a model's document.
const MAX_ORDER: usize = 1 << 20;
/// Pause between two events of a job.
const PAUSE: Duration = Duration::from_millis(150);
/// Default number of points in a diagnosis' curves.
const POINTS: usize = 3_000;

type Answered<T> = Result<Json<T>, Fault>;
/// A query, parsed or refused.
type Wanted<T> = Result<Query<T>, QueryRejection>;

fn wanted<T>(query: Wanted<T>) -> Result<T, Fault> {
    query.map(|Query(query)| query).map_err(|why| Fault::wrong(why.body_text()))
}

/// Every file.
#[derive(Debug, Serialize, JsonSchema)]
struct Files {
    files: Vec<FileInfo>,
}

/// A queued job.
#[derive(Debug, Serialize, JsonSchema)]
struct Ordered {
    id: String,
    command: String,
}

/// State of a job that was cancelled or deleted.
#[derive(Debug, Serialize, JsonSchema)]
struct Stands {
    state: JobState,
}

/// Which of a job's results.
#[derive(Debug, Deserialize)]
struct PartQuery {
    #[serde(default)]
    part: usize,
    points: Option<usize>,
}

/// Measured PV and free runs of a diagnosed section, thinned. Null where a run is not scored.
#[derive(Debug, Serialize, JsonSchema)]
struct Predictions {
    /// Stamps, ms since 1970.
    t_ms: Vec<f64>,
    /// Measured PV.
    pv: Vec<f64>,
    /// Free run of the base model.
    pv_base: Vec<Option<f64>>,
    /// Free run with the effect.
    pv_after: Vec<Option<f64>>,
    /// Whether the models were fitted without this point.
    held_out: Vec<bool>,
}

const PART: Parameter = Parameter { name: "part", words: "which report or section, from 0" };

fn line(
    method: &'static str,
    path: &'static str,
    summary: &'static str,
    query: &'static [Parameter],
    response: ResponseKind,
    handler: fn() -> axum::routing::MethodRouter<Bench>,
) -> Operation<Bench> {
    Operation { method, path, summary, query, body: None, response, handler }
}

/// Every operation of the workbench.
#[must_use]
pub fn operations() -> Vec<Operation<Bench>> {
    let mut all = of_files();
    all.extend(of_jobs());
    all
}

fn of_files() -> Vec<Operation<Bench>> {
    const READING: &[Parameter] = &[
        Parameter { name: "name", words: "what the file is called; tables' loops are named after it" },
        Parameter { name: "map", words: "which columns are what, as --map" },
        Parameter { name: "time_format", words: "how times are written, as --time-format" },
        Parameter { name: "tz", words: "whose clock times without a zone are, as --tz" },
        Parameter { name: "decimal", words: "point or comma" },
        Parameter { name: "delimiter", words: "what parts cells" },
        Parameter { name: "encoding", words: "the text's encoding" },
        Parameter { name: "sheet", words: "the sheet of a workbook" },
        Parameter { name: "quality", words: "what quality codes mean" },
    ];
    const RECORD: &[Parameter] = &[
        Parameter { name: "loop", words: "the loop" },
        Parameter { name: "from_ms", words: "from when, ms since 1970" },
        Parameter { name: "to_ms", words: "to when, ms since 1970" },
        Parameter { name: "points", words: "how many points" },
    ];
    vec![
        line(
            "get",
            "/workbench/options",
            "Everything that can be chosen, with its default and its words",
            &[],
            ResponseKind::Json(of::<Choices>),
            || get(options),
        ),
        line("get", "/workbench/files", "The files that are open", &[], ResponseKind::Json(of::<Files>), || get(files)),
        line(
            "post",
            "/workbench/files",
            "Opens a file: the body is its bytes",
            READING,
            ResponseKind::Json(of::<FileInfo>),
            || post(upload),
        ),
        line("delete", "/workbench/files/{id}", "Closes a file", &[], ResponseKind::Json(of::<Files>), || {
            delete(close)
        }),
        line(
            "get",
            "/workbench/files/{id}/record",
            "A loop's record between two times; thinned, extremes stay",
            RECORD,
            ResponseKind::Json(of::<RecordAnswer>),
            || get(curves),
        ),
        Operation {
            body: Some(of::<Request>),
            ..line(
                "post",
                "/workbench/preview",
                "What an order would analyse: its sections before and after downsampling",
                &[],
                ResponseKind::Json(of::<Preview>),
                || post(previewed).layer(DefaultBodyLimit::max(MAX_ORDER)),
            )
        },
    ]
}

fn of_jobs() -> Vec<Operation<Bench>> {
    const POINTS: &[Parameter] = &[PART, Parameter { name: "points", words: "how many points" }];
    vec![
        line(
            "get",
            "/workbench/jobs",
            "The jobs so far, with their results, oldest first",
            &[],
            ResponseKind::Json(of::<JobList>),
            || get(jobs),
        ),
        Operation {
            body: Some(of::<Request>),
            ..line(
                "post",
                "/workbench/jobs",
                "Orders an estimate or a diagnosis",
                &[],
                ResponseKind::Json(of::<Ordered>),
                || post(order).layer(DefaultBodyLimit::max(MAX_ORDER)),
            )
        },
        line(
            "get",
            "/workbench/jobs/{id}",
            "A job with its results so far",
            &[],
            ResponseKind::Json(of::<JobDocument>),
            || get(job),
        ),
        line(
            "delete",
            "/workbench/jobs/{id}",
            "Cancels a job, or forgets one that is over",
            &[],
            ResponseKind::Json(of::<Stands>),
            || delete(remove),
        ),
        line(
            "get",
            "/workbench/jobs/{id}/events",
            "How far a job is, as server-sent events `job`: the job without its results",
            &[],
            ResponseKind::Events,
            || get(events),
        ),
        line(
            "get",
            "/workbench/jobs/{id}/report",
            "The report as `--report` writes it",
            &[PART],
            ResponseKind::File("text/html"),
            || get(report),
        ),
        line(
            "get",
            "/workbench/jobs/{id}/pictures/{picture}",
            "A picture of a result",
            &[],
            ResponseKind::File("image/svg+xml"),
            || get(picture),
        ),
        line(
            "get",
            "/workbench/jobs/{id}/predictions",
            "Measured PV and the free runs before and after, thinned",
            POINTS,
            ResponseKind::Json(of::<Predictions>),
            || get(predictions),
        ),
        line(
            "get",
            "/workbench/jobs/{id}/predictions.csv",
            "The same whole, as `gap --predictions` writes it",
            &[PART],
            ResponseKind::File("text/csv"),
            || get(predictions_csv),
        ),
    ]
}

async fn options(State(bench): State<Bench>) -> Json<Choices> {
    Json(choices::all(bench.shelf.limits().file_bytes))
}

async fn files(State(bench): State<Bench>) -> Json<Files> {
    Json(Files { files: bench.shelf.list() })
}

async fn close(State(bench): State<Bench>, Path(id): Path<String>) -> Answered<Files> {
    bench.shelf.close(&id)?;
    Ok(Json(Files { files: bench.shelf.list() }))
}

async fn curves(
    State(bench): State<Bench>,
    Path(id): Path<String>,
    query: Wanted<RecordQuery>,
) -> Answered<RecordAnswer> {
    let query = wanted(query)?;
    in_place(&bench, move |shelf| record(shelf, &id, &query)).await
}

/// Reads a record on a separate thread; only a few run at a time.
async fn in_place<T: Send + 'static>(
    bench: &Bench,
    read: impl FnOnce(&Shelf) -> Result<T, Fault> + Send + 'static,
) -> Answered<T> {
    let ended = |_| Fault::own("the program is ending");
    let _place = bench.drawing.acquire().await.map_err(ended)?;
    let shelf = bench.shelf.clone();
    let work = tokio::task::spawn_blocking(move || read(&shelf));
    work.await.map_err(|_| Fault::own("the record could not be read; the program's log has details"))?.map(Json)
}

async fn jobs(State(bench): State<Bench>) -> Json<JobList> {
    Json(JobList { jobs: bench.jobs.list().iter().map(|job| JobDocument::of(job, false)).collect() })
}

/// The job in a request's body.
fn ordered(body: Result<Bytes, BytesRejection>) -> Result<Request, Fault> {
    let body = body.map_err(|why| match why.status() {
        StatusCode::PAYLOAD_TOO_LARGE => Fault::too_large("an order may have 1 MiB"),
        _ => Fault::wrong(why.body_text()),
    })?;
    Request::read(&body)
}

async fn previewed(State(bench): State<Bench>, body: Result<Bytes, BytesRejection>) -> Answered<Preview> {
    let task = ordered(body)?.task()?;
    in_place(&bench, move |shelf| preview(shelf, &task)).await
}

async fn order(State(bench): State<Bench>, body: Result<Bytes, BytesRejection>) -> Answered<Ordered> {
    let request = ordered(body)?;
    let info = bench.shelf.info(&request.file)?;
    let wanted = &request.loop_name;
    if !info.loops.iter().any(|one| one.name == *wanted) {
        let names = info.loops.iter().take(20).map(|one| one.name.as_str()).collect::<Vec<_>>().join(", ");
        return Err(Fault::missing(format!(
            "{} has no loop {:?}; choose one of {names}",
            info.name,
            super::names::shown(wanted)
        )));
    }
    let file = bench.shelf.arguments(&request.file)?;
    let task = request.task()?;
    let command = task.request.commands(&file, info.loops.len() == 1);
    let job = bench.jobs.order(task, command)?;
    Ok(Json(Ordered { id: job.id.clone(), command: job.command.join("\n") }))
}

async fn job(State(bench): State<Bench>, Path(id): Path<String>) -> Answered<JobDocument> {
    Ok(Json(JobDocument::of(bench.jobs.get(&id)?.as_ref(), false)))
}

async fn remove(State(bench): State<Bench>, Path(id): Path<String>) -> Answered<Stands> {
    Ok(Json(Stands { state: bench.jobs.remove(&id)? }))
}

/// State of a stream.
struct Following {
    job: Arc<Job>,
    changes: tokio::sync::watch::Receiver<u64>,
    idle: Option<IdleTimer>,
    begun: bool,
    over: bool,
    _place: OwnedSemaphorePermit,
}

async fn events(
    State(bench): State<Bench>,
    Path(id): Path<String>,
    idle: Option<Extension<IdleTimer>>,
) -> Result<Sse<impl Stream<Item = Result<Event, Infallible>>>, Fault> {
    let job = bench.jobs.get(&id)?;
    let place = bench.streams.clone().try_acquire_owned();
    let place = place.map_err(|_| Fault::too_many("too many pages are open; close some"))?;
    let changes = job.listen();
    let idle = idle.map(|Extension(idle)| idle);
    let following = Following { job, changes, idle, begun: false, over: false, _place: place };
    let stream = stream::unfold(following, |mut following| async move {
        let event = following.next().await?;
        Some((Ok(event), following))
    });
    Ok(Sse::new(stream).keep_alive(KeepAlive::new().interval(Duration::from_secs(10))))
}

impl Following {
    /// The job at once, then after every change, and once more when it has ended.
    async fn next(&mut self) -> Option<Event> {
        if self.over {
            return None;
        }
        if std::mem::replace(&mut self.begun, true) {
            self.changes.changed().await.ok()?;
            // Changes come by the hundred; a page needs a few a second.
            tokio::time::sleep(PAUSE).await;
            self.changes.mark_unchanged();
        }
        if let Some(idle) = &self.idle {
            idle.touch();
        }
        let document = JobDocument::of(&self.job, true);
        self.over = document.over();
        let data = serde_json::to_string(&document).unwrap_or_default();
        Some(Event::default().event("job").data(data))
    }
}

/// A job's result.
fn found(job: &Job, part: usize) -> Result<SectionResult, Fault> {
    job.now().results.get(part).cloned().ok_or_else(|| Fault::missing("this job has no such result, or not yet"))
}

async fn report(
    State(bench): State<Bench>,
    Path(id): Path<String>,
    query: Wanted<PartQuery>,
) -> Result<Response, Fault> {
    let query = wanted(query)?;
    let made = bench.jobs.get(&id)?.now();
    let page = made.reports.get(query.part).cloned();
    let page = page.ok_or_else(|| Fault::missing("the report is not there yet; it comes with the pictures"))?;
    // The page contains its own styles and script and nothing from outside; the sandbox keeps it from the API.
    let rules = "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; sandbox allow-scripts allow-modals allow-popups";
    let headers = [(header::CONTENT_TYPE, "text/html; charset=utf-8"), (header::CONTENT_SECURITY_POLICY, rules)];
    Ok((headers, String::clone(&page)).into_response())
}

async fn picture(State(bench): State<Bench>, Path((id, wanted)): Path<(String, String)>) -> Result<Response, Fault> {
    let made = bench.jobs.get(&id)?.now();
    let mut all = made.results.iter().flat_map(|found| &found.pictures);
    let drawn = all.find(|drawn| drawn.id == wanted).ok_or_else(|| Fault::missing("this job has no such picture"))?;
    Ok(([(header::CONTENT_TYPE, "image/svg+xml")], drawn.standing_alone()).into_response())
}

async fn predictions(
    State(bench): State<Bench>,
    Path(id): Path<String>,
    query: Wanted<PartQuery>,
) -> Answered<Predictions> {
    let query = wanted(query)?;
    let rows = found(bench.jobs.get(&id)?.as_ref(), query.part)?.predictions;
    let rows = rows.ok_or_else(|| Fault::missing("an estimate has no free runs; diagnose the gap"))?;
    let column = |of: &dyn Fn(&Row) -> f64| -> Vec<f64> { rows.iter().map(of).collect() };
    let simulated = |row: &Row, which: usize| row.simulated.map(|both| both[which]);
    let missing = f64::NAN;
    let curves = [
        column(&|row| row.pv),
        column(&|row| simulated(row, 0).unwrap_or(missing)),
        column(&|row| simulated(row, 1).unwrap_or(missing)),
    ];
    let kept = thin(&[&curves[0], &curves[1], &curves[2]], query.points.unwrap_or(POINTS).clamp(10, 20_000));
    let kept: Vec<&Row> = kept.into_iter().map(|at| &rows[at]).collect();
    Ok(Json(Predictions {
        t_ms: kept.iter().map(|row| row.t_ns as f64 / 1e6).collect(),
        pv: kept.iter().map(|row| row.pv).collect(),
        pv_base: kept.iter().map(|row| simulated(row, 0)).collect(),
        pv_after: kept.iter().map(|row| simulated(row, 1)).collect(),
        held_out: kept.iter().map(|row| row.held_out).collect(),
    }))
}

async fn predictions_csv(
    State(bench): State<Bench>,
    Path(id): Path<String>,
    query: Wanted<PartQuery>,
) -> Result<Response, Fault> {
    let query = wanted(query)?;
    let rows = found(bench.jobs.get(&id)?.as_ref(), query.part)?.predictions;
    let rows = rows.ok_or_else(|| Fault::missing("an estimate has no free runs; diagnose the gap"))?;
    let mut text = String::from("t,pv,pv_base,pv_after,held_out\n");
    for row in rows.iter() {
        let [base, after] = row.simulated.map_or_else(<[String; 2]>::default, |both| both.map(|v| v.to_string()));
        let line = format!("{},{},{base},{after},{}\n", format_seconds(row.t_ns), row.pv, u8::from(row.held_out));
        text.push_str(&line);
    }
    let file = (header::CONTENT_DISPOSITION, "attachment; filename=\"predictions.csv\"");
    Ok(([(header::CONTENT_TYPE, "text/csv; charset=utf-8"), file], text).into_response())
}
