//! `stiction-lab challenge real`: real recordings with an inserted, hidden or labelled truth, and how much is explained.

mod explained;

use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use serde_json::{Value, json};

use stiction::core::gap::{Base, DEFAULT_EVALUATIONS, Diagnosis, GapOptions, Serial, diagnose};
use stiction::core::record::{Record, Signal};
use stiction_engine::config::Config;
use stiction_files::labelled::{self, Case, whole_record};
use stiction_files::load_samples;
use stiction_lab::challenge::real::{Spoilt, spoilt};
use stictiond::cli::{Format, Outcome, on_all_cores, say};

/// Most raw samples used of a recording: as many as stay raw.
const SAMPLES: usize = 1_800;

#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Index of labelled recordings (CSV), as for `evaluate`.
    index: PathBuf,
    /// Number of recordings that get inserted effects, spread over the index.
    #[arg(long, default_value_t = 12)]
    spoil: usize,
    /// Number of recordings for the other parts, spread over the index [default: all].
    #[arg(long, value_name = "N")]
    first: Option<usize>,
    /// Most model responses per search.
    #[arg(long, default_value_t = DEFAULT_EVALUATIONS)]
    evaluations: u64,
    /// Seed of the inserted effects.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Run this part of the test only.
    #[arg(long, value_enum)]
    part: Option<Part>,
}

/// Parts of the test.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Part {
    /// Insert effects: they must be found, and without them the first answer must stay.
    Spoilt,
    /// Hide the valve position, then reveal it.
    Hidden,
    /// Withhold stiction: it must be named on sticking loops and not on others.
    Linear,
    /// Share of PV that the base explains on every recording with a regular cycle, and what the best effect adds.
    Explained,
}

/// A diagnosis to run.
enum Task {
    Spoil(Case),
    Hide(Case),
    Linear(Case),
    Explain(Case),
}

impl Task {
    const fn case(&self) -> &Case {
        match self {
            Self::Spoil(case) | Self::Hide(case) | Self::Linear(case) | Self::Explain(case) => case,
        }
    }
}

/// The first samples of a file's first loop.
fn record_of(base: &Path, case: &Case) -> anyhow::Result<Record> {
    let loaded = load_samples(&base.join(&case.file))?;
    let Some(mut first) = loaded.loops.into_iter().next() else {
        bail!("{}: no loop found; a loop needs an OP and a PV", case.file)
    };
    let last = first.samples.iter().filter(|s| s.signal == Signal::Pv).map(|s| s.t_ns).nth(SAMPLES);
    if let Some(last) = last {
        first.samples.retain(|s| s.t_ns < last);
    }
    Ok(whole_record(&first, &Config::with_prefix("plant"))?.record)
}

/// Every recording once, in index order.
fn distinct(cases: &[Case]) -> Vec<Case> {
    let mut out: Vec<Case> = Vec::new();
    for case in cases {
        if out.iter().all(|other| other.group != case.group) {
            out.push(case.clone());
        }
    }
    out
}

/// This many cases, evenly spread.
fn spread(cases: &[Case], wanted: Option<usize>) -> Vec<Case> {
    let wanted = wanted.unwrap_or(cases.len());
    let every = cases.len().div_ceil(wanted.max(1)).max(1);
    cases.iter().step_by(every).take(wanted).cloned().collect()
}

fn tasks(args: &Args, cases: &[Case], base: &Path) -> Vec<Task> {
    let wanted = |part| args.part.is_none_or(|only| only == part);
    let mut out = Vec::new();
    if wanted(Part::Spoilt) {
        out.extend(spread(cases, Some(args.spoil)).into_iter().map(Task::Spoil));
    }
    if wanted(Part::Hidden) {
        let with_mv = cases.iter().filter(|case| record_of(base, case).is_ok_and(|r| r.mv.is_some()));
        let with_mv: Vec<Case> = with_mv.cloned().collect();
        out.extend(spread(&with_mv, args.first).into_iter().map(Task::Hide));
    }
    if wanted(Part::Linear) {
        let labelled: Vec<Case> = cases.iter().filter(|case| case.truth().is_some()).cloned().collect();
        out.extend(spread(&labelled, args.first).into_iter().map(Task::Linear));
    }
    if wanted(Part::Explained) {
        out.extend(spread(cases, args.first).into_iter().map(Task::Explain));
    }
    out
}

/// Runs the command. A recording that cannot be diagnosed gives a line and does not end the command.
///
/// # Errors
/// The index cannot be read.
pub(super) fn run(args: &Args, format: Format) -> anyhow::Result<Outcome> {
    let cases = distinct(&labelled::read(&args.index)?);
    let base = args.index.parent().unwrap_or(Path::new(""));
    let tasks = tasks(args, &cases, base);
    let options = GapOptions { budget_evaluations: args.evaluations, ..GapOptions::default() };
    let work = |task: &Task| -> Value {
        let found = record_of(base, task.case()).and_then(|record| match task {
            Task::Spoil(_) => spoil(&record, &options, args.seed),
            Task::Hide(_) => hide(&record, &options),
            Task::Linear(case) => linear(&record, &options, case),
            Task::Explain(_) => explained::of(&record, &options),
        });
        let found = found.with_context(|| task.case().file.clone());
        let mut line = found.unwrap_or_else(|error| json!({ "error": format!("{error:#}") }));
        line["file"] = json!(task.case().file);
        line["label"] = json!(task.case().label);
        line
    };
    let lines = on_all_cores(&tasks, |task| task.case().file.clone(), work);
    match format {
        Format::Json => lines.iter().try_for_each(say)?,
        Format::Text => table(&lines)?,
    }
    Ok(Outcome::Done)
}

