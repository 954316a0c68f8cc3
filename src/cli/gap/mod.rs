//! `stictiond gap`: where the simulation departs from the plant, which effect causes it, how far adding it closes the gap.

mod base;
mod crew;
mod predictions;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::{Context, bail};

use super::analyze::{self, Points};
use super::{Format, Outcome, UsageError, asked_to_stop, block_on, say};
use crate::config::Config;
use crate::detect::oscillation;
use crate::files::{LoadedLoop, load_samples};
use crate::gap::document::GapDocument;
use crate::gap::{self, Ask, Diagnosis, GapError, effects, locate, text};
use crate::record::Record;
use base::BaseArg;
use crew::Team;

/// Most points of a simulation: sections with more samples are averaged in boxes.
const MAX_POINTS: usize = 8_192;
/// Seconds that the default number of evaluations takes on two cores, about.
const DEFAULT_SECONDS: f64 = 5.0;

/// Diagnose the gap between a loop's model and its record: where it lies, which unmodelled effect causes it, and how
/// far it shrinks once that effect is added.
///
/// The gap is measured in free run, on stretches that no model was fitted to, from a sticking valve (He's law) before a
/// first-order process with dead time.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  stictiond gap recordings/sticking.mcap
  stictiond gap loop4.csv --samples 50,900 --predictions loop4-gap.csv
  stictiond gap june.csv --base may.json          # may.json: stictiond gap may.csv --format json
  stictiond gap plant.mcap --loop FIC101 --without extra_lag --format json")]
pub struct Args {
    /// A .csv file (columns t,op,pv[,sp][,mv][,mode]) or a recording (.mcap, .mcap.part).
    pub input: PathBuf,
    /// Only this loop.
    #[arg(long = "loop", value_name = "NAME")]
    pub loop_name: Option<String>,
    /// Samples START to END, counted from 1, ends included; may be given several times.
    #[arg(long, value_name = "START,END", value_parser = analyze::samples_range)]
    pub samples: Vec<(usize, usize)>,
    /// From time T0 to T1, ends included: seconds since 1970 or RFC 3339; ns as in documents with the suffix ns.
    #[arg(long, value_name = "T0,T1", value_parser = analyze::time_range, conflicts_with = "samples")]
    pub window: Option<(i64, i64)>,
    /// A model to measure the gap from as well (an estimate, a gap document's model or a plain one, JSON), or `linear`
    /// for a base without friction.
    #[arg(long, value_name = "FILE.json|linear")]
    pub base: Option<String>,
    /// Take an effect out of the catalogue; may be given several times.
    #[arg(long, value_name = "ID")]
    pub without: Vec<String>,
    /// Also try two effects at once.
    #[arg(long)]
    pub pairs: bool,
    /// Time for the search, a loop.
    #[arg(long, value_name = "SECONDS", value_parser = seconds)]
    pub budget: Option<f64>,
    /// Write measured and simulated PV, from which every figure can be computed again.
    #[arg(long, value_name = "FILE.csv")]
    pub predictions: Option<PathBuf>,
    /// Replace existing outputs.
    #[arg(long)]
    pub force: bool,
    /// Seed of every random choice.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
}

fn seconds(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| format!("{text:?} is not a number"))?;
    if value.is_finite() && value > 0.0 { Ok(value) } else { Err("write a number of seconds above 0".to_owned()) }
}

/// One section of one loop, diagnosed.
struct Done {
    name: String,
    record: Record,
    diagnosis: Diagnosis,
    document: GapDocument,
}

