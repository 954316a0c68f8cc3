//! `stictiond test`: runs the daemon's engine on known data and compares its last reports with expectations.

use std::collections::{BTreeMap, VecDeque};
use std::path::{Path, PathBuf};

use anyhow::{Context, anyhow, bail};
use serde_json::{Value, json};

use crate::cli::reading::{ReadArgs, config_file, scenario_file};
use crate::cli::{Format, Outcome, UsageError, counted, in_order_on_all_cores, list, say, stop};
use crate::commands::expect;
use crate::daemon::received;
use crate::daemon::replay::Replay;
use stiction::core::record::Sample;
use stiction::core::units::optional;
use stiction::core::verdict::Assessment;
use stiction_engine::alarm::why_not_active;
use stiction_engine::codec::topic::Kind;
use stiction_engine::config::Config;
use stiction_engine::expectations::{Case, Difference, Found, parse};
use stiction_files::export::{Map, Zone};
use stiction_files::{LoadedLoop, choose_loop};

/// Name of the file of expectations, next to the configuration.
const USUAL: &str = "expectations.toml";

/// Check what a configuration reports on known data: run the daemon's engine on recordings, tables and simulated plants,
/// and compare its newest estimate and alarm of each loop with what a file expects.
#[derive(Debug, clap::Args)]
#[command(after_help = "A file of expectations has one [[case]] for each loop and time, with these keys:
    name
    input   recording, table, export, compact store, folder or scenario (.toml), relative to the file
    loop    where the input has several; also names the loop of a table without tags
    until   a time; later samples are not used
    map, tz how an export is read, as the options of the same name
and what the newest window and the alarm should be then:
    verdict, reason                              a word of the estimate
    s, j, p_stiction, p_calibrated,
    stiction_index, period_s                     [LOWEST, HIGHEST]
    alarm                                        true if active
Each loop is judged by itself: groups of loops are not compared.
With --write, the further arguments are data instead, and a case is written for each loop: what CONFIG reports on it now.
Exit codes: 0 all cases hold, 1 one does not, 2 a file cannot be read, 3 all hold but a recording is damaged.
Examples:
  stictiond test config/demo.toml
  stictiond test new.toml config/expectations.toml --filter FIC101
  stictiond test config/demo.toml recordings/sticking.mcap --write cases.toml")]
pub struct Args {
    /// Configuration of the daemon (TOML), with its settings of windows, alarms and loops.
    pub config: PathBuf,
    /// Files of expectations (TOML) [default: expectations.toml beside the configuration]; with --write, data.
    pub expectations: Vec<PathBuf>,
    /// Write expectations for the data to this file.
    #[arg(long, value_name = "FILE", requires = "expectations", conflicts_with = "filter")]
    pub write: Option<PathBuf>,
    /// Replace the file that --write names.
    #[arg(long, requires = "write")]
    pub force: bool,
    /// Run only the cases whose name contains this text.
    #[arg(long, value_name = "TEXT")]
    pub filter: Option<String>,
    /// How exports are read.
    #[command(flatten)]
    pub reading: ReadArgs,
}

/// A case and its file.
struct FiledCase<'a> {
    file: &'a Path,
    case: &'a Case,
}

/// Data that is read once: a path, and how to read it.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Input {
    path: PathBuf,
    map: Option<String>,
    tz: Option<String>,
}

impl Input {
    /// A path without reading options.
    pub(super) fn of(path: &Path) -> Self {
        Self { path: path.to_owned(), map: None, tz: None }
    }
}

impl FiledCase<'_> {
    fn input(&self) -> Input {
        let path = self.file.parent().unwrap_or(Path::new("")).join(&self.case.input);
        Input { path, map: self.case.map.clone(), tz: self.case.tz.clone() }
    }
}

/// Newest windows kept of a loop.
const RECENT: usize = 64;

/// The engine's reports of a loop.
#[derive(Clone, Default)]
pub(super) struct Heard {
    pub(super) found: Found,
    /// Why the alarm is not active; `None` if it is.
    why_no_alarm: Option<String>,
}

/// Result of a case.
struct Tested {
    /// Its index among the cases.
    at: usize,
    /// The last reports, and the expectations that do not hold.
    result: anyhow::Result<(Heard, Vec<Difference>)>,
    /// Whether its recording is damaged.
    data_loss: bool,
}

