//! Jobs as JSON.

use schemars::JsonSchema;
use serde::Serialize;
use serde_json::Value;

use super::jobs::{Drawn, Job, MapNumbers, Progress, Said, SectionResult, State};
use super::request::Request;
use crate::web::table::BASE;

/// All jobs, oldest first.
#[derive(Debug, Serialize, JsonSchema)]
pub struct JobList {
    /// The jobs with their results.
    pub jobs: Vec<JobDocument>,
}

/// A job as JSON.
#[derive(Debug, Serialize, JsonSchema)]
pub struct JobDocument {
    /// Its name in URLs.
    id: String,
    /// Its state.
    state: State,
    /// The request.
    request: Request,
    /// Run time, ms.
    elapsed_ms: f64,
    /// Its progress.
    progress: Progress,
    /// Number of results, and of those with pictures.
    finished: [usize; 2],
    /// The results so far; absent in events.
    #[serde(skip_serializing_if = "Option::is_none")]
    results: Option<Vec<ResultDocument>>,
    /// Why it failed.
    error: Option<String>,
    /// Equivalent command lines, one a line.
    command: String,
}

/// A result as JSON.
#[derive(Debug, Serialize, JsonSchema)]
struct ResultDocument {
    /// The section in words; empty for the whole record.
    section: String,
    /// The run, such as `fopdt`; null for a gap.
    model: Option<&'static str>,
    /// The document as the command prints it; null if there is no answer.
    document: Value,
    /// The text as the command prints it.
    text: String,
    /// The most important facts.
    words: Vec<Said>,
    /// Notes on the section, and why there is no answer.
    notes: Vec<String>,
    pictures: Vec<PictureDocument>,
    /// The numbers of its error maps; empty until the pictures are drawn.
    maps: Vec<MapNumbers>,
    report_url: Option<String>,
    predictions_url: Option<String>,
}

#[derive(Debug, Serialize, JsonSchema)]
struct PictureDocument {
    #[serde(flatten)]
    drawn: Drawn,
    /// Path below the API's root.
    url: String,
}

impl JobDocument {
    /// The current state of a job; without its results if `short`.
    #[must_use]
    pub fn of(job: &Job, short: bool) -> Self {
        let made = job.now();
        let base = format!("/workbench/jobs/{}", job.id);
        let pictured = made.results.iter().filter(|found| !found.pictures.is_empty()).count();
        let picture = |drawn: &Drawn| PictureDocument {
            url: format!("{BASE}{base}/pictures/{}", drawn.id),
            drawn: drawn.clone(),
        };
        let result = |(at, found): (usize, &SectionResult)| ResultDocument {
            section: found.section.clone(),
            model: found.model,
            document: found.document.clone(),
            text: found.text.clone(),
            words: found.words.clone(),
            notes: found.notes.clone(),
            pictures: found.pictures.iter().map(picture).collect(),
            maps: found.maps.clone(),
            report_url: found
                .report
                .filter(|k| *k < made.reports.len())
                .map(|k| format!("{BASE}{base}/report?part={k}")),
            predictions_url: found.predictions.as_ref().map(|_| format!("{BASE}{base}/predictions?part={at}")),
        };
        Self {
            id: job.id.clone(),
            state: made.state,
            request: job.task.request.clone(),
            elapsed_ms: made.elapsed_ms(),
            finished: [made.results.len(), pictured],
            results: (!short).then(|| made.results.iter().enumerate().map(result).collect()),
            progress: made.progress,
            error: made.error,
            command: job.command.join("\n"),
        }
    }

    /// Whether the job is finished.
    #[must_use]
    pub const fn over(&self) -> bool {
        self.state.over()
    }
}
