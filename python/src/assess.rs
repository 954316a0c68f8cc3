//! `assess`, `assess_many`, `assess_plant`, `screen`.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Mutex;
use std::time::Instant;

use pyo3::prelude::*;
use serde_json::json;

use crate::columns::{Handed, enough};
use crate::options::{Fit, FitOverrides, Look, config};
use crate::supervise::{on_threads, supervised, threads};
use crate::{StictionError, refused};
use stiction::core::gap::model_file::ModelFile;
use stiction::core::record::{Record, Sample};
use stiction::core::verdict::{AssessParams, is_screened_out};
use stiction::toolbox::surface::solve;
use stiction::words;
use stiction::words::action::Action;
use stiction_engine::alarm::LoopContext;
use stiction_engine::analysis::plant::{OfPlant, judge_together};
use stiction_engine::analysis::solver::{self, SolverDocument};
use stiction_engine::analysis::{self, Answer, Cut, Estimated, Points, Scored, Section, text};

/// An estimate's document, and its texts; both JSON.
pub type Told = (String, String);

/// Options for every loop.
struct Settings {
    section: Section,
    cut: Cut,
    solver: Option<FitOverrides>,
    score: Option<ModelFile>,
}

/// Fit options of a loop of this name.
fn params_of(name: &str, fit: &Fit) -> PyResult<AssessParams> {
    let settings = config().loop_settings(name);
    fit.over(&settings.assess)
}

/// One estimate.
#[pyfunction]
pub fn assess(
    py: Python<'_>,
    name: &str,
    columns: Handed,
    look: Look,
    fit: Fit,
    score: Option<&str>,
) -> PyResult<Told> {
    let columns = columns.read()?;
    let settings = settings(&look, &fit, score)?;
    let params = params_of(name, &fit)?;
    let name = name.to_owned();
    let work = move |_: &_| one(&name, enough(columns.all()), &settings, params)?.json_and_text();
    supervised(py, None, work)?.map_err(StictionError::new_err)
}

fn settings(look: &Look, fit: &Fit, score: Option<&str>) -> PyResult<Settings> {
    let (section, cut) = look.read()?;
    let score = score.map(ModelFile::parse).transpose().map_err(|e| refused("score", e))?;
    Ok(Settings { section, cut, solver: fit.solver()?, score })
}

/// A loop's answer and its data.
struct One {
    answer: Answer,
    record: Record,
    notes: Vec<String>,
}

impl One {
    fn json_and_text(&self) -> Result<Told, String> {
        let document = serde_json::to_string(&self.answer).map_err(|e| e.to_string())?;
        Ok((document, said(&self.answer, &self.notes)))
    }
}

/// One loop from samples to answer, as on the command line.
fn one(
    name: &str,
    samples: Result<(Vec<Sample>, Vec<String>), String>,
    settings: &Settings,
    params: AssessParams,
) -> Result<One, String> {
    let (samples, mut notes) = samples.map_err(|e| format!("{name}: {e}"))?;
    let config = config();
    let points = Points::of(name, &samples, &config);
    let started = Instant::now();
    let found = analysis::estimate(&points, settings.section, &settings.cut, params).map_err(|e| e.to_string())?;
    let elapsed_ms = started.elapsed().as_secs_f64() * 1e3;
    notes.extend(points.notes.iter().chain(&found.notes).cloned());
    let solved = settings.solver.and_then(|asked| solved(asked, &found));
    let scored = |file| Scored::of("given", file, &found.record, found.options.period_points);
    let scored = settings.score.as_ref().map(scored).transpose().map_err(|e| format!("score: {e}"))?;
    let answer = found.answer(name, &config.hash(), elapsed_ms, solved, scored);
    Ok(One { answer, record: found.record, notes })
}

/// The texts of an answer, JSON.
pub fn said(answer: &Answer, notes: &[String]) -> String {
    let a = &answer.document.assessment;
    let said = json!({
        "words": words::headline(a), "sureness": words::sureness(a), "reasons": words::evidence(a),
        "size": words::size(a), "unknowns": words::unknowns(a),
        "proposal": words::proposal(a).or_else(|| Action::of(a).map(|action| action.words())), "text": text::answer(answer), "notes": notes, "s0": answer.s0,
    });
    said.to_string()
}

fn solved(asked: FitOverrides, found: &Estimated) -> Option<SolverDocument> {
    let mut surface = solver::surface(&found.record, &found.options, &found.assessment)?;
    let own = solver::own_mse(&mut surface, &found.assessment);
    let started = Instant::now();
    let solved = solve(&mut surface, asked.solver.solver(), &asked.settings);
    let elapsed_ms = started.elapsed().as_secs_f64() * 1e3;
    let name = asked.solver.name().to_owned();
    Some(solver::document(name, &solved, &mut surface, &asked.settings, &found.assessment, own, elapsed_ms))
}

