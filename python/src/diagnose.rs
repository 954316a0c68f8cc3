//! `diagnose`.

use std::time::{Duration, Instant};

use pyo3::prelude::*;
use pyo3::types::PyBytes;
use serde_json::json;

use crate::columns::{Handed, bytes_of, enough, stamps_of};
use crate::options::{Look, config, stamp};
use crate::supervise::{Watch, on_threads, supervised, threads};
use crate::{StictionError, refused};
use stiction::core::gap::model_file::ModelFile;
use stiction::core::gap::{Executor, GapError, effects};
use stiction::words::gap_text;
use stiction_engine::analysis::gap::{
    BaseChoice, DiagnosedWindow, GapSettings, assessment, decide_together, diagnose as diagnosed, neighbour, record,
};
use stiction_engine::analysis::predictions::{Row, rows};
use stiction_engine::analysis::{Points, Section};

/// Options.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct FitOverrides {
    base: String,
    without: Vec<String>,
    pairs: bool,
    budget_s: Option<f64>,
    seed: u64,
    threads: Option<usize>,
    neighbours: Vec<(String, Handed)>,
    windows: Vec<(String, String)>,
}

impl FitOverrides {
    fn read(&self) -> PyResult<GapSettings> {
        let base = match self.base.as_str() {
            "refit" => BaseChoice::Refit,
            "linear" => BaseChoice::Linear,
            model => BaseChoice::File(Box::new(ModelFile::parse(model).map_err(|e| refused("base", e))?)),
        };
        if let Some(id) = self.without.iter().find(|id| !effects::ALL.iter().any(|e| e.id == id.as_str())) {
            let known = effects::ALL.iter().map(|e| e.id).collect::<Vec<_>>().join(", ");
            return Err(refused("without", GapError::UnknownEffect { id: id.clone(), known }));
        }
        if let Some(budget) = self.budget_s.filter(|s| !(s.is_finite() && *s > 0.0)) {
            return Err(refused("budget_s", format!("{budget} is not a time; give seconds above 0")));
        }
        Ok(GapSettings {
            base,
            without: self.without.clone(),
            pairs: self.pairs,
            budget_s: self.budget_s,
            seed: self.seed,
        })
    }
}

/// The sections to diagnose: several windows if given, else a single section.
fn sections(section: Section, windows: &[(String, String)]) -> PyResult<Vec<Section>> {
    if windows.is_empty() {
        return Ok(vec![section]);
    }
    if section != Section::Whole {
        return Err(refused("windows", "samples or window select a section, too; give one of them"));
    }
    let one = |(from, to): &(String, String)| {
        Section::of_times(stamp("windows", from)?, stamp("windows", to)?).map_err(|e| refused("windows", e))
    };
    let found = windows.iter().map(one).collect::<PyResult<Vec<_>>>()?;
    if found.len() < 2 {
        Err(refused("windows", "gives one pair of times; give two or more, or window"))
    } else {
        Ok(found)
    }
}

/// Threads and a clock for the search; stops it when its time is up or the caller is gone.
struct Threads<'w> {
    threads: usize,
    /// Models that earlier windows may have tried.
    before: u64,
    until: Option<Instant>,
    watch: &'w Watch,
}

impl Executor for Threads<'_> {
    fn run(&self, jobs: usize, job: &(dyn Fn(usize) + Sync)) {
        on_threads(self.threads, jobs, job);
    }

    fn tick(&self, done: u64) -> bool {
        self.watch.reached(self.before + done);
        !self.watch.stopped() && self.until.is_none_or(|until| Instant::now() < until)
    }
}

/// Document and texts (JSON), and the columns t (ns), pv, base, after, held_out.
type Told<'py> = (String, String, [Bound<'py, PyBytes>; 5]);

/// One gap diagnosis.
#[pyfunction]
pub fn diagnose<'py>(
    py: Python<'py>,
    name: &str,
    columns: Handed,
    look: Look,
    asked: FitOverrides,
    progress: Option<Py<PyAny>>,
) -> PyResult<Told<'py>> {
    let columns = columns.read()?;
    let (section, cut) = look.read()?;
    let settings = asked.read()?;
    let sections = sections(section, &asked.windows)?;
    let mut others = Vec::new();
    for (other, handed) in asked.neighbours {
        others.push((other, handed.read()?));
    }
    let team = threads(asked.threads);
    let name = name.to_owned();
    let work = move |watch: &Watch| {
        let (samples, mut notes) = enough(columns.all()).map_err(|e| format!("{name}: {e}"))?;
        let points = Points::of(&name, &samples, &config());
        notes.extend(points.notes.iter().cloned());
        let mut neighbours = Vec::new();
        for (other, columns) in &others {
            let (samples, _) = enough(columns.all()).map_err(|e| format!("neighbour {other}: {e}"))?;
            neighbours.push(Points::of(other, &samples, &config()));
        }
        let mut windows = Vec::new();
        for (at, section) in sections.iter().enumerate() {
            let source = format!("window {}", at + 1);
            let told =
                |e: String| if sections.len() > 1 { format!("{name}, {source}: {e}") } else { format!("{name}: {e}") };
            let (record, more) = record(&points, *section, &cut).map_err(|e| told(e.to_string()))?;
            notes.extend(more.into_iter().filter(|note| !notes.contains(note)).collect::<Vec<_>>());
            let mut options = settings.options(&record);
            for other in &neighbours {
                options.neighbours.push(neighbour(other, &record)?);
            }
            watch.expect(options.budget_evaluations * sections.len() as u64);
            let until = settings.budget_s.map(|s| Instant::now() + Duration::from_secs_f64(s));
            let before = options.budget_evaluations * at as u64;
            let executor = Threads { threads: team, before, until, watch };
            let judged = assessment(&points, *section, &cut);
            let alone = diagnosed(&name, record, &options, &executor, judged).map_err(|e| told(e.to_string()))?;
            windows.push(DiagnosedWindow { source, alone });
        }
        let (shown, found) = if windows.len() > 1 {
            decide_together(&windows, &settings).map_err(|e| format!("{name}: {e}"))?
        } else {
            (0, windows.remove(0).alone)
        };
        let section = sections[shown];
        let whole = points.samples(section).map_err(|e| e.to_string())?;
        let rows = rows(&whole, &found.record, &found.diagnosis);
        let d = &found.document;
        let said = json!({
            "words": gap_text::answer(d), "paragraph": gap_text::paragraph(d), "text": gap_text::verbose(d), "notes": notes,
        });
        let document = serde_json::to_string(d).map_err(|e| e.to_string())?;
        Ok((document, said.to_string(), rows))
    };
    let answer: Result<(String, String, Vec<Row>), String> = supervised(py, progress.as_ref(), work)?;
    let (document, said, rows) = answer.map_err(StictionError::new_err)?;
    let run = |which: usize| rows.iter().map(move |row| row.simulated.map_or(f64::NAN, |both| both[which]));
    let columns = [
        stamps_of(py, rows.iter().map(|row| row.t_ns)),
        bytes_of(py, rows.iter().map(|row| row.pv)),
        bytes_of(py, run(0)),
        bytes_of(py, run(1)),
        bytes_of(py, rows.iter().map(|row| f64::from(u8::from(row.held_out)))),
    ];
    Ok((document, said, columns))
}