/// Runs the command.
///
/// # Errors
/// The file cannot be read, the loop or section does not exist, an id is unknown, or nothing in it can be diagnosed.
pub fn run(args: &Args, format: Format) -> anyhow::Result<Outcome> {
    check(args)?;
    let base = args.base.as_deref().map(BaseArg::read).transpose()?;
    let loaded = load_samples(&args.input)?;
    for warning in &loaded.warnings {
        tracing::warn!("{warning}");
    }
    let config = analyze::config_of(&args.input)?.map_or_else(|| Config::with_prefix("plant"), |r| r.config);
    let chosen = analyze::choose(&loaded.loops, args.loop_name.as_deref(), &args.input)?;
    let sections: Vec<Option<(usize, usize)>> =
        if args.samples.is_empty() { vec![None] } else { args.samples.iter().copied().map(Some).collect() };
    let alone = chosen.len() * sections.len() == 1;
    if !alone && args.predictions.is_some() {
        let message = "--predictions holds one section of one loop: choose it by --loop and --samples or --window";
        return Err(UsageError(message.to_owned()).into());
    }
    let stop = stop_flag();
    let mut done = 0;
    for one in &chosen {
        let points = Points::of(one, &config);
        for section in &sections {
            if stop.load(Ordering::Relaxed) {
                break;
            }
            match diagnose(args, base.as_ref(), one, &points, *section, &stop) {
                Ok(found) => {
                    done += 1;
                    print(&found, format)?;
                    write_predictions(args, &points, &found, *section)?;
                }
                Err(error) if !alone && !error.is::<UsageError>() => tracing::warn!("{error:#}"),
                Err(error) => return Err(error),
            }
        }
    }
    if done == 0 && !stop.load(Ordering::Relaxed) {
        bail!("{}: no loop could be diagnosed", args.input.display());
    }
    Ok(if loaded.data_loss { Outcome::DataLoss } else { Outcome::Done })
}

/// What can be refused before anything is read.
fn check(args: &Args) -> anyhow::Result<()> {
    for id in &args.without {
        if !effects::ALL.iter().any(|e| e.id == id.as_str()) {
            let known = effects::ALL.iter().map(|e| e.id).collect::<Vec<_>>().join(", ");
            return Err(UsageError(GapError::UnknownEffect { id: id.clone(), known }.to_string()).into());
        }
    }
    if let Some(path) = args.predictions.as_ref().filter(|path| path.exists() && !args.force) {
        bail!("{}: exists already; --force replaces it", path.display());
    }
    Ok(())
}

/// Becomes true on SIGINT or SIGTERM.
fn stop_flag() -> Arc<AtomicBool> {
    let flag = Arc::new(AtomicBool::new(false));
    let own = Arc::clone(&flag);
    std::thread::spawn(move || {
        if block_on(asked_to_stop()).is_ok() {
            own.store(true, Ordering::Relaxed);
        }
    });
    flag
}

fn diagnose(
    args: &Args,
    base: Option<&BaseArg>,
    one: &LoadedLoop,
    points: &Points,
    section: Option<(usize, usize)>,
    stop: &AtomicBool,
) -> anyhow::Result<Done> {
    let record = points.record_of(&one.name, args.window, section, MAX_POINTS)?;
    let period = oscillation::detect(&record.op(), &record.pv).map(|o| o.period_points);
    let share = args.budget.map_or(1.0, |seconds| seconds / DEFAULT_SECONDS);
    let ask = Ask {
        base: base.map(|b| b.on(&record)).unwrap_or_default(),
        without: args.without.clone(),
        pairs: args.pairs,
        budget_evaluations: (gap::DEFAULT_EVALUATIONS as f64 * share).ceil() as u64,
        seed: args.seed,
        period_points: period,
    };
    let team = Team::new(&one.name, &ask, args.budget.map(Duration::from_secs_f64), stop);
    let diagnosis = gap::diagnose(&record, &ask, &team);
    team.finish();
    let diagnosis = diagnosis.with_context(|| format!("{}: loop {}", args.input.display(), one.name))?;
    let location = locate::locate(&record, &diagnosis, period, args.seed);
    let document = GapDocument::new(&one.name, &record, &ask.base, &diagnosis, location);
    Ok(Done { name: one.name.clone(), record, diagnosis, document })
}

fn print(found: &Done, format: Format) -> anyhow::Result<()> {
    match format {
        Format::Json => say(serde_json::to_string(&found.document)?)?,
        Format::Text => say(text::report(&found.document))?,
    }
    Ok(())
}

fn write_predictions(
    args: &Args,
    points: &Points,
    found: &Done,
    section: Option<(usize, usize)>,
) -> anyhow::Result<()> {
    let Some(path) = &args.predictions else { return Ok(()) };
    let whole = points.samples(&found.name, args.window, section)?;
    let rows = predictions::rows(&whole, &found.record, &found.diagnosis);
    predictions::write(path, &rows).with_context(|| path.display().to_string())
}

/// Where the file stands for a command line that can be pasted.
pub(super) fn shown(path: &Path) -> String {
    let text = path.display().to_string();
    if text.contains([' ', '\'', '"']) { format!("'{}'", text.replace('\'', "'\\''")) } else { text }
}
