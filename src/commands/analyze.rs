//! `stictiond analyze`: one estimate per loop of a file.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, anyhow, bail};
use clap::ValueEnum;
use indicatif::ProgressBar;

use crate::cli::reading::{ReadArgs, config_of, model_file, named};
use crate::cli::selection::{Selection, points, told, warn};
use crate::cli::values::{rising, share};
use crate::cli::{Format, Outcome, UsageError, in_order_on_all_cores, note, say, stop};
use crate::commands::analyze_report::ReportFile;
use crate::commands::fleet::{MANY, Summary};
use crate::commands::plant::groups_text;
use crate::commands::solving::{self, SolverArgs};
use crate::report::maker::Analysed;
use stiction::core::record::Record;
use stiction::core::verdict::{DelayChoice, ModelChoice, ValveChoice};
use stiction::plantwide::GroupDocument;
use stiction_engine::alarm::LoopContext;
use stiction_engine::analysis::plant::{OfPlant, judge_together};
use stiction_engine::analysis::{
    self, Answer, FitOverrides, MIN_SAMPLES, Points, Scored, Section, delay_choice, text, usable,
};
use stiction_engine::config::Config;
use stiction_files::export::Recognised;
use stiction_files::inputs::Unit;
use stiction_files::{Loaded, LoadedLoop};

/// Estimate stiction once per loop of a file: the whole section that is given, however short.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  stictiond analyze recordings/sticking.mcap
  stictiond analyze store.mat --loop loop4 --samples 50,500 --downsample 2
  stictiond analyze loop4.csv --samples 50,500 --samples 600,1200 --model sopdt --delay 12s
  stictiond analyze june.csv --score may.json
  stictiond analyze loop4.csv --solver multistart --evaluations 20000 --seed 7
  stictiond analyze loop4.csv --solver \"cmd:python3 examples/solver.py\"
  stictiond analyze plant.mcap --loop FIC101 --window 2026-01-05T08:00:00Z,2026-01-05T09:00:00Z --format json
  stictiond analyze plant.mcap --report plant.html
  stictiond analyze exports/ --tz Europe/Berlin --report fleet.html
  stictiond analyze exports/ --plant
  stictiond analyze june.csv --map op=41FY101,pv=41FI101 --time-format dmy --tz UTC

Bands are sought with 0 <= fd <= fs and fs + fd <= S0, the span of OP. Ctrl-C ends after the loop under way; what is \
known by then has been printed, and the exit code is 1. At least 30 samples are needed, 50 a period are wanted.")]
pub struct Args {
    /// Tables (columns t,op,pv[,sp][,mv][,mode]), exports of other systems (.csv, .txt, .xlsx, .parquet, .arrow),
    /// recordings (.mcap, .mcap.part), compact stores (.mat); folders and patterns of them too.
    #[arg(required = true)]
    pub input: Vec<PathBuf>,
    /// How exports are read.
    #[command(flatten)]
    pub reading: ReadArgs,
    /// Loop, section, density.
    #[command(flatten)]
    pub selection: Selection,
    /// Process model.
    #[arg(long, value_enum, default_value = "auto", help_heading = "Model")]
    pub model: ModelArg,
    /// Dead time: auto, a number of samples, or seconds such as 12s; fractions too.
    #[arg(long, default_value = "auto", value_parser = delay, allow_negative_numbers = true, help_heading = "Model")]
    pub delay: DelayChoiceArg,
    /// Valve law.
    #[arg(long, value_enum, default_value = "auto", help_heading = "Model")]
    pub valve: ValveArg,
    /// Range of OP, so that sizes are given in % of travel.
    #[arg(long, value_name = "LO,HI", value_parser = rising, allow_hyphen_values = true, help_heading = "Model")]
    pub op_range: Option<[f64; 2]>,
    /// Share of such loops that stick, 0.001 to 0.999: p assumes it. Verdicts do not depend on it [default: 0.3].
    #[arg(long, value_name = "SHARE", value_parser = share, help_heading = "Model")]
    pub prevalence: Option<f64>,
    /// Also run a model from elsewhere over the record and say how well it follows: an estimate, a gap document's
    /// model, or a plain one (JSON). It changes nothing else.
    #[arg(long, value_name = "FILE.json", help_heading = "Model")]
    pub score: Option<PathBuf>,
    /// A solver to compare with.
    #[command(flatten)]
    pub solver: SolverArgs,
    /// Take the loops as one plant: find those that share an oscillation, and which of them makes it. Answers are printed
    /// once all loops are judged; with JSON, a line for each group follows them.
    #[arg(long)]
    pub plant: bool,
    /// Print the log-odds behind the probability too, indicator by indicator.
    #[arg(long)]
    pub explain: bool,
    /// Write a report too: a page that opens offline (.html), or its pictures alone (.svg).
    #[arg(long, value_name = "FILE")]
    pub report: Option<PathBuf>,
    /// Draw every loop of the report in full, not only the twelve that most likely stick.
    #[arg(long, requires = "report")]
    pub report_all: bool,
    /// Unit of OP on the report's axes, such as `%`.
    #[arg(long, value_name = "UNIT", requires = "report")]
    pub op_unit: Option<String>,
    /// Unit of PV on the report's axes, such as `m3/h`.
    #[arg(long, value_name = "UNIT", requires = "report")]
    pub pv_unit: Option<String>,
    /// Replace an existing report.
    #[arg(long, requires = "report")]
    pub force: bool,
}