/// Number of cases by result.
#[derive(Default)]
struct Totals {
    hold: usize,
    differ: usize,
    failed: usize,
    data_loss: bool,
}

/// Runs the command. A case whose data cannot be read does not stop the others.
///
/// # Errors
/// A faulty configuration or file of expectations; no case of that name.
pub fn run(args: &Args, format: Format) -> anyhow::Result<Outcome> {
    let (_, config) = config_file(&args.config).map_err(usage)?;
    if let Some(out) = &args.write {
        let written = expect::write(&config, &args.expectations, &args.reading, (out, args.force))?;
        match format {
            Format::Json => say(json!({"schema": "stictiond.test_written.v1", "file": out, "cases": written}))?,
            Format::Text => say(format!("{}: cases for {}", out.display(), counted(written, "loop")))?,
        }
        return Ok(Outcome::Done);
    }
    let files = match &args.expectations[..] {
        [] => vec![args.config.with_file_name(USUAL)],
        given => given.to_vec(),
    };
    let read: Vec<(PathBuf, Vec<Case>)> = files.into_iter().map(read_cases).collect::<Result<_, _>>().map_err(usage)?;
    let wanted = |case: &Case| args.filter.as_ref().is_none_or(|text| case.name.contains(text.as_str()));
    let all = read.iter().flat_map(|(file, cases)| cases.iter().map(move |case| FiledCase { file, case }));
    let cases: Vec<FiledCase<'_>> = all.filter(|one| wanted(one.case)).collect();
    if cases.is_empty() {
        let filter = args.filter.as_deref().unwrap_or_default();
        return Err(usage(anyhow!("no case has {filter:?} in its name; choose another --filter")));
    }
    let tested = test_all(&cases, &config, &args.reading)?;
    let mut totals = Totals::default();
    for (one, tested) in cases.iter().zip(&tested) {
        totals.add(tested);
        print(one, tested, format)?;
    }
    totals.print(&args.config, format)?;
    Ok(totals.outcome())
}

/// An error in the request, not in the work: exit 2.
fn usage(error: anyhow::Error) -> anyhow::Error {
    UsageError(format!("{error:#}")).into()
}

fn read_cases(file: PathBuf) -> anyhow::Result<(PathBuf, Vec<Case>)> {
    let text = std::fs::read_to_string(&file).with_context(|| file.display().to_string())?;
    let cases = parse(&text).map_err(|faults| anyhow!("{}:\n  {}", file.display(), list(&faults)))?;
    Ok((file, cases))
}

