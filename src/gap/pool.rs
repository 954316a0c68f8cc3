//! `--pool`: files, or sections of one file, as windows of one valve.

use std::path::PathBuf;
use std::time::Duration;

use anyhow::{Context, anyhow, bail};

use super::super::reading::config_of;
use super::super::selection::{points, told, warn};
use super::super::{Format, Outcome, UsageError, stop};
use super::{Bar, Diagnose, base, predictions, print, write_report};
use stiction::gap::pool::Window;
use stiction_monitor::analysis::gap::{self, BaseChoice, Diagnosed, GapSettings, MAX_POINTS};
use stiction_monitor::analysis::predictions::rows_of_pool;
use stiction_monitor::analysis::{Cut, Points, Section};
use stiction_runtime::cores::Team;

/// The windows, with what reading them said.
#[derive(Default)]
struct Read {
    windows: Vec<(String, Points, Section)>,
    names: Vec<(String, PathBuf)>,
    warnings: Vec<String>,
    data_loss: bool,
}

/// Every window of the command line: each section of the loop in each file.
fn read(args: &Diagnose) -> anyhow::Result<Read> {
    let mut out = Read::default();
    let sections = args.selection.sections();
    for unit in args.reading.units(&args.input)? {
        let place = unit.name();
        let loaded = args.reading.load(&unit)?;
        out.warnings.extend(loaded.warnings.iter().map(|w| format!("{place}: {w}")));
        out.data_loss |= loaded.data_loss;
        let chosen = args.selection.loops(&loaded.loops).map_err(|e| anyhow!("{place}: {e}"))?;
        let [one] = &chosen[..] else {
            bail!("{place}: {} loops; --pool takes windows of one: choose it by --loop", chosen.len());
        };
        let path = unit.paths.first().cloned().unwrap_or_default();
        // A table without a name is called after its file.
        if path.file_stem().is_none_or(|stem| stem.to_string_lossy() != one.name.as_str()) {
            out.names.push((one.name.clone(), path.clone()));
        }
        let points = points(one, &config_of(&unit.paths)?);
        for section in &sections {
            let name = match section {
                Section::Whole => place.clone(),
                Section::Samples(start, end) => format!("{place}, samples {start} to {end}"),
                Section::Window(..) if sections.len() == 1 => place.clone(),
                Section::Window(..) => format!("{place}, window {}", out.windows.len() + 1),
            };
            out.windows.push((name, points.clone(), *section));
        }
    }
    let mut names = out.names.iter();
    if let Some((first, at)) = names.next()
        && let Some((other, path)) = names.find(|(name, _)| name != first)
    {
        let (at, path) = (at.display(), path.display());
        bail!("{path}: loop {other}, but {at} has loop {first}; --pool takes windows of one loop: leave it out");
    }
    Ok(out)
}

/// The records of the windows, all of one density.
fn records(args: &Diagnose, read: &[(String, Points, Section)]) -> anyhow::Result<Vec<Window>> {
    let mut all = 0;
    for (_, points, section) in read {
        all += points.samples(*section).map_err(told)?.len();
    }
    let mut cut: Cut = args.selection.cut();
    if cut.downsample.is_none() && all > MAX_POINTS {
        cut.downsample = Some(all.div_ceil(MAX_POINTS) as f64);
    }
    let window = |(source, points, section): &(String, Points, Section)| {
        let (record, notes) = gap::record(points, *section, &cut).map_err(told).with_context(|| source.clone())?;
        warn(source, &notes);
        Ok(Window { source: source.clone(), record })
    };
    read.iter().map(window).collect()
}

/// Diagnoses the windows together.
///
/// # Errors
/// A file cannot be read or does not fit the others.
pub(super) fn run(args: &Diagnose, format: Format) -> anyhow::Result<Outcome> {
    let base = args.base.as_deref().map_or(Ok(BaseChoice::Refit), base::read)?;
    let read = read(args)?;
    if read.windows.len() < 2 {
        let message = "--pool needs two windows at least: give more files, or sections by --window or --samples";
        return Err(UsageError(message.to_owned()).into());
    }
    for warning in &read.warnings {
        tracing::warn!("{warning}");
    }
    let name = read.names.first().map_or_else(|| args.input(), |(name, _)| name.clone());
    let windows = records(args, &read.windows)?;
    let settings =
        GapSettings { base, without: args.without.clone(), pairs: args.pairs, budget_s: args.budget, seed: args.seed };
    let options = settings.options_of_pool(&windows);
    stop::watch();
    let bar = Bar::new(&name, options.budget_evaluations);
    let team = Team::new(&bar, &options, args.budget.map(Duration::from_secs_f64));
    let found = gap::diagnose_pool(&name, &windows, &options, &team);
    bar.0.finish_and_clear();
    let found = found.map_err(|e| anyhow!("{e}"))?;
    if let Some(path) = &args.predictions {
        predictions::write(path, &rows_of_pool(&found.pooled)).with_context(|| path.display().to_string())?;
    }
    let (record, diagnosis) = (found.pooled.record, found.pooled.diagnosis);
    let found = Diagnosed { document: found.document, record, diagnosis };
    print(&found, format)?;
    if let Some(path) = &args.report {
        write_report(args, path, &read.warnings, vec![found])?;
    }
    Ok(if read.data_loss { Outcome::DataLoss } else { Outcome::Done })
}
