//! `stiction-lab challenge`: makes loops with a hidden cause, diagnoses and scores them, by separate commands that share
//! the truth only as a sealed file.

mod answer;
mod calibrate;
mod neighbours;
mod picture;
mod real;
mod withhold;

use std::collections::BTreeMap;
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Mutex;

use anyhow::{Context, bail};
use serde_json::{Value, json};

use stiction::core::gap::{DEFAULT_EVALUATIONS, GapOptions};
use stiction::core::record::{Record, Sample, Signal};
use stiction::core::units::ns_from_s;
use stiction_engine::config::Config;
use stiction_engine::provenance;
use stiction_files::labelled::whole_record;
use stiction_files::{LoadedLoop, csv, load_samples};
use stiction_lab::calibrate_gap::search_id;
use stiction_lab::challenge::score::{Answer, Figures, score};
use stiction_lab::challenge::{Deck, Split, Truth, TruthCase, seal};
use stictiond::cli::{Format, Outcome, UsageError, of_build, on_all_cores, print, say};

/// File names in a challenge's folder.
const RECORDINGS: &str = "recordings";
const TRUTH: &str = "truth.json";
const SEALED: &str = "truth.sha256";
const ANSWERS: &str = "answers.jsonl";
const SCORE: &str = "score.json";
const CONFUSION: &str = "confusion.svg";
/// Time of every recording's first sample, s since 1970.
const START_S: f64 = 1_700_000_000.0;

/// Test the gap diagnosis on hidden causes: simulate loops with independent physics, diagnose them without their truth,
/// open the sealed truth and score.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:
  stiction-lab challenge new --seed 2 --cases 4 --out check
  stiction-lab challenge run check
  stiction-lab challenge score check
  stiction-lab challenge calibrate check-a --out crates/stiction/src/core/gap/calibration.json --force
Odd seeds are split A, the development set; even seeds are split B, the test set.")]
pub struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, clap::Subcommand)]
enum Command {
    /// Make recordings and their truth, sealed by its SHA-256.
    New(NewArgs),
    /// Diagnose the recordings. Resumes an interrupted run.
    Run(RunArgs),
    /// Open the truth and diagnose answered recordings again, each by a catalogue without its effect.
    Withhold(withhold::Args),
    /// Check the truth's seal, open it, and print all figures.
    Score(ScoreArgs),
    /// Fit the decision's numbers to answered challenges of split A.
    Calibrate(calibrate::Args),
    /// Test on real recordings: with effects inserted, with the valve position hidden, with stiction withheld.
    Real(real::Args),
    /// Test other loops as causes: the one that acts withheld and revealed among unrelated loops of nearly the same period.
    Neighbours(neighbours::Args),
}

#[derive(Debug, clap::Args)]
struct NewArgs {
    /// Seed of all random draws.
    #[arg(long)]
    seed: u64,
    /// Cases per effect. Ten times as many loops without an effect are added; a tenth of the others have two.
    #[arg(long, default_value_t = 4)]
    cases: usize,
    /// Split: A (development) or B (test) [default: A for an odd seed, B for an even one].
    #[arg(long, value_enum)]
    split: Option<SplitArg>,
    /// New folder for the challenge.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum SplitArg {
    A,
    B,
}

#[derive(Debug, clap::Args)]
struct RunArgs {
    /// Folder of the challenge.
    dir: PathBuf,
    /// Most model responses per search.
    #[arg(long, default_value_t = DEFAULT_EVALUATIONS)]
    evaluations: u64,
    /// Seed of the diagnosis's random choices.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Diagnose only the first N recordings.
    #[arg(long, value_name = "N")]
    first: Option<usize>,
    /// Discard earlier answers.
    #[arg(long)]
    force: bool,
}

#[derive(Debug, clap::Args)]
struct ScoreArgs {
    /// Folder of the challenge.
    dir: PathBuf,
    /// Score although some recordings are not answered.
    #[arg(long)]
    partial: bool,
    /// Score this version's decision on the answers' stored fits, without new searches.
    #[arg(long)]
    again: bool,
}

/// Runs the command.
///
/// # Errors
/// A folder cannot be read or written, the truth was changed, or answers are missing.
pub fn run(args: &Args, format: Format) -> anyhow::Result<Outcome> {
    match &args.command {
        Command::New(args) => new(args, format),
        Command::Run(args) => answer_all(args, format),
        Command::Withhold(args) => withhold::run(args, format),
        Command::Score(args) => of_build(score_all(args, format), format, &provenance()),
        Command::Calibrate(args) => calibrate::run(args, format),
        Command::Real(args) => real::run(args, format),
        Command::Neighbours(args) => neighbours::run(args, format),
    }
}