/// An answer, with the data that the report draws.
struct ReportedAnswer {
    answer: Answer,
    looked_at: Analysed,
    /// The loop's area and equipment, from the configuration.
    place: LoopContext,
}

/// `--model`.
#[derive(Debug, Clone, Copy, ValueEnum)]
pub enum ModelArg {
    /// First order with dead time.
    Fopdt,
    /// Second order with dead time.
    Sopdt,
    /// Second order only where it earns its parameter.
    Auto,
}

/// `--valve`.
#[derive(Debug, Clone, Copy, ValueEnum)]
pub enum ValveArg {
    /// He's law: a staircase of slips.
    He,
    /// The tracking law: slides once it moves.
    Tracking,
    /// The better of both.
    Auto,
}

/// `--delay`, read.
#[derive(Debug, Clone, Copy)]
pub struct DelayChoiceArg(DelayChoice);

fn delay(text: &str) -> Result<DelayChoiceArg, String> {
    delay_choice(text).map(DelayChoiceArg)
}

/// Runs the command.
///
/// # Errors
/// The files cannot be read, the loop or section does not exist, or nothing in it can be analysed.
pub fn run(args: &Args, format: Format) -> anyhow::Result<Outcome> {
    let report = match &args.report {
        Some(path) => {
            let units = [args.op_unit.clone(), args.pv_unit.clone()];
            Some(ReportFile::new(path, args.report_all, args.force, units)?)
        }
        None => None,
    };
    let units = args.reading.units(&args.input)?;
    if args.plant && args.selection.sections().len() > 1 {
        return Err(UsageError(
            "--plant compares one section of each loop; give --samples or --window once".to_owned(),
        )
        .into());
    }
    stop::watch();
    let waiting = args.plant.then(Vec::new);
    let summary = Summary::default();
    let mut desk = OutputWriter { format, report, summary, table: true, explain: args.explain, done: 0, waiting };
    let data_loss = match &units[..] {
        [one] => one_file(args, one, &mut desk)?,
        _ => files(args, &units, &mut desk)?,
    };
    let groups = desk.judge_together()?;
    if desk.table && format == Format::Text {
        say(desk.summary.table())?;
    }
    if let Some(groups) = &groups {
        match format {
            Format::Json => groups.iter().try_for_each(|group| say(serde_json::to_string(group)?))?,
            Format::Text => say(groups_text(groups, desk.done))?,
        }
    }
    if let Some(mut report) = desk.report {
        report.maker.groups = groups;
        report.finish(named(&args.input))?;
    }
    Ok(if data_loss { Outcome::DataLoss } else { Outcome::Done })
}

/// Prints the answers and collects them for the report.
struct OutputWriter {
    format: Format,
    report: Option<ReportFile>,
    summary: Summary,
    /// Whether one table replaces the texts of the loops.
    table: bool,
    /// Whether the log-odds are printed.
    explain: bool,
    done: usize,
    /// With `--plant`, the answers held back until all are there.
    waiting: Option<Vec<ReportedAnswer>>,
}

impl OutputWriter {
    fn warn(&mut self, text: String) {
        tracing::warn!("{text}");
        self.report.iter_mut().for_each(|r| r.maker.warnings.push(text.clone()));
    }

    fn take(&mut self, told: ReportedAnswer) -> anyhow::Result<()> {
        self.done += 1;
        match &mut self.waiting {
            Some(waiting) => waiting.push(told),
            None => self.put_out(told)?,
        }
        Ok(())
    }

    /// With `--plant`, prints the held answers and then the groups.
    fn judge_together(&mut self) -> anyhow::Result<Option<Vec<GroupDocument>>> {
        let Some(mut waiting) = self.waiting.take() else { return Ok(None) };
        let mut plant: Vec<OfPlant> = waiting
            .iter_mut()
            .map(|ReportedAnswer { answer, looked_at, place }| OfPlant { answer, record: &looked_at.record, place })
            .collect();
        let groups = judge_together(&mut plant)?;
        waiting.into_iter().try_for_each(|told| self.put_out(told))?;
        Ok(Some(groups))
    }