/// The loops of a table and their options. Loop `k` has the rows `ends[k - 1]` to `ends[k]`.
#[derive(FromPyObject)]
pub struct Many {
    #[pyo3(item)]
    names: Vec<String>,
    #[pyo3(item)]
    ends: Vec<usize>,
    #[pyo3(item)]
    columns: Handed,
    #[pyo3(item)]
    look: Look,
    #[pyo3(item)]
    fit: Fit,
    #[pyo3(item)]
    threads: Option<usize>,
    #[pyo3(item)]
    progress: Option<Py<PyAny>>,
}

/// A document with its texts, or the reason why there is none.
type Reply = (Option<Told>, Option<String>);

/// Assesses every loop on threads, then hands the answers to `finish`.
fn many<R: Send + 'static>(
    py: Python<'_>,
    asked: Many,
    finish: impl FnOnce(Vec<Result<One, String>>) -> R + Send + 'static,
) -> PyResult<R> {
    let Many { names, ends, columns, look, fit, threads: threads_asked, progress } = asked;
    let columns = columns.read()?;
    let settings = settings(&look, &fit, None)?;
    let params: Vec<AssessParams> = names.iter().map(|name| params_of(name, &fit)).collect::<PyResult<_>>()?;
    let work = move |watch: &crate::supervise::Watch| {
        watch.expect(names.len() as u64);
        let answers: Vec<Mutex<Option<Result<One, String>>>> = names.iter().map(|_| Mutex::new(None)).collect();
        on_threads(threads(threads_asked), names.len(), &|at| {
            if watch.stopped() {
                return;
            }
            let from = at.checked_sub(1).map_or(0, |before| ends[before]);
            let samples = || enough(columns.samples(from, ends[at]));
            let answer = || one(&names[at], samples(), &settings, params[at].clone());
            // A failure affects only its own loop.
            let answer = catch_unwind(AssertUnwindSafe(answer))
                .unwrap_or_else(|_| Err(format!("{}: internal error in stiction; please report it", names[at])));
            if let Ok(mut place) = answers[at].lock() {
                *place = Some(answer);
            }
            watch.one_more();
        });
        let stopped = || Err("stopped".to_owned());
        finish(answers.into_iter().map(|place| place.into_inner().ok().flatten().unwrap_or_else(stopped)).collect())
    };
    supervised(py, progress.as_ref(), work)
}

/// One estimate per loop.
#[pyfunction]
pub fn assess_many(py: Python<'_>, asked: Many) -> PyResult<Vec<Reply>> {
    many(py, asked, |answers| answers.into_iter().map(|one| split(one.and_then(|one| one.json_and_text()))).collect())
}

/// The loops of one plant, and the documents of the groups that share an oscillation.
#[pyfunction]
pub fn assess_plant(py: Python<'_>, asked: Many) -> PyResult<(Vec<Reply>, Vec<String>)> {
    let finish = |mut answers: Vec<Result<One, String>>| {
        let nowhere = LoopContext::default();
        let mut plant: Vec<OfPlant> = answers
            .iter_mut()
            .flatten()
            .map(|One { answer, record, .. }| OfPlant { answer, record, place: &nowhere })
            .collect();
        let groups = judge_together(&mut plant).map_err(|e| e.to_string())?;
        let groups = groups.iter().map(serde_json::to_string).collect::<Result<_, _>>().map_err(|e| e.to_string())?;
        Ok((answers.into_iter().map(|one| split(one.and_then(|one| one.json_and_text()))).collect(), groups))
    };
    many(py, asked, finish)?.map_err(|e: String| StictionError::new_err(e))
}

fn split(answer: Result<Told, String>) -> Reply {
    match answer {
        Ok(told) => (Some(told), None),
        Err(why) => (None, Some(why)),
    }
}

/// Whether the daemon would skip the record as that of a calm loop.
#[pyfunction]
pub fn screen(py: Python<'_>, name: &str, columns: Handed, look: Look) -> PyResult<bool> {
    let columns = columns.read()?;
    let (section, cut) = look.read()?;
    let name = name.to_owned();
    let work = move |_: &_| {
        let (samples, _) = enough(columns.all()).map_err(|e| format!("{name}: {e}"))?;
        let points = Points::of(&name, &samples, &config());
        let most = points.settings.window.max_points;
        let (record, ..) = cut.record(&points, section, most).map_err(|e| e.to_string())?;
        Ok(is_screened_out(&record, &points.settings.assess))
    };
    supervised(py, None, work)?.map_err(|e: String| StictionError::new_err(e))
}
