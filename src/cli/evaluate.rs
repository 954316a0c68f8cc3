//! `stictiond evaluate`: how often the verdict is right on a labelled set.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

use anyhow::{Context, bail};
use indicatif::{ProgressBar, ProgressStyle};
use serde_json::json;

use super::{Format, Outcome, analyze, say};
use crate::config::Config;
use crate::files::load_samples;
use crate::verdict::{Assessment, assess};

/// Judge a labelled set of recordings and print how often the verdict is right, wrong cases included.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "INDEX.csv has the columns file,label with paths relative to itself. Labels stiction and deadband
are positive; no_stiction, tuning and disturbance negative; others are shown but not scored.
Example: stictiond evaluate labelled/INDEX.csv"
)]
pub struct Args {
    /// The index.
    pub index: PathBuf,
}

/// What a label says.
fn truth_of(label: &str) -> Option<bool> {
    match label {
        "stiction" | "deadband" => Some(true),
        "no_stiction" | "tuning" | "disturbance" => Some(false),
        _ => None,
    }
}

struct Case {
    file: String,
    label: String,
}

struct Judged {
    case: Case,
    result: anyhow::Result<Assessment>,
    elapsed_s: f64,
}

fn read_index(path: &Path) -> anyhow::Result<Vec<Case>> {
    let mut reader = csv::ReaderBuilder::new()
        .flexible(true)
        .from_path(path)
        .with_context(|| format!("{}: cannot be read", path.display()))?;
    let headers = reader.headers()?.clone();
    let column = |name: &str| {
        let found = headers.iter().position(|h| h.trim() == name);
        found.with_context(|| format!("{}: line 1: no column {name:?}; file and label are needed", path.display()))
    };
    let (file, label) = (column("file")?, column("label")?);
    let mut cases = Vec::new();
    for row in reader.records() {
        let row = row.with_context(|| path.display().to_string())?;
        let cell = |i: usize| row.get(i).unwrap_or_default().trim().to_owned();
        if !cell(file).is_empty() {
            cases.push(Case { file: cell(file), label: cell(label) });
        }
    }
    if cases.is_empty() {
        bail!("{}: names no file", path.display());
    }
    Ok(cases)
}

fn judge(base: &Path, case: &Case) -> anyhow::Result<Assessment> {
    let loaded = load_samples(&base.join(&case.file))?;
    let Some(first) = loaded.loops.first() else { bail!("{}: holds no loop", case.file) };
    let (record, settings) = analyze::whole_record(first, &Config::with_prefix("plant"))?;
    let mut params = settings.assess.clone();
    params.always_fit = true;
    Ok(assess(&record, &params))
}

/// Judges all cases on all cores, in the index's order.
fn judge_all(base: &Path, cases: Vec<Case>) -> Vec<Judged> {
    let bar = ProgressBar::new(cases.len() as u64);
    if let Ok(style) = ProgressStyle::with_template("{bar:40} {pos}/{len} {wide_msg}") {
        bar.set_style(style);
    }
    let cores = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    let next = AtomicUsize::new(0);
    let cases = &cases;
    let mut results: Vec<(usize, anyhow::Result<Assessment>, f64)> = std::thread::scope(|scope| {
        let workers: Vec<_> = (0..cores)
            .map(|_| {
                scope.spawn(|| {
                    let mut mine = Vec::new();
                    loop {
                        let index = next.fetch_add(1, Ordering::Relaxed);
                        let Some(case) = cases.get(index) else { return mine };
                        bar.set_message(case.file.clone());
                        let started = Instant::now();
                        mine.push((index, judge(base, case), started.elapsed().as_secs_f64()));
                        bar.inc(1);
                    }
                })
            })
            .collect();
        workers.into_iter().flat_map(|w| w.join().unwrap_or_default()).collect()
    });
    bar.finish_and_clear();
    results.sort_by_key(|(index, ..)| *index);
    let judged = results.into_iter().map(|(index, result, elapsed_s)| {
        let case = Case { file: cases[index].file.clone(), label: cases[index].label.clone() };
        Judged { case, result, elapsed_s }
    });
    judged.collect()
}

/// Counts of one source (the first folder of a file's path) or of all.
#[derive(Default, Clone, Copy)]
struct Counts {
    found: usize,
    missed: usize,
    false_alarms: usize,
    cleared: usize,
    unanswered: usize,
    errors: usize,
}

impl Counts {
    fn add(&mut self, truth: bool, answer: Option<bool>) {
        match (truth, answer) {
            (_, None) => self.unanswered += 1,
            (true, Some(true)) => self.found += 1,
            (true, Some(false)) => self.missed += 1,
            (false, Some(true)) => self.false_alarms += 1,
            (false, Some(false)) => self.cleared += 1,
        }
    }

    fn right(&self) -> usize {
        self.found + self.cleared
    }

    fn total(&self) -> usize {
        self.right() + self.missed + self.false_alarms + self.unanswered + self.errors
    }
}