    fn put_out(&mut self, told: ReportedAnswer) -> anyhow::Result<()> {
        let ReportedAnswer { answer, looked_at, .. } = told;
        match self.format {
            Format::Json => say(serde_json::to_string(&answer)?)?,
            Format::Text if !self.table && self.explain => say(text::explained(&answer))?,
            Format::Text if !self.table => say(text::answer(&answer))?,
            Format::Text => {}
        }
        self.summary.add(&answer);
        if let Some(report) = &mut self.report {
            report.maker.add(answer.document, looked_at);
        }
        Ok(())
    }

    /// Takes the result of one of several loops.
    fn take_one_of_many(&mut self, answer: anyhow::Result<ReportedAnswer>) -> anyhow::Result<()> {
        match answer {
            Ok(answer) => self.take(answer),
            Err(error) if error.is::<UsageError>() => Err(error),
            Err(error) => {
                self.summary.fail();
                self.warn(format!("{error:#}"));
                Ok(())
            }
        }
    }
}

/// Analyses the loops of one file in parallel; true if data was lost.
fn one_file(args: &Args, unit: &Unit, desk: &mut OutputWriter) -> anyhow::Result<bool> {
    let loaded = args.reading.load(unit)?;
    loaded.warnings.iter().for_each(|warning| desk.warn(warning.clone()));
    let config = config_of(&unit.paths)?;
    let place = unit.name();
    let chosen = args.selection.loops(&loaded).map_err(|e| anyhow!("{place}: {e}"))?;
    check_samples(&place, &chosen)?;
    let hash = config.hash();
    let work = |one: &&LoadedLoop, bar: &ProgressBar| of_loop(args, one, &config, &hash, bar);
    let alone = chosen.len() == 1;
    desk.table = chosen.len() > MANY;
    let mut answered = 0;
    in_order_on_all_cores(
        &chosen,
        |one| one.name.clone(),
        work,
        |answers| {
            answered += 1;
            answers.into_iter().try_for_each(|answer| match answer {
                Err(error) if alone => Err(error),
                answer => desk.take_one_of_many(answer),
            })
        },
    )?;
    if stop::asked() && answered < chosen.len() {
        bail!("{place}: stopped after {answered} of {} loops", chosen.len());
    }
    if desk.done == 0 {
        bail!("{place}: no loop could be analysed");
    }
    Ok(loaded.data_loss)
}

/// Refuses the input if no loop has enough samples.
fn check_samples(place: &str, loops: &[&LoadedLoop]) -> anyhow::Result<()> {
    let most = loops.iter().map(|l| usable(&l.samples)).max().unwrap_or(0);
    if most < MIN_SAMPLES {
        bail!(
            "{place}: {most} usable samples at most, {MIN_SAMPLES} with both OP and PV are needed in at least one loop"
        );
    }
    Ok(())
}

/// Results from one of several files.
struct OfFile {
    name: String,
    recognised: Option<Recognised>,
    warnings: Vec<String>,
    data_loss: bool,
    answers: Vec<anyhow::Result<ReportedAnswer>>,
}

/// Analyses several files, each freed before the next is read; true if data was lost.
fn files(args: &Args, units: &[Unit], desk: &mut OutputWriter) -> anyhow::Result<bool> {
    let place = named(&args.input);
    let (mut data_loss, mut answered) = (false, 0);
    let mut forms: std::collections::BTreeMap<String, (usize, String)> = std::collections::BTreeMap::new();
    let work = |unit: &Unit, bar: &ProgressBar| of_file(args, unit, bar);
    in_order_on_all_cores(units, Unit::name, work, |read: anyhow::Result<OfFile>| {
        answered += 1;
        let file = match read {
            Ok(file) => file,
            Err(error) if error.is::<UsageError>() => return Err(error),
            Err(error) => {
                desk.summary.fail();
                desk.warn(format!("{error:#}"));
                return Ok(());
            }
        };
        data_loss |= file.data_loss;
        if let Some(found) = file.recognised {
            found.counts.iter().for_each(|count| note(format_args!("{}: {count}", file.name)));
            forms.entry(found.form).or_insert((0, file.name.clone())).0 += 1;
        }
        file.warnings.iter().for_each(|warning| desk.warn(format!("{}: {warning}", file.name)));
        file.answers.into_iter().try_for_each(|answer| desk.take_one_of_many(answer))
    })?;
    for (form, (count, first)) in forms {
        let others = if count > 1 { format!(" and {} more like it", count - 1) } else { String::new() };
        note(format_args!("{first}{others}: read as {form}"));
    }
    if stop::asked() && answered < units.len() {
        bail!("{place}: stopped after {answered} of {} files", units.len());
    }
    if desk.done == 0 {
        bail!("{place}: no loop could be analysed");
    }
    Ok(data_loss)
}

