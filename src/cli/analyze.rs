//! `stictiond analyze`: one estimate per loop of a file.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use anyhow::{Context, anyhow, bail};
use clap::ValueEnum;

use super::analyze_report::Maker;
use super::{Format, Outcome, say, text};
use crate::config::Config;
use crate::daemon::replay::RunMetadata;
use crate::engine::{LoopSettings, section};
use crate::files::RecordingReader;
use crate::files::{InputKind, LoadedLoop, load_samples};
use crate::optim;
use crate::record::{Record, Signal, Value};
use crate::signal::align::{Point, align_all};
use crate::units::parse_time;
use crate::verdict::{AssessParams, Assessment, DelayChoice, EstimateDocument, ModelChoice, ValveChoice, assess};

/// Usable samples that a loop must have at least.
const MIN_SAMPLES: usize = 30;

/// Estimate stiction once per loop of a file: the whole section that is given, however short.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  stictiond analyze recordings/sticking.mcap
  stictiond analyze loop4.csv --samples 50,500 --model sopdt --delay 12s
  stictiond analyze plant.mcap --loop FIC101 --window 2026-01-05T08:00:00Z,2026-01-05T09:00:00Z --format json
  stictiond analyze plant.mcap --report plant.html")]
pub struct Args {
    /// A .csv file (columns t,op,pv[,sp][,mv][,mode]) or a recording (.mcap, .mcap.part).
    pub input: PathBuf,
    /// Only this loop.
    #[arg(long = "loop", value_name = "NAME")]
    pub loop_name: Option<String>,
    /// Samples START to END, counted from 1, ends included; may be given several times.
    #[arg(long, value_name = "START,END", value_parser = samples_range)]
    pub samples: Vec<(usize, usize)>,
    /// From time T0 to T1, ends included: seconds since 1970 or RFC 3339; ns as in documents with the suffix ns.
    #[arg(long, value_name = "T0,T1", value_parser = time_range, conflicts_with = "samples")]
    pub window: Option<(i64, i64)>,
    /// Process model.
    #[arg(long, value_enum, default_value = "auto")]
    pub model: ModelArg,
    /// Dead time: auto, a number of samples, or seconds such as 12s.
    #[arg(long, default_value = "auto", value_parser = delay)]
    pub delay: DelayChoiceArg,
    /// Valve law.
    #[arg(long, value_enum, default_value = "auto")]
    pub valve: ValveArg,
    /// Solver.
    #[arg(long, default_value = "contour", value_parser = solver)]
    pub solver: &'static str,
    /// Step of the contour grid in % of OP's span.
    #[arg(long, value_name = "PCT", default_value_t = 5.0, value_parser = fineness)]
    pub fineness: f64,
    /// Seed of every random choice.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Range of OP, so that sizes are given in % of travel.
    #[arg(long, value_name = "LO,HI", value_parser = op_range)]
    pub op_range: Option<[f64; 2]>,
    /// Write a report too: a page that opens offline (.html), or its pictures alone (.svg).
    #[arg(long, value_name = "FILE")]
    pub report: Option<PathBuf>,
    /// Draw every loop of the report in full, not only the twelve that most likely stick.
    #[arg(long, requires = "report")]
    pub report_all: bool,
    /// Replace an existing report.
    #[arg(long, requires = "report")]
    pub force: bool,
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

fn pair(text: &str) -> Result<(&str, &str), String> {
    text.split_once(',').ok_or_else(|| format!("{text:?} is not two values with a comma between"))
}

fn samples_range(text: &str) -> Result<(usize, usize), String> {
    let (start, end) = pair(text)?;
    let whole = |s: &str| s.trim().parse::<usize>().map_err(|_| format!("{s:?} is not a whole number"));
    match (whole(start)?, whole(end)?) {
        (0, _) => Err("samples are counted from 1".to_owned()),
        (start, end) if end <= start => Err(format!("the end {end} must lie behind the start {start}")),
        range => Ok(range),
    }
}

fn time_range(text: &str) -> Result<(i64, i64), String> {
    let (start, end) = pair(text)?;
    let time = |s: &str| match s.trim().strip_suffix("ns") {
        Some(ns) => ns.parse::<i64>().map_err(|_| format!("{s:?} is not a whole number of ns")),
        None => parse_time(s).map_err(|e| e.to_string()),
    };
    let range = (time(start)?, time(end)?);
    if range.1 > range.0 { Ok(range) } else { Err("the window's end must lie behind its start".to_owned()) }
}

fn delay(text: &str) -> Result<DelayChoiceArg, String> {
    let number = |s: &str| {
        s.trim().parse::<f64>().ok().filter(|v| v.is_finite() && *v >= 0.0).ok_or_else(|| {
            format!("{text:?} is no dead time: write auto, a number of samples such as 3, or seconds such as 12s")
        })
    };
    if text == "auto" {
        return Ok(DelayChoiceArg(DelayChoice::Auto));
    }
    let choice = match text.strip_suffix('s') {
        Some(seconds) => DelayChoice::Seconds(number(seconds)?),
        None => DelayChoice::Samples(number(text)?),
    };
    Ok(DelayChoiceArg(choice))
}

fn solver(text: &str) -> Result<&'static str, String> {
    let names: Vec<&'static str> = optim::ALL.iter().map(|s| s.name()).collect();
    names.iter().find(|n| **n == text).copied().ok_or_else(|| format!("known solvers: {}", names.join(", ")))
}