fn read(path: &Path) -> anyhow::Result<Vec<u8>> {
    fs::read(path).with_context(|| format!("cannot read {}; name the folder of a challenge", path.display()))
}

fn write(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    fs::write(path, bytes).with_context(|| format!("cannot write {}", path.display()))
}

/// The samples of a record as a historian would export them.
fn samples_of(record: &Record) -> Vec<Sample> {
    let mut out = Vec::new();
    let columns = [
        (Signal::Op, Some(&record.op_path)),
        (Signal::Pv, Some(&record.pv)),
        (Signal::Sp, record.sp.as_ref()),
        (Signal::Mv, record.mv.as_ref()),
    ];
    for k in 0..record.len() {
        let t_ns = ns_from_s(START_S + record.ts_s * k as f64);
        for (signal, values) in &columns {
            let Some(value) = values.and_then(|v| v.get(k)) else { continue };
            out.push(Sample {
                signal: *signal,
                t_ns,
                value: stiction::core::record::Value::number(*value),
                quality: None,
            });
        }
    }
    out
}

fn new(args: &NewArgs, format: Format) -> anyhow::Result<Outcome> {
    if args.cases == 0 {
        return Err(UsageError("--cases must be 1 or more".to_owned()).into());
    }
    if args.out.exists() {
        bail!("{}: already exists; name a new folder", args.out.display());
    }
    let split = match args.split {
        Some(SplitArg::A) => Split::A,
        Some(SplitArg::B) => Split::B,
        None => Split::of_seed(args.seed),
    };
    let deck = Deck::new(args.seed, split, args.cases);
    let folder = args.out.join(RECORDINGS);
    fs::create_dir_all(&folder).with_context(|| format!("cannot create {}", folder.display()))?;
    let numbers: Vec<usize> = (0..deck.len()).collect();
    let deal = |index: &usize| -> anyhow::Result<Option<TruthCase>> {
        let Some(dealt) = deck.deal(*index) else { return Ok(None) };
        let mut table = Vec::new();
        csv::write(&LoadedLoop::new("", samples_of(&dealt.record)), &mut table)?;
        write(&folder.join(format!("{}.csv", dealt.name)), &table)?;
        Ok(Some(dealt.truth))
    };
    let dealt: anyhow::Result<Vec<_>> =
        on_all_cores(&numbers, |k| format!("loop {}", k + 1), deal).into_iter().collect();
    let truth = deck.truth(dealt?.into_iter().flatten().collect());
    let bytes = truth.to_bytes()?;
    let sealed = seal(&bytes);
    write(&args.out.join(TRUTH), &bytes)?;
    write(&args.out.join(SEALED), format!("{sealed}\n").as_bytes())?;
    match format {
        Format::Json => say(json!({ "schema": "stictiond.challenge.v1", "seed": args.seed, "split": split.name(),
            "recordings": truth.cases.len(), "truth_sha256": sealed }))?,
        Format::Text => say(format!(
            "{} recordings in {}\nsplit {}, seed {}\nSHA-256 of the truth: {sealed}",
            truth.cases.len(),
            folder.display(),
            split.name(),
            args.seed
        ))?,
    }
    Ok(Outcome::Done)
}

/// The recordings of a challenge, by name.
fn recordings(dir: &Path) -> anyhow::Result<Vec<PathBuf>> {
    let folder = dir.join(RECORDINGS);
    let entries = fs::read_dir(&folder)
        .with_context(|| format!("cannot read {}; name the folder of a challenge", folder.display()))?;
    let mut found = Vec::new();
    for entry in entries {
        let path = entry?.path();
        if path.extension().is_some_and(|e| e == "csv") {
            found.push(path);
        }
    }
    found.sort();
    if found.is_empty() {
        bail!("{}: has no recordings; make them with `challenge new`", folder.display());
    }
    Ok(found)
}

fn name_of(path: &Path) -> String {
    path.file_stem().map_or_else(String::new, |s| s.to_string_lossy().into_owned())
}

/// The first loop of a file, whole.
fn record_of(path: &Path) -> anyhow::Result<Record> {
    let loaded = load_samples(path)?;
    let Some(first) = loaded.loops.first() else {
        bail!("{}: no loop found; a loop needs an OP and a PV", path.display())
    };
    Ok(whole_record(first, &Config::with_prefix("plant"))?.record)
}