/// Every loop of one of several files; with `--loop`, other loops are skipped.
fn of_file(args: &Args, unit: &Unit, bar: &ProgressBar) -> anyhow::Result<OfFile> {
    let loaded: Loaded = unit.load(&args.reading.options())?;
    let config = config_of(&unit.paths)?;
    let hash = config.hash();
    let chosen: Vec<&LoadedLoop> = match &args.selection.loop_name {
        Some(_) => args.selection.loops(&loaded).unwrap_or_default(),
        None => loaded.loops.iter().collect(),
    };
    if !chosen.is_empty() {
        check_samples(&unit.name(), &chosen)?;
    }
    let answers = chosen.into_iter().flat_map(|one| of_loop(args, one, &config, &hash, bar));
    Ok(OfFile {
        name: unit.name(),
        answers: answers.collect(),
        recognised: loaded.recognised,
        warnings: loaded.warnings,
        data_loss: loaded.data_loss,
    })
}

/// Every section of one loop.
fn of_loop(
    args: &Args,
    one: &LoadedLoop,
    config: &Config,
    hash: &str,
    bar: &ProgressBar,
) -> Vec<anyhow::Result<ReportedAnswer>> {
    let points = points(one, config);
    let sections = args.selection.sections();
    sections.into_iter().map(|section| estimate(args, one, &points, section, hash, bar)).collect()
}

fn estimate(
    args: &Args,
    one: &LoadedLoop,
    points: &Points,
    section: Section,
    hash: &str,
    bar: &ProgressBar,
) -> anyhow::Result<ReportedAnswer> {
    let started = Instant::now();
    let cut = args.selection.cut();
    let mut params = asked(args).over(&points.settings.assess);
    params.op_unit = args.op_unit.clone().or_else(|| one.units[0].clone()).or(params.op_unit);
    let found = analysis::estimate(points, section, &cut, params).map_err(told)?;
    let elapsed_ms = started.elapsed().as_secs_f64() * 1e3;
    warn(&one.name, &found.notes);
    let solver = solving::run(&args.solver, &found.record, &found.options, &found.assessment, bar)?;
    let asked = args.report.is_some() && cut.downsample.is_some();
    let before = || points.record(section, points.settings.window.max_points).map(|(record, _)| record);
    let original = asked.then(before).transpose()?;
    let scored = args.score.as_deref().map(|path| scored(path, &found.record, found.options.period_points));
    let answer = found.answer(&one.name, hash, elapsed_ms, solver, scored.transpose()?);
    let analysis::Estimated { record, params, notes, .. } = found;
    let notes = points.notes.iter().cloned().chain(notes).collect();
    let looked_at = Analysed { record, original, about: one.about.clone(), units: one.units.clone(), params, notes };
    Ok(ReportedAnswer { answer, looked_at, place: points.settings.place.clone() })
}

/// Runs the model of a file over the record.
fn scored(path: &Path, record: &Record, period_points: Option<f64>) -> anyhow::Result<Scored> {
    let (file, name) = (model_file(path)?, path.display().to_string());
    Scored::of(&name, &file, record, period_points).with_context(|| name.clone())
}

/// The loop's settings, overridden by the command line.
const fn asked(args: &Args) -> FitOverrides {
    FitOverrides {
        op_range: args.op_range,
        prevalence: args.prevalence,
        fineness_pct: args.solver.fineness,
        seed: args.solver.seed,
        delay: args.delay.0,
        model: match args.model {
            ModelArg::Fopdt => ModelChoice::Fopdt,
            ModelArg::Sopdt => ModelChoice::Sopdt,
            ModelArg::Auto => ModelChoice::Auto,
        },
        valve: match args.valve {
            ValveArg::He => ValveChoice::He,
            ValveArg::Tracking => ValveChoice::Tracking,
            ValveArg::Auto => ValveChoice::Auto,
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arguments_are_read_or_refused_with_a_reason() {
        assert!(matches!(delay("12s").unwrap().0, DelayChoice::Seconds(x) if x == 12.0));
        assert!(matches!(delay("2.5").unwrap().0, DelayChoice::Samples(x) if x == 2.5));
        assert!(delay("-1").is_err() && delay("soon").is_err());
    }
}