fn fineness(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| format!("{text:?} is not a number"))?;
    if (0.5..=50.0).contains(&value) { Ok(value) } else { Err("write a step from 0.5 to 50 %".to_owned()) }
}

pub(super) fn op_range(text: &str) -> Result<[f64; 2], String> {
    let (low, high) = pair(text)?;
    let number = |s: &str| s.trim().parse::<f64>().map_err(|_| format!("{s:?} is not a number"));
    let range = [number(low)?, number(high)?];
    if range[1] > range[0] { Ok(range) } else { Err("the upper end must be above the lower".to_owned()) }
}

/// The configuration that a file was recorded under; the defaults for files of others.
fn config_of(path: &Path) -> anyhow::Result<Option<RunMetadata>> {
    if InputKind::detect(path)? != InputKind::Mcap {
        return Ok(None);
    }
    let reader = RecordingReader::open(path)?;
    if reader.metadata().contains_key("config") {
        Ok(Some(RunMetadata::of(path, reader.metadata())?))
    } else {
        Ok(None)
    }
}

/// Samples of a loop at which both OP and PV have a value, an upper bound that is quick to count.
fn usable(samples: &LoadedLoop) -> usize {
    let of = |signal| {
        let values = samples.samples.iter().filter(|s| s.signal == signal);
        values.filter(|s| matches!(s.value, Value::Number(_))).count()
    };
    of(Signal::Op).min(of(Signal::Pv))
}

/// A loop's points, with what to know of them.
pub(super) struct Points {
    stretches: Vec<Vec<Point>>,
    pub settings: Arc<LoopSettings>,
}

impl Points {
    /// Joins a loop's samples under the configuration that they were recorded with.
    pub fn of(loaded: &LoadedLoop, config: &Config) -> Self {
        let settings = Arc::new(LoopSettings::of(config, config.loop_named(&loaded.name)));
        let (stretches, counts) = align_all(&loaded.samples, &settings.align);
        if counts.late + counts.stamp_outliers > 0 {
            tracing::warn!(
                name = loaded.name,
                late = counts.late,
                outliers = counts.stamp_outliers,
                "samples were left out: their stamps stand out of order"
            );
        }
        Self { stretches, settings }
    }

    /// The record of everything, or of a time, or of a range of samples.
    pub fn record(
        &self,
        name: &str,
        window: Option<(i64, i64)>,
        samples: Option<(usize, usize)>,
    ) -> anyhow::Result<Record> {
        let (from_ns, to_ns, end_ns) = match (window, samples) {
            (Some((from, to)), _) => (from, to, Some(to)),
            (None, Some((start, end))) => {
                let stamps: Vec<i64> = self.stretches.iter().flatten().map(|p| p.t_ns).collect();
                let Some(to) = stamps.get(end - 1) else {
                    bail!("{name}: --samples {start},{end}: the loop has {} samples", stamps.len());
                };
                (stamps[start - 1], *to, None)
            }
            (None, None) => (i64::MIN, i64::MAX, None),
        };
        let (record, outside) = section(&self.stretches, from_ns, to_ns, end_ns, self.settings.window.max_points);
        if outside > 0 {
            tracing::warn!(name, outside, "the section has gaps: its longest stretch is analysed, the rest left out");
        }
        record.ok_or_else(|| anyhow!("{name}: no samples with both OP and PV in this section"))
    }
}

