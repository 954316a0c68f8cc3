//! `stictiond gap`: where the simulation departs from the plant, which effect causes it, and how far adding it closes the gap.

mod base;
mod neighbours;
mod pool;
mod predictions;

use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context, anyhow, bail};

use self::neighbours::{NeighbourArgs, Neighbours};
use crate::cli::reading::{ReadArgs, config_of, named};
use crate::cli::selection::{Selection, points, told, warn};
use crate::cli::{Format, Outcome, UsageError, say, stop};
use crate::report::command::command_line;
use crate::report::{GapReport, gap_page};
use crate::runtime::cores::{Team, Watch};
use indicatif::{ProgressBar, ProgressStyle};
use stiction::core::gap::{GapError, effects};
use stiction::words::gap_text;
use stiction_engine::analysis::gap::{BaseChoice, Diagnosed, GapSettings};
use stiction_engine::analysis::predictions::rows;
use stiction_engine::analysis::{self, Points, Section};
use stiction_files::LoadedLoop;

/// Diagnose the gap between a loop's model and its record: where it lies, which unmodelled effect causes it, and how
/// far it shrinks once that effect is added.
///
/// The gap is measured in free run, on stretches that no model was fitted to, from a sticking valve (He's law) before a
/// first-order process with dead time.
#[derive(Debug, clap::Args)]
#[command(arg_required_else_help = true)]
#[command(after_help = "Examples:
  stictiond gap recordings/sticking.mcap
  stictiond gap loop4.csv --samples 50,900 --predictions loop4-gap.csv
  stictiond gap june.csv --base may.json          # may.json: stictiond gap may.csv --format json
  stictiond gap plant.mcap --loop FIC101 --without extra_lag --format json
  stictiond gap plant.mcap --loop FIC101 --other-loops
  stictiond gap may.csv june.csv july.csv --pool")]
pub struct Args {
    /// Tables (columns t,op,pv[,sp][,mv][,mode]), exports, recordings (.mcap, .mcap.part), compact stores (.mat), or
    /// folders of them.
    #[arg(required = true)]
    pub input: Vec<PathBuf>,
    /// How exports are read.
    #[command(flatten)]
    pub reading: ReadArgs,
    /// Loop, section, density.
    #[command(flatten)]
    pub selection: Selection,
    /// A model to measure the gap from as well (an estimate, a gap document's model or a plain one, JSON), or `linear`
    /// for a base without friction.
    #[arg(long, value_name = "FILE.json|linear")]
    pub base: Option<String>,
    /// Take an effect out of the catalogue; may be given several times.
    #[arg(long, value_name = "ID")]
    pub without: Vec<String>,
    /// Try two effects at once also where one alone explains the record.
    #[arg(long)]
    pub pairs: bool,
    /// Take the files, or the sections of one file, for windows of one valve: each is diagnosed by itself, and one answer is given
    /// from the evidence of all, with the window that shows it best.
    #[arg(long, conflicts_with_all = ["neighbours", "other_loops"])]
    pub pool: bool,
    /// Time for the search, a loop; without it some 5 s of two cores at most, much less where the base explains all.
    #[arg(long, value_name = "SECONDS", value_parser = seconds, allow_negative_numbers = true)]
    pub budget: Option<f64>,
    /// Write measured and simulated PV, from which every figure can be computed again.
    #[arg(long, value_name = "FILE.csv")]
    pub predictions: Option<PathBuf>,
    /// Write a page with pictures: simulation against plant before and after, and where the gap lies.
    #[arg(long, value_name = "FILE.html")]
    pub report: Option<PathBuf>,
    /// Print all figures behind the answer, too.
    #[arg(long)]
    pub verbose: bool,
    /// Replace existing outputs.
    #[arg(long)]
    pub force: bool,
    /// Seed of every random choice.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Other loops.
    #[command(flatten)]
    pub others: NeighbourArgs,
}

fn seconds(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| format!("{text:?} is not a number"))?;
    if value.is_finite() && value > 0.0 { Ok(value) } else { Err("write a number of seconds above 0".to_owned()) }
}

impl Args {
    fn input(&self) -> String {
        named(&self.input)
    }
}