/// Runs the command. A case that cannot be read is an error line, not the end.
///
/// # Errors
/// The index cannot be read.
pub fn run(args: &Args, format: Format) -> anyhow::Result<Outcome> {
    let cases = read_index(&args.index)?;
    let base = args.index.parent().unwrap_or(Path::new(""));
    let judged = judge_all(base, cases);
    let mut sources: Vec<(String, Counts)> = Vec::new();
    let mut all = Counts::default();
    let mut brier: Vec<f64> = Vec::new();
    for one in &judged {
        let Some(truth) = truth_of(&one.case.label) else { continue };
        let source = one.case.file.split_once('/').map_or("", |(folder, _)| folder).to_owned();
        let place = sources.iter().position(|(name, _)| *name == source).unwrap_or_else(|| {
            sources.push((source, Counts::default()));
            sources.len() - 1
        });
        match &one.result {
            Ok(a) => {
                sources[place].1.add(truth, a.stiction);
                all.add(truth, a.stiction);
                brier.extend(a.p_stiction.map(|p| (p - f64::from(u8::from(truth))).powi(2)));
            }
            Err(_) => {
                sources[place].1.errors += 1;
                all.errors += 1;
            }
        }
    }
    let brier = (!brier.is_empty()).then(|| brier.iter().sum::<f64>() / brier.len() as f64);
    match format {
        Format::Json => print_json(&judged, &sources, all, brier)?,
        Format::Text => print_text(&judged, &sources, all, brier)?,
    }
    Ok(Outcome::Done)
}

fn print_json(judged: &[Judged], sources: &[(String, Counts)], all: Counts, brier: Option<f64>) -> anyhow::Result<()> {
    for one in judged {
        let (file, label, elapsed_s) = (&one.case.file, &one.case.label, one.elapsed_s);
        match &one.result {
            Ok(a) => say(json!({"schema": "stictiond.case.v1", "file": file, "label": label, "elapsed_s": elapsed_s,
                "scored": truth_of(label).is_some(), "right": truth_of(label).map(|t| a.stiction == Some(t)),
                "verdict": a.verdict, "stiction": a.stiction, "p_stiction": a.p_stiction, "s": a.s, "j": a.j,
                "stiction_index": a.stiction_index, "s_over_span": a.s_over_span, "gates": a.gates,
                "witnesses": a.witnesses}))?,
            Err(error) => say(json!({"schema": "stictiond.case.v1", "file": file, "label": label,
                "error": format!("{error:#}")}))?,
        }
    }
    let row = |name: &str, c: &Counts| {
        json!({"source": name, "right": c.right(), "total": c.total(), "found": c.found, "missed": c.missed,
            "false_alarms": c.false_alarms, "cleared": c.cleared, "unanswered": c.unanswered, "errors": c.errors})
    };
    let rows: Vec<_> = sources.iter().map(|(name, c)| row(name, c)).collect();
    say(json!({"schema": "stictiond.evaluation.v1", "all": row("all", &all), "sources": rows, "brier": brier}))?;
    Ok(())
}

fn print_text(judged: &[Judged], sources: &[(String, Counts)], all: Counts, brier: Option<f64>) -> anyhow::Result<()> {
    say(format!(
        "{:<10} {:>9} {:>6} {:>7} {:>6} {:>8} {:>11} {:>7}",
        "source", "right", "found", "missed", "false", "cleared", "unanswered", "errors"
    ))?;
    let named = sources.iter().map(|(name, c)| (name.as_str(), c)).chain([("all", &all)]);
    for (name, c) in named {
        let right = format!("{}/{}", c.right(), c.total());
        say(format!(
            "{name:<10} {right:>9} {:>6} {:>7} {:>6} {:>8} {:>11} {:>7}",
            c.found, c.missed, c.false_alarms, c.cleared, c.unanswered, c.errors
        ))?;
    }
    say(brier
        .map_or("Brier score: none, no probabilities are given yet".to_owned(), |b| format!("Brier score: {b:.3}")))?;
    say("\nwrong, unanswered or unreadable:")?;
    for one in judged {
        let Some(truth) = truth_of(&one.case.label) else { continue };
        match &one.result {
            Ok(a) if a.stiction != Some(truth) => {
                say(format!("  {:<50} {:<12} {}", one.case.file, one.case.label, brief(a)))?
            }
            Ok(_) => {}
            Err(error) => say(format!("  {:<50} {:<12} error: {error:#}", one.case.file, one.case.label))?,
        }
    }
    say("\nshown, not scored:")?;
    for one in judged.iter().filter(|j| truth_of(&j.case.label).is_none()) {
        match &one.result {
            Ok(a) => say(format!("  {:<50} {:<12} {}", one.case.file, one.case.label, brief(a)))?,
            Err(error) => say(format!("  {:<50} {:<12} error: {error:#}", one.case.file, one.case.label))?,
        }
    }
    Ok(())
}

fn brief(a: &Assessment) -> String {
    let number = |x: Option<f64>| x.map_or("-".to_owned(), |v| format!("{v:.2}"));
    let gates: Vec<&str> = a.gates.iter().map(|g| g.name()).collect();
    let figures = format!("index {} s/span {}", number(a.stiction_index), number(a.s_over_span));
    format!("{:<15} {figures} [{}]", a.verdict.name(), gates.join(", "))
}
