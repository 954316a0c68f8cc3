//! `--pool`: files, or sections of one file, as windows of one valve.

use anyhow::{Context, anyhow, bail};

use super::{Args, Diagnosed, diagnose, print, settings, write_predictions, write_report};
use crate::cli::reading::config_of;
use crate::cli::selection::points;
use crate::cli::{Format, Outcome, UsageError, stop};
use stiction_engine::analysis::gap::{DiagnosedWindow, decide_together};
use stiction_engine::analysis::{Points, Section};
use stiction_files::LoadedLoop;

/// A section of the loop in one of the files.
struct Window {
    source: String,
    one: LoadedLoop,
    points: Points,
    section: Section,
}

/// The windows, and the notes from reading them.
#[derive(Default)]
struct Read {
    windows: Vec<Window>,
    warnings: Vec<String>,
    data_loss: bool,
}

/// All windows on the command line: each section of the loop in each file.
fn read(args: &Args) -> anyhow::Result<Read> {
    let mut out = Read::default();
    let mut named: Option<(String, String)> = None;
    let sections = args.selection.sections();
    for unit in args.reading.units(&args.input)? {
        let place = unit.name();
        let loaded = args.reading.load(&unit)?;
        out.warnings.extend(loaded.warnings.iter().map(|w| format!("{place}: {w}")));
        out.data_loss |= loaded.data_loss;
        let chosen = args.selection.loops(&loaded).map_err(|e| anyhow!("{place}: {e}"))?;
        let [one] = &chosen[..] else {
            bail!("{place}: {} loops; --pool takes windows of one: choose it by --loop", chosen.len());
        };
        // A table without a loop name is named after its file.
        let stem = unit.paths.first().and_then(|path| path.file_stem());
        if stem.is_none_or(|stem| stem.to_string_lossy() != one.name.as_str()) {
            let (first, at) = named.get_or_insert_with(|| (one.name.clone(), place.clone()));
            if *first != one.name {
                let other = &one.name;
                bail!(
                    "{place}: loop {other}, but {at} has loop {first}; --pool takes windows of one loop: leave it out"
                );
            }
        }
        let points = points(one, &config_of(&unit.paths)?);
        for section in &sections {
            let source = match section {
                Section::Whole => place.clone(),
                Section::Samples(start, end) => format!("{place}, samples {start} to {end}"),
                Section::Window(..) if sections.len() == 1 => place.clone(),
                Section::Window(..) => format!("{place}, window {}", out.windows.len() + 1),
            };
            out.windows.push(Window { source, one: (*one).clone(), points: points.clone(), section: *section });
        }
    }
    Ok(out)
}

/// Diagnoses each window and gives a single answer.
///
/// # Errors
/// A file cannot be read, or a window cannot be diagnosed or does not match the others.
pub(super) fn run(args: &Args, format: Format) -> anyhow::Result<Outcome> {
    let read = read(args)?;
    if read.windows.len() < 2 {
        let message = "--pool needs two windows at least: give more files, or sections by --window or --samples";
        return Err(UsageError(message.to_owned()).into());
    }
    for warning in &read.warnings {
        tracing::warn!("{warning}");
    }
    let settings = settings(args, read.windows.len())?;
    let alone = args.others.read(&args.reading, &[])?;
    stop::watch();
    let mut windows = Vec::new();
    for window in &read.windows {
        if stop::asked() {
            bail!("{}: stopped after {} of {} windows", args.input(), windows.len(), read.windows.len());
        }
        let found: Diagnosed = diagnose(args, (&settings, &alone), &window.one, &window.points, window.section)
            .with_context(|| format!("{}; leave it out or choose another section", window.source))?;
        windows.push(DiagnosedWindow { source: window.source.clone(), alone: found });
    }
    let (shown, found) = decide_together(&windows, &settings).map_err(|e| anyhow!("{e}"))?;
    let window = &read.windows[shown];
    print(&found, args.verbose, format)?;
    write_predictions(args, &window.points, &found, window.section)?;
    if let Some(path) = &args.report {
        write_report(args, path, &read.warnings, vec![found])?;
    }
    Ok(if read.data_loss { Outcome::DataLoss } else { Outcome::Done })
}
