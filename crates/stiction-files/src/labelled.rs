//! The labelled set: its files, their labels, and which recordings share data.

use std::path::Path;

use anyhow::{Context, bail};

use crate::LoadedLoop;
use stiction::core::units::LoopKind;
use stiction::core::verdict::AssessParams;
use stiction_engine::analysis::{AnalysisError, Judgeable, Points};
use stiction_engine::config::Config;

/// One line of an index.
#[derive(Debug, Clone, PartialEq)]
pub struct Case {
    /// Path relative to the index.
    pub file: String,
    /// Label as written.
    pub label: String,
    /// First folder of the path; empty if there is none.
    pub source: String,
    /// The valve, with its source.
    pub valve: String,
    /// Data recorded only once, with its source: the `same_data_group`, else the file.
    pub group: String,
    /// Controlled quantity: the column `loop_type`, else the letters of the loop's tag.
    pub kind: LoopKind,
    /// The label is doubtful, according to the column `doubt`.
    pub doubtful: bool,
}

impl Case {
    /// Labels that are scored: those of sticking valves, then the others.
    pub const SCORED: [&str; 5] = ["stiction", "deadband", "no_stiction", "tuning", "disturbance"];

    /// The label as sticking or not; `None` if it is not scored.
    #[must_use]
    pub fn truth(&self) -> Option<bool> {
        Self::SCORED.iter().position(|label| *label == self.label).map(|at| at < 2)
    }
}

/// The valve of a loop's name. Names of several recordings of one valve differ after `-DB` (runs of an experiment) or in
/// groups of digits after underscores (date and time of a window); these are removed.
#[must_use]
pub fn valve_of(loop_name: &str) -> &str {
    if let Some((valve, _)) = loop_name.split_once("-DB-") {
        return valve;
    }
    let mut valve = loop_name;
    while let Some((head, tail)) = valve.rsplit_once('_') {
        if head.is_empty() || tail.is_empty() || !tail.bytes().all(|b| b.is_ascii_digit()) {
            break;
        }
        valve = head;
    }
    valve
}

/// Reads an index with the columns `file` and `label`, and optionally `valve`, `loop` and `same_data_group`.
///
/// # Errors
/// The index cannot be read, lacks a column, or names no file.
pub fn read(path: &Path) -> anyhow::Result<Vec<Case>> {
    let mut reader = csv::ReaderBuilder::new()
        .flexible(true)
        .from_path(path)
        .with_context(|| format!("cannot read {}", path.display()))?;
    let headers = reader.headers().with_context(|| format!("cannot read {}", path.display()))?.clone();
    let optional = |name: &str| headers.iter().position(|h| h.trim() == name);
    let column = |name: &str| {
        optional(name).with_context(|| {
            format!("{}: line 1: no column {name:?}; an index needs the columns file and label", path.display())
        })
    };
    let (file, label) = (column("file")?, column("label")?);
    let (valve, loop_name, group) = (optional("valve"), optional("loop"), optional("same_data_group"));
    let (kind, doubt) = (optional("loop_type"), optional("doubt"));
    let mut cases = Vec::new();
    for row in reader.records() {
        let row = row.with_context(|| path.display().to_string())?;
        let cell = |i: usize| row.get(i).unwrap_or_default().trim().to_owned();
        let given = |i: Option<usize>| i.map(cell).filter(|text| !text.is_empty());
        let file = cell(file);
        if file.is_empty() {
            continue;
        }
        let source = file.split_once('/').map_or("", |(folder, _)| folder).to_owned();
        let stem = Path::new(&file).file_stem().map_or_else(String::new, |s| s.to_string_lossy().into_owned());
        let tag = given(loop_name).unwrap_or(stem);
        let kind = given(kind).and_then(|word| LoopKind::from_name(word.split(' ').next()?));
        let kind = kind.unwrap_or_else(|| LoopKind::of_tag(&tag));
        let doubtful = given(doubt).is_some();
        let valve = given(valve).unwrap_or_else(|| valve_of(&tag).to_owned());
        let group = given(group).unwrap_or_else(|| file.clone());
        let within = |name: String| format!("{source}/{name}");
        let (label, valve, group) = (cell(label), within(valve), within(group));
        cases.push(Case { label, valve, group, kind, doubtful, source, file });
    }
    if cases.is_empty() {
        bail!("{}: lists no files", path.display());
    }
    Ok(cases)
}

/// The longest section of a recording without a data gap, for commands that judge whole files. Notes on it go to the log.
///
/// # Errors
/// There is no sample with both OP and PV.
pub fn whole_record(loaded: &LoadedLoop, config: &Config) -> Result<Judgeable, AnalysisError> {
    let points = Points::of(&loaded.name, &loaded.samples, config);
    let (judgeable, notes) = points.judgeable()?;
    points.notes.iter().chain(&notes).for_each(|note| tracing::warn!("{}: {note}", points.name));
    Ok(judgeable)
}

/// The first loop of a case's file, whole, with the parameters of a labelled recording.
///
/// # Errors
/// The file holds no loop that can be judged.
pub fn judgeable(case: &Case, loops: &[LoadedLoop]) -> anyhow::Result<Judgeable> {
    let Some(first) = loops.first() else { bail!("{}: no loop found; a loop needs an OP and a PV", case.file) };
    let whole = whole_record(first, &Config::with_prefix("plant"))?;
    let params = AssessParams { always_fit: true, kind: case.kind, ..whole.params.clone() };
    Ok(Judgeable { params, ..whole })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_valve_is_its_loop_without_the_window() {
        for (loop_name, valve) in [
            ("FIC101_0609_0957", "FIC101"),
            ("AREA.70-3_FIC101_20241226_0953", "AREA.70-3_FIC101"),
            ("stiction-P-DB-2-author-2018", "stiction-P"),
            ("FIC_101", "FIC"),
            ("boiler_flow", "boiler_flow"),
            ("_12", "_12"),
            ("CHEM20", "CHEM20"),
        ] {
            assert_eq!(valve_of(loop_name), valve);
        }
    }
}
