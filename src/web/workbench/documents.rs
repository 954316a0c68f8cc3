//! Jobs as JSON.

use schemars::JsonSchema;
use serde::Serialize;
use serde_json::Value;

use super::jobs::{Drawn, Job, MapNumbers, Progress, Said, SectionResult, State};
use super::request::Request;
use crate::web::table::BASE;

/// The jobs so far, oldest first.
#[derive(Debug, Serialize, JsonSchema)]
pub struct JobList {
    /// With their results.
    pub jobs: Vec<JobDocument>,
}

/// A job as documents tell it.
#[derive(Debug, Serialize, JsonSchema)]
pub struct JobDocument {
    /// Its name in addresses.
    id: String,
    /// How it stands.
    state: State,
    /// What was asked.
    request: Request,
    /// Run time, ms.
    elapsed_ms: f64,
    /// How far it is.
    progress: Progress,
    /// How many results there are, and how many have pictures.
    finished: [usize; 2],
    /// The results so far; absent in events.
    #[serde(skip_serializing_if = "Option::is_none")]
    results: Option<Vec<ResultDocument>>,
    /// Why it failed.
    error: Option<String>,
    /// The command lines that give the same, one a line.
    command: String,
}

/// A result as documents tell it.
#[derive(Debug, Serialize, JsonSchema)]
struct ResultDocument {
    /// The section in words, empty for the whole record.
    section: String,
    /// The run, such as `fopdt`; null for a gap.
    model: Option<&'static str>,
    /// The document as the command prints it; null where there is no answer.
    document: Value,
    /// The text as the command prints it.
    text: String,
    /// What to know at a glance.
    words: Vec<Said>,
    /// What a person should know of the section, and why there is no answer.
    notes: Vec<String>,
    pictures: Vec<PictureDocument>,
    /// What its error maps say in numbers; empty until the pictures are there.
    maps: Vec<MapNumbers>,
    report_url: Option<String>,
    predictions_url: Option<String>,
}

#[derive(Debug, Serialize, JsonSchema)]
struct PictureDocument {
    #[serde(flatten)]
    drawn: Drawn,
    /// Below the API's root.
    url: String,
}

impl JobDocument {
    /// A job as it stands; without its results where `short`.
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

    /// Whether nothing more comes.
    #[must_use]
    pub const fn over(&self) -> bool {
        self.state.over()
    }
}