fn called(diagnosis: &Diagnosis) -> Value {
    json!({ "cause": diagnosis.cause.id, "stage": diagnosis.cause.stage.name(), "probability": diagnosis.cause.probability })
}

fn spoil(record: &Record, options: &GapOptions, seed: u64) -> anyhow::Result<Value> {
    let before = diagnose(record, options, &Serial)?;
    let mut made = Vec::new();
    for Spoilt { effect, record } in spoilt(record, seed) {
        made.push(match diagnose(&record, options, &Serial) {
            Ok(after) => {
                let lacking = GapOptions { without: vec![effect.to_owned()], ..options.clone() };
                let without = diagnose(&record, &lacking, &Serial)?.cause.id;
                json!({ "effect": effect, "answer": called(&after), "found": after.cause.id == effect,
                    "without": without, "kept": without == before.cause.id })
            }
            Err(error) => json!({ "effect": effect, "error": error.to_string() }),
        });
    }
    Ok(json!({ "part": "spoilt", "before": called(&before), "made": made }))
}

fn hide(record: &Record, options: &GapOptions) -> anyhow::Result<Value> {
    let blind = diagnose(&Record { mv: None, ..record.clone() }, options, &Serial)?;
    let seen = diagnose(record, options, &Serial)?;
    let gaps = seen
        .findings
        .stages
        .as_ref()
        .map(|s| json!({ "op_to_mv_pct": s.op_to_mv, "mv_to_pv": s.mv_to_pv, "stage": s.stage.name() }));
    Ok(json!({ "part": "hidden", "hidden": called(&blind), "revealed": called(&seen), "gaps": gaps }))
}

fn linear(record: &Record, options: &GapOptions, case: &Case) -> anyhow::Result<Value> {
    let found = diagnose(record, &GapOptions { base: Base::Linear, ..options.clone() }, &Serial)?;
    let named = found.cause.id == "stiction";
    Ok(json!({ "part": "linear", "answer": called(&found), "named": named, "right": case.truth() == Some(named) }))
}

fn text(value: &Value) -> &str {
    value.as_str().unwrap_or("-")
}

/// The tables of the parts with totals.
fn table(lines: &[Value]) -> anyhow::Result<()> {
    let of = |part: &'static str| lines.iter().filter(move |l| l["part"] == part);
    for line in lines.iter().filter(|l| l["error"].is_string()) {
        say(format!("{:<44} {}", text(&line["file"]), text(&line["error"])))?;
    }
    let (mut found, mut kept, mut all) = (0, 0, 0);
    for line in of("spoilt") {
        say(format!("{:<44} unchanged: {}", text(&line["file"]), text(&line["before"]["cause"])))?;
        for made in line["made"].as_array().into_iter().flatten() {
            let (is_found, is_kept) = (made["found"] == true, made["kept"] == true);
            (found, kept, all) = (found + usize::from(is_found), kept + usize::from(is_kept), all + 1);
            let answer = made["answer"]["cause"].as_str().unwrap_or_else(|| text(&made["error"]));
            say(format!(
                "    {:<20} with it {answer:<22} without it {}",
                text(&made["effect"]),
                text(&made["without"])
            ))?;
        }
    }
    if all > 0 {
        say(format!("inserted effects: {found} of {all} found; first answer kept without them in {kept} of {all}\n"))?;
    }
    for line in of("hidden") {
        let (blind, seen) = (&line["hidden"], &line["revealed"]);
        say(format!("{:<44} MV hidden: {} ({})", text(&line["file"]), text(&blind["cause"]), text(&blind["stage"])))?;
        let gaps = &line["gaps"];
        let number = |name: &str| gaps[name].as_f64().map_or_else(|| "-".to_owned(), |v| format!("{v:.3}"));
        say(format!(
            "    revealed: {} ({}); the two partial gaps give {}: OP to MV {} % left, MV to PV {}",
            text(&seen["cause"]),
            text(&seen["stage"]),
            text(&gaps["stage"]),
            number("op_to_mv_pct"),
            number("mv_to_pv")
        ))?;
    }
    let rows: Vec<&Value> = of("linear").collect();
    for line in &rows {
        say(format!(
            "{:<44} {:<14} answered {}",
            text(&line["file"]),
            text(&line["label"]),
            text(&line["answer"]["cause"])
        ))?;
    }
    if !rows.is_empty() {
        let sticking = |l: &&&Value| matches!(text(&l["label"]), "stiction" | "deadband");
        let named = |sticks: bool| {
            let its = rows.iter().filter(|l| sticking(l) == sticks);
            let (yes, all) = its.fold((0, 0), |(yes, all), l| (yes + usize::from(l["named"] == true), all + 1));
            format!("{yes} of {all}")
        };
        say(format!(
            "stiction withheld: stiction named on {} sticking loops and on {} others",
            named(true),
            named(false)
        ))?;
    }
    explained::table(&of("explained").collect::<Vec<_>>())
}