/// The results of all cases, in order. Each input is read once; inputs run in parallel.
fn test_all(cases: &[FiledCase<'_>], config: &Config, reading: &ReadArgs) -> anyhow::Result<Vec<Tested>> {
    stop::watch();
    let mut by_input: BTreeMap<Input, Vec<usize>> = BTreeMap::new();
    for (at, one) in cases.iter().enumerate() {
        by_input.entry(one.input()).or_default().push(at);
    }
    let inputs: Vec<(Input, Vec<usize>)> = by_input.into_iter().collect();
    let mut tested = Vec::with_capacity(cases.len());
    let name = |(input, _): &(Input, _)| input.path.display().to_string();
    let work = |(input, places): &(Input, Vec<usize>), _: &_| test_input(input, places, cases, config, reading);
    in_order_on_all_cores(&inputs, name, work, |of_input| {
        tested.extend(of_input);
        Ok(())
    })?;
    if tested.len() < cases.len() {
        bail!("stopped after {} of {} cases", tested.len(), cases.len());
    }
    tested.sort_by_key(|one| one.at);
    Ok(tested)
}

/// The cases of one input. The engine runs once for each loop and end time.
fn test_input(
    input: &Input,
    places: &[usize],
    cases: &[FiledCase<'_>],
    config: &Config,
    reading: &ReadArgs,
) -> Vec<Tested> {
    let loaded = load(input, reading);
    let mut known: BTreeMap<(String, Option<i64>), Heard> = BTreeMap::new();
    let mut test = |case: &Case| {
        let (loops, _) = loaded.as_ref().map_err(|error| anyhow!("{error:#}"))?;
        let (name, one) = loop_of(case, &input.path, loops)?;
        if !config.input.discover && config.loop_named(name).is_none() {
            bail!("the configuration does not watch {name}; add a [[loop]] entry, or set [input] discover = true");
        }
        let key = (name.to_owned(), case.until_ns);
        if !known.contains_key(&key) {
            known.insert(key.clone(), report_on(config, name, &one.samples, case.until_ns)?);
        }
        let heard = known[&key].clone();
        let differences = case.differences(&heard.found);
        Ok((heard, differences))
    };
    let data_loss = loaded.as_ref().is_ok_and(|(_, data_loss)| *data_loss);
    places.iter().map(|at| Tested { at: *at, result: test(cases[*at].case), data_loss }).collect()
}

/// The loops of a scenario or of files; the flag is true if data was lost.
pub(super) fn load(input: &Input, reading: &ReadArgs) -> anyhow::Result<(Vec<LoadedLoop>, bool)> {
    let Input { path, map, tz } = input;
    if path.extension().is_some_and(|ending| ending == "toml") {
        let (_, scenario) = scenario_file(path)?;
        let mut loops: Vec<LoadedLoop> = scenario.loop_names().map(|name| LoadedLoop::new(name, Vec::new())).collect();
        scenario.stream().for_each(|simulated| loops[simulated.loop_index].samples.push(simulated.sample));
        return Ok((loops, false));
    }
    let mut reading = reading.clone();
    if let Some(map) = map {
        reading.map = Some(Map::parse(map).map_err(|why| anyhow!("map: {why}"))?);
    }
    if let Some(tz) = tz {
        reading.tz = Some(Zone::parse(tz).map_err(|why| anyhow!("tz: {why}"))?);
    }
    let loaded = reading.load_all(&[path.to_owned()])?;
    loaded.warnings.iter().for_each(|warning| tracing::warn!("{}: {warning}", path.display()));
    Ok((loaded.loops, loaded.data_loss))
}

/// The loop of a case, and its name in the engine. A table's only loop is named after the file, so the case may give it another
/// name.
fn loop_of<'a>(case: &'a Case, path: &Path, loops: &'a [LoadedLoop]) -> anyhow::Result<(&'a str, &'a LoadedLoop)> {
    let named_by_file = |one: &LoadedLoop| path.file_stem().is_some_and(|stem| stem == one.name.as_str());
    match (&case.loop_name, loops) {
        (_, []) => bail!("{}: no loop found; a loop needs an OP and a PV", path.display()),
        (None, [one]) => Ok((&one.name, one)),
        (None, _) => {
            let names: Vec<&str> = loops.iter().take(20).map(|one| one.name.as_str()).collect();
            bail!("{}: has several loops; add loop = \"NAME\": {}", path.display(), names.join(", "))
        }
        (Some(name), [one]) if named_by_file(one) => Ok((name, one)),
        (Some(name), _) => {
            let one = choose_loop(loops, name).map_err(|why| anyhow!("{}: {why}", path.display()))?;
            Ok((&one.name, one))
        }
    }
}

/// The last report on a loop after its samples up to a given time.
pub(super) fn report_on(
    config: &Config,
    name: &str,
    samples: &[Sample],
    until_ns: Option<i64>,
) -> anyhow::Result<Heard> {
    let mut replay = Replay::new(config.engine(), true);
    // A diagnosis changes neither estimates nor alarms.
    replay.set_diagnose(false);
    let (mut found, mut recent, mut outputs) = (Found::default(), VecDeque::new(), Vec::new());
    for sample in samples.iter().filter(|sample| until_ns.is_none_or(|until_ns| sample.t_ns <= until_ns)) {
        replay.take_sample(name, *sample, &mut outputs);
        replay.drain_for_plant().for_each(drop);
        for output in outputs.drain(..) {
            found.take(output.kind, &output.json).with_context(|| name.to_owned())?;
            if output.kind == Kind::Estimate {
                recent.extend(found.estimate.as_ref().and_then(received::estimate).map(|document| document.assessment));
                recent.drain(..recent.len().saturating_sub(RECENT));
            }
        }
    }
    let recent: Vec<Assessment> = recent.into();
    let params = config.loop_named(name).map_or(config.alarm, |one| one.alarm);
    let why_no_alarm = (!found.alarm).then(|| why_not_active(&recent, &params));
    Ok(Heard { found, why_no_alarm })
}

/// The newest window in one line, and the reason for no alarm in another.
fn summary(Heard { found, why_no_alarm }: &Heard) -> Vec<String> {
    let Some(estimate) = &found.estimate else {
        return vec!["no window came due; use longer data, or a shorter [window] every_s".to_owned()];
    };
    let word = |value: &Value| value.as_str().unwrap_or("none").to_owned();
    let reason = estimate["reason"].as_str().map_or_else(String::new, |reason| format!(" ({reason})"));
    let s = optional(estimate["s"].as_f64());
    let alarm = if found.alarm { "active" } else { "not active" };
    let (end, verdict) = (word(&estimate["window"]["end"]), word(&estimate["verdict"]));
    let newest = format!("window to {end}: {verdict}{reason}, s {s}, alarm {alarm}");
    let why = why_no_alarm.iter().map(|why| format!("alarm not active: {why}"));
    std::iter::once(newest).chain(why).collect()
}

fn print(one: &FiledCase<'_>, tested: &Tested, format: Format) -> anyhow::Result<()> {
    let (file, case) = (one.file.display(), one.case);
    if format == Format::Json {
        say(document(one, tested))?;
        return Ok(());
    }
    let (word, lines) = match &tested.result {
        Ok((_, differences)) if differences.is_empty() => ("ok    ", Vec::new()),
        Ok((heard, differences)) => {
            let line = |d: &Difference| {
                format!("{file}: line {}: {}: expected {}, found {}", d.line, d.key, d.expected, d.found)
            };
            ("FAIL  ", differences.iter().map(line).chain(summary(heard)).collect())
        }
        Err(error) => ("ERROR ", vec![format!("{file}: line {}: {error:#}", case.line)]),
    };
    say(format!("{word}{}", case.name))?;
    lines.into_iter().try_for_each(|line| say(format!("      {line}")))?;
    Ok(())
}

/// A case and its result as JSON.
fn document(one: &FiledCase<'_>, tested: &Tested) -> Value {
    let (result, heard, differences, error) = match &tested.result {
        Ok((heard, differences)) => {
            let result = if differences.is_empty() { "holds" } else { "differs" };
            (result, Some(heard), &differences[..], None)
        }
        Err(error) => ("failed", None, &[][..], Some(format!("{error:#}"))),
    };
    let row = |d: &Difference| json!({"line": d.line, "key": d.key, "expected": d.expected, "found": d.found});
    json!({"schema": "stictiond.test_case.v1", "file": one.file, "line": one.case.line, "name": one.case.name,
        "input": one.input().path, "loop": one.case.loop_name, "result": result, "error": error,
        "differences": differences.iter().map(row).collect::<Vec<_>>(),
        "estimate": heard.and_then(|heard| heard.found.estimate.as_ref()), "alarm": heard.map(|heard| heard.found.alarm),
        "why_no_alarm": heard.and_then(|heard| heard.why_no_alarm.as_ref())})
}

impl Totals {
    fn add(&mut self, tested: &Tested) {
        match &tested.result {
            Ok((_, differences)) if differences.is_empty() => self.hold += 1,
            Ok(_) => self.differ += 1,
            Err(_) => self.failed += 1,
        }
        self.data_loss |= tested.data_loss;
    }

    fn print(&self, config: &Path, format: Format) -> anyhow::Result<()> {
        let Self { hold, differ, failed, .. } = self;
        match format {
            Format::Json => {
                say(json!({"schema": "stictiond.test.v1", "config": config, "hold": hold, "differ": differ,
                "failed": failed}))?
            }
            Format::Text => {
                say(format!("{hold} hold, {differ} do not hold, {failed} could not be run"))?;
            }
        }
        Ok(())
    }

    const fn outcome(&self) -> Outcome {
        match self {
            Self { failed: 1.., .. } => Outcome::Usage,
            Self { differ: 1.., .. } => Outcome::Failed,
            Self { data_loss: true, .. } => Outcome::DataLoss,
            Self { .. } => Outcome::Done,
        }
    }
}