/// Runs the command.
///
/// # Errors
/// The file cannot be read, the loop or section does not exist, or nothing in it can be analysed.
pub fn run(args: &Args, format: Format) -> anyhow::Result<Outcome> {
    let mut report = match &args.report {
        Some(path) => Some(Maker::new(path, args.report_all, args.force)?),
        None => None,
    };
    let loaded = load_samples(&args.input)?;
    for warning in &loaded.warnings {
        tracing::warn!("{warning}");
        report.iter_mut().for_each(|r| r.warn(warning.clone()));
    }
    let recorded = config_of(&args.input)?;
    let config = recorded.map_or_else(|| Config::with_prefix("plant"), |r| r.config);
    let chosen = choose(&loaded.loops, args.loop_name.as_deref(), &args.input)?;
    if chosen.iter().all(|l| usable(l) < MIN_SAMPLES) {
        let most = chosen.iter().map(|l| usable(l)).max().unwrap_or(0);
        bail!(
            "{}: {most} usable samples at most, {MIN_SAMPLES} with both OP and PV are needed in at least one loop",
            args.input.display()
        );
    }
    let hash = config.hash();
    let mut done = 0;
    for one in &chosen {
        let points = Points::of(one, &config);
        let ranges: Vec<Option<(usize, usize)>> =
            if args.samples.is_empty() { vec![None] } else { args.samples.iter().copied().map(Some).collect() };
        for range in ranges {
            match estimate(args, one, &points, range) {
                Ok((assessment, record, params)) => {
                    done += 1;
                    let document = EstimateDocument::new(&one.name, &hash, assessment);
                    print(&document, format)?;
                    if let Some(report) = &mut report {
                        report.add(document, record, params);
                    }
                }
                Err(error) if chosen.len() > 1 => {
                    tracing::warn!("{error:#}");
                    report.iter_mut().for_each(|r| r.warn(format!("{error:#}")));
                }
                Err(error) => return Err(error),
            }
        }
    }
    if done == 0 {
        bail!("{}: no loop could be analysed", args.input.display());
    }
    if let Some(report) = report {
        report.finish(&args.input)?;
    }
    Ok(if loaded.data_loss { Outcome::DataLoss } else { Outcome::Done })
}

fn choose<'l>(loops: &'l [LoadedLoop], name: Option<&str>, input: &Path) -> anyhow::Result<Vec<&'l LoadedLoop>> {
    let Some(name) = name else {
        if loops.is_empty() {
            bail!("{}: holds no loop", input.display());
        }
        return Ok(loops.iter().collect());
    };
    let names = || loops.iter().take(20).map(|l| l.name.as_str()).collect::<Vec<_>>().join(", ");
    let found = loops.iter().find(|l| l.name == name);
    found.map(|l| vec![l]).with_context(|| format!("{}: no loop {name:?}; it holds {}", input.display(), names()))
}

fn estimate(
    args: &Args,
    one: &LoadedLoop,
    points: &Points,
    range: Option<(usize, usize)>,
) -> anyhow::Result<(Assessment, Record, AssessParams)> {
    let started = Instant::now();
    let record = points.record(&one.name, args.window, range)?;
    let mut params = points.settings.assess.clone();
    params.always_fit = true;
    params.op_range = args.op_range.or(params.op_range);
    params.solver = args.solver;
    params.fineness_pct = args.fineness;
    params.seed = args.seed;
    params.delay = args.delay.0;
    params.model = match args.model {
        ModelArg::Fopdt => ModelChoice::Fopdt,
        ModelArg::Sopdt => ModelChoice::Sopdt,
        ModelArg::Auto => ModelChoice::Auto,
    };
    params.valve = match args.valve {
        ValveArg::He => ValveChoice::He,
        ValveArg::Tracking => ValveChoice::Tracking,
        ValveArg::Auto => ValveChoice::Auto,
    };
    let mut assessment = assess(&record, &params);
    assessment.elapsed_ms = Some(started.elapsed().as_secs_f64() * 1e3);
    Ok((assessment, record, params))
}

fn print(document: &EstimateDocument, format: Format) -> anyhow::Result<()> {
    match format {
        Format::Json => say(serde_json::to_string(document)?)?,
        Format::Text => say(text::estimate(document))?,
    }
    Ok(())
}

/// The section of a whole recording that is longest without a gap, for commands that look at whole files.
pub(super) fn whole_record(loaded: &LoadedLoop, config: &Config) -> anyhow::Result<(Record, Arc<LoopSettings>)> {
    let points = Points::of(loaded, config);
    Ok((points.record(&loaded.name, None, None)?, points.settings))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::units::ns_from_s;

    #[test]
    fn arguments_are_read_or_refused_with_a_reason() {
        assert_eq!(samples_range("50,500"), Ok((50, 500)));
        assert!(samples_range("0,5").is_err() && samples_range("5,5").is_err() && samples_range("5").is_err());
        assert_eq!(time_range("1,2.5"), Ok((ns_from_s(1.0), ns_from_s(2.5))));
        assert_eq!(time_range("7ns,9ns"), Ok((7, 9)));
        assert!(time_range("2,1").is_err());
        assert!(matches!(delay("12s").unwrap().0, DelayChoice::Seconds(x) if x == 12.0));
        assert!(matches!(delay("2.5").unwrap().0, DelayChoice::Samples(x) if x == 2.5));
        assert!(delay("-1").is_err() && delay("soon").is_err());
        assert!(op_range("0,100").is_ok() && op_range("5,5").is_err());
    }
}
