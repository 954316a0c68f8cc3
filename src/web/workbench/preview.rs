//! The data that a run would analyse, shown before it is started: each section as recorded, and after downsampling and
//! detrending.

use schemars::JsonSchema;
use serde::Serialize;

use super::fault::Fault;
use super::request::{Kind, Task};
use super::shelf::Shelf;
use crate::web::thin::thin;
use stiction::core::record::Record;
use stiction_engine::analysis::estimate::span_of;
use stiction_engine::analysis::{AnalysisError, Points, Section, gap};

/// Most points of a curve.
const POINTS: usize = 2_000;

/// The sections of a request.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct Preview {
    sections: Vec<SectionPreview>,
}

/// A section before analysis.
#[derive(Debug, Clone, PartialEq, Default, Serialize, JsonSchema)]
struct SectionPreview {
    /// The section in words, empty for the whole record.
    section: String,
    /// As recorded; the longest stretch without data gaps.
    before: Option<Curves>,
    /// As it would be analysed.
    after: Option<Curves>,
    /// OP's span in `after`, the upper limit of `fs + fd`, OP units.
    s0: Option<f64>,
    /// Notes on the section.
    notes: Vec<String>,
    /// Why it cannot be analysed.
    error: Option<String>,
}

/// Curves over a common axis, thinned with their extremes kept.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
struct Curves {
    /// Points before thinning.
    count: usize,
    /// Time between two points, s.
    point_s: f64,
    /// Stamps, ms since 1970.
    t_ms: Vec<f64>,
    /// Controller output.
    op: Vec<f64>,
    /// Process variable.
    pv: Vec<f64>,
}

/// The sections that a task would analyse.
///
/// # Errors
/// There is no such file or loop.
pub fn preview(shelf: &Shelf, task: &Task) -> Result<Preview, Fault> {
    let points = shelf.points(&task.request.file, &task.request.loop_name)?;
    Ok(Preview { sections: task.sections.iter().map(|section| of_section(task, &points, *section)).collect() })
}

fn of_section(task: &Task, points: &Points, section: Section) -> SectionPreview {
    let words = section.words();
    let found = cut(task, points, section);
    found.map_or_else(
        |error| SectionPreview { section: words.clone(), error: Some(error.to_string()), ..SectionPreview::default() },
        |found| SectionPreview { section: words.clone(), ..found },
    )
}

fn cut(task: &Task, points: &Points, section: Section) -> Result<SectionPreview, AnalysisError> {
    let most = match task.request.kind {
        Kind::Analyze => points.settings.window.max_points,
        Kind::Gap => gap::MAX_POINTS,
    };
    let (before, _) = points.record(section, usize::MAX)?;
    let (after, _, notes) = task.cut.record(points, section, most)?;
    Ok(SectionPreview {
        section: String::new(),
        s0: span_of(&after),
        before: Some(curves(&before)),
        after: Some(curves(&after)),
        notes: points.notes.iter().chain(&notes).cloned().collect(),
        error: None,
    })
}

fn curves(record: &Record) -> Curves {
    let op = record.op();
    let kept = thin(&[&op, &record.pv], POINTS);
    let start_ms = record.start_ns as f64 / 1e6;
    Curves {
        count: record.len(),
        point_s: record.point_s(),
        t_ms: kept.iter().map(|at| start_ms + 1e3 * record.point_s() * *at as f64).collect(),
        op: kept.iter().map(|at| op[*at]).collect(),
        pv: kept.iter().map(|at| record.pv[*at]).collect(),
    }
}