/// Runs the command: every chosen loop and section of one file.
///
/// # Errors
/// The file cannot be read, the loop or section does not exist, an id is unknown, or nothing in it can be diagnosed.
pub fn run(args: &Args, format: Format) -> anyhow::Result<Outcome> {
    check(args)?;
    if args.pool {
        return pool::run(args, format);
    }
    let settings = settings(args, 1)?;
    let loaded = args.reading.load_all(&args.input)?;
    for warning in &loaded.warnings {
        tracing::warn!("{warning}");
    }
    let config = config_of(&args.input)?;
    let place = args.input();
    let chosen = args.selection.loops(&loaded).map_err(|e| anyhow!("{place}: {e}"))?;
    let neighbours = args.others.read(&args.reading, &loaded.loops)?;
    let sections = args.selection.sections();
    let wanted = chosen.len() * sections.len();
    if wanted > 1 && args.predictions.is_some() {
        let message = "--predictions holds one section of one loop: choose it by --loop and --samples or --window";
        return Err(UsageError(message.to_owned()).into());
    }
    stop::watch();
    let (mut done, mut answered) = (Vec::new(), 0);
    for (one, section) in chosen.iter().flat_map(|one| sections.iter().map(move |section| (one, *section))) {
        if stop::asked() {
            break;
        }
        let points = points(one, &config);
        answered += 1;
        match diagnose(args, (&settings, &neighbours), one, &points, section) {
            Ok(found) => {
                print(&found, args.verbose, format)?;
                write_predictions(args, &points, &found, section)?;
                done.push(found);
            }
            Err(error) if wanted > 1 && !error.is::<UsageError>() => tracing::warn!("{error:#}"),
            Err(error) => return Err(error),
        }
    }
    let count = done.len();
    if let Some(path) = args.report.as_ref().filter(|_| count > 0) {
        write_report(args, path, &loaded.warnings, done)?;
    }
    if stop::asked() && answered < wanted {
        bail!("{place}: stopped after {answered} of {wanted} sections");
    }
    if count == 0 {
        bail!("{place}: no loop could be diagnosed");
    }
    Ok(if loaded.data_loss { Outcome::DataLoss } else { Outcome::Done })
}

/// Checks that need no data.
fn check(args: &Args) -> anyhow::Result<()> {
    for id in &args.without {
        if !effects::ALL.iter().any(|e| e.id == id.as_str()) {
            let known = effects::ALL.iter().map(|e| e.id).collect::<Vec<_>>().join(", ");
            return Err(UsageError(GapError::UnknownEffect { id: id.clone(), known }.to_string()).into());
        }
    }
    for path in args.predictions.iter().chain(&args.report) {
        if path.exists() && !args.force {
            bail!("{}: exists already; --force replaces it", path.display());
        }
        if let Some(folder) = path.parent().filter(|folder| !folder.as_os_str().is_empty() && !folder.is_dir()) {
            bail!("{}: there is no folder {}; make it first", path.display(), folder.display());
        }
    }
    Ok(())
}

/// Options for a diagnosis of `windows` windows that share the time budget.
fn settings(args: &Args, windows: usize) -> anyhow::Result<GapSettings> {
    Ok(GapSettings {
        base: args.base.as_deref().map_or(Ok(BaseChoice::Refit), base::read)?,
        without: args.without.clone(),
        pairs: args.pairs,
        budget_s: args.budget.map(|seconds| seconds / windows.max(1) as f64),
        seed: args.seed,
    })
}

fn diagnose(
    args: &Args,
    (settings, neighbours): (&GapSettings, &Neighbours),
    one: &LoadedLoop,
    points: &Points,
    section: Section,
) -> anyhow::Result<Diagnosed> {
    let (record, notes) = analysis::gap::record(points, section, &args.selection.cut()).map_err(told)?;
    warn(&one.name, &notes);
    let mut options = settings.options(&record);
    options.neighbours = neighbours.beside(&one.name, &record)?;
    let bar = Bar::new(&one.name, options.budget_evaluations);
    let team = Team::new(&bar, &options, settings.budget_s.map(Duration::from_secs_f64));
    let assessment = analysis::gap::assessment(points, section, &args.selection.cut());
    let found = analysis::gap::diagnose(&one.name, record, &options, &team, assessment);
    bar.0.finish_and_clear();
    found.with_context(|| format!("{}: loop {}", args.input(), one.name))
}

/// Shows the progress of a loop's search.
struct Bar(ProgressBar);

impl Bar {
    fn new(name: &str, evaluations: u64) -> Self {
        let bar = ProgressBar::new(evaluations);
        if let Ok(style) = ProgressStyle::with_template("{wide_msg} {bar:30} {percent:>3} %") {
            bar.set_style(style);
        }
        bar.set_message(name.to_owned());
        Self(bar)
    }
}

impl Watch for Bar {
    fn reached(&self, done: u64, _: u64, _: &str) {
        self.0.set_position(done);
    }

    fn go_on(&self) -> bool {
        !stop::asked()
    }
}

fn print(found: &Diagnosed, verbose: bool, format: Format) -> anyhow::Result<()> {
    match format {
        Format::Json => say(serde_json::to_string(&found.document)?)?,
        Format::Text if verbose => say(gap_text::verbose(&found.document))?,
        Format::Text => say(gap_text::report(&found.document))?,
    }
    Ok(())
}

fn write_predictions(args: &Args, points: &Points, found: &Diagnosed, section: Section) -> anyhow::Result<()> {
    let Some(path) = &args.predictions else { return Ok(()) };
    let whole = points.samples(section)?;
    let rows = rows(&whole, &found.record, &found.diagnosis);
    predictions::write(path, &rows).with_context(|| path.display().to_string())
}

fn write_report(args: &Args, path: &Path, warnings: &[String], loops: Vec<Diagnosed>) -> anyhow::Result<()> {
    let report =
        GapReport { input: args.input(), command: command_line(std::env::args()), warnings: warnings.to_vec(), loops };
    let page = gap_page(&report)?;
    let mut part = path.to_owned().into_os_string();
    part.push(".part");
    std::fs::write(&part, page).and_then(|()| std::fs::rename(&part, path)).with_context(|| path.display().to_string())
}