/// Earlier answers by recording; a truncated line is ignored.
fn answered(path: &Path, made_with: &Value) -> anyhow::Result<BTreeMap<String, String>> {
    let mut out = BTreeMap::new();
    if !path.exists() {
        return Ok(out);
    }
    let text = String::from_utf8_lossy(&read(path)?).into_owned();
    for line in text.lines() {
        let Ok(value) = serde_json::from_str::<Value>(line) else { continue };
        let Some(name) = value["recording"].as_str() else { continue };
        if value["made_with"] != *made_with {
            bail!(
                "{}: {name} was answered with {}, but this run uses {made_with}; use --force to start over",
                path.display(),
                value["made_with"]
            );
        }
        out.insert(name.to_owned(), line.to_owned());
    }
    Ok(out)
}

fn lines(answers: &BTreeMap<String, String>) -> String {
    answers.values().map(|line| format!("{line}\n")).collect()
}

fn answer_all(args: &RunArgs, format: Format) -> anyhow::Result<Outcome> {
    let path = args.dir.join(ANSWERS);
    // Answers of different searches must not be mixed.
    let made_with = json!({ "version": stiction::core::VERSION, "search": search_id()?, "evaluations": args.evaluations,
        "seed": args.seed });
    let mut all = recordings(&args.dir)?;
    all.truncate(args.first.unwrap_or(usize::MAX));
    let before = if args.force { BTreeMap::new() } else { answered(&path, &made_with)? };
    // Drop a line truncated by a kill: it would corrupt the next one.
    write(&path, lines(&before).as_bytes())?;
    let file = fs::OpenOptions::new().append(true).open(&path).with_context(|| path.display().to_string())?;
    let file = Mutex::new(file);
    let left: Vec<PathBuf> = all.iter().filter(|p| !before.contains_key(&name_of(p))).cloned().collect();
    let options = GapOptions { budget_evaluations: args.evaluations, seed: args.seed, ..GapOptions::default() };
    let work = |recording: &PathBuf| -> anyhow::Result<(String, String)> {
        let name = name_of(recording);
        let result = record_of(recording).and_then(|record| answer::ask_for(&name, &record, &options));
        let line = answer::line(&name, &made_with, &result).to_string();
        let mut file = file.lock().map_err(|_| anyhow::anyhow!("{}: another thread failed", path.display()))?;
        writeln!(file, "{line}").with_context(|| path.display().to_string())?;
        Ok((name, line))
    };
    let fresh: anyhow::Result<Vec<_>> = on_all_cores(&left, |p| name_of(p), work).into_iter().collect();
    let mut answers = before;
    answers.extend(fresh?);
    write(&path, lines(&answers).as_bytes())?;
    let failed = answers.values().filter(|line| line.contains("\"document\":null")).count();
    match format {
        Format::Json => say(json!({ "answers": answers.len(), "failed": failed }))?,
        Format::Text => {
            say(format!("{} answers in {}, {failed} could not be diagnosed", answers.len(), path.display()))?;
        }
    }
    Ok(Outcome::Done)
}

/// The truth of a folder, if its seal matches.
fn opened(dir: &Path) -> anyhow::Result<Truth> {
    let path = dir.join(TRUTH);
    let sealed = String::from_utf8_lossy(&read(&dir.join(SEALED))?).into_owned();
    Truth::open(&read(&path)?, &sealed).with_context(|| path.display().to_string())
}

fn score_all(args: &ScoreArgs, format: Format) -> anyhow::Result<Outcome> {
    let mut truth = opened(&args.dir)?;
    let path = args.dir.join(ANSWERS);
    let text = String::from_utf8_lossy(&read(&path)?).into_owned();
    let answers: Result<Vec<Answer>, _> = text.lines().map(serde_json::from_str).collect();
    let answers = answers.with_context(|| format!("cannot read {}; run the challenge again", path.display()))?;
    if args.partial {
        truth.cases.retain(|case| answers.iter().any(|a| a.recording == case.name));
    }
    let figures = if args.again { calibrate::decided_again(&args.dir, &truth)? } else { score(&truth, &answers)? };
    write(&args.dir.join(SCORE), &serde_json::to_vec_pretty(&figures)?)?;
    write(&args.dir.join(CONFUSION), picture::confusion(&figures)?.as_bytes())?;
    show(&figures, format)
}

fn show(figures: &Figures, format: Format) -> anyhow::Result<Outcome> {
    match format {
        Format::Json => say(serde_json::to_string(figures)?)?,
        Format::Text => print(&figures.text())?,
    }
    Ok(Outcome::Done)
}
