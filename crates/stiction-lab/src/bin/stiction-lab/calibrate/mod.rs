//! `stiction-lab calibrate`: fits the classifier of the verdict and measures it on data that it was not fitted to.

mod bump_test;
mod intervals;
mod plants;
mod reversals;

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use serde_json::json;

use stiction::core::verdict::features::Figures;
use stiction::core::verdict::figures;
use stiction::core::verdict::rule::{Cuts, Logistic, Rule};
use stiction::core::verdict::tally::{self, Scored, Tally};
use stiction_files::{labelled, load_samples};
use stiction_lab::calibrate::{Example, Settings, ask, fit, leave_one_valve_out, weights};
use stiction_lab::truth::rates::{Called, reliability_lines, table};
use stiction_lab::truth::{Half, verdict_case};
use stictiond::cli::{Format, Outcome, UsageError, on_all_cores, print, say};

/// Fit the classifier behind p_stiction to simulated loops and labelled recordings, and measure it on data left out of the
/// fit: recordings leave-one-valve-out, simulated loops of the report half.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  stiction-lab calibrate --loops 2000 --features figures.jsonl
  stiction-lab calibrate --features figures.jsonl --labelled labelled/INDEX.csv --out rule.json
  stiction-lab calibrate --intervals 40 --out interval.json
  stiction-lab calibrate --reversals 500 --labelled labelled/INDEX.csv
  stiction-lab calibrate --bump-test 200 --seed 7000")]
pub struct Args {
    /// Simulated loops in each half: one to fit, one to report.
    #[arg(long, default_value_t = 1000)]
    pub loops: u64,
    /// Seed of the first simulated loop.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Index of labelled recordings (CSV), as for `evaluate`.
    #[arg(long, value_name = "INDEX.csv")]
    pub labelled: Option<PathBuf>,
    /// File that caches computed features, one line each (JSON lines); read if it exists.
    #[arg(long, value_name = "FILE.jsonl")]
    pub features: Option<PathBuf>,
    /// Features of one classifier; repeat for each classifier whose logits are averaged [default: those in use].
    #[arg(long = "use", value_name = "NAME,NAME")]
    pub names: Vec<String>,
    /// L2 penalty on the weights of standardised features.
    #[arg(long, default_value_t = 1.0)]
    pub ridge: f64,
    /// Total weight of the simulated loops, in valves.
    #[arg(long, default_value_t = 40.0)]
    pub weight: f64,
    /// Decision threshold of the verdict and of the alarm, as probabilities [default: those in use].
    #[arg(long, value_name = "CALLED,ALARM", value_parser = stictiond::cli::values::rising)]
    pub cuts: Option<[f64; 2]>,
    /// Instead of the classifier, measure how wide the intervals of s, j, fs and fd must be, on this many loops per regime.
    #[arg(long, value_name = "LOOPS", conflicts_with_all = ["labelled", "features", "names"])]
    pub intervals: Option<u64>,
    /// Instead of the rule, carries out so many bump tests as estimates propose them on simulated valves that stick, each
    /// again on a valve without friction, and prints how well the band is read.
    #[arg(long, value_name = "TESTS", conflicts_with_all = ["labelled", "features", "names", "intervals", "out"])]
    pub bump_test: Option<u64>,
    /// Instead of the classifier, count how many of the loops called sticking do stick, by the reversals of the stem, where a
    /// record has too few periods or too few samples in each; on this many loops of each half, and on labelled recordings.
    #[arg(long, value_name = "LOOPS", conflicts_with_all = ["features", "names", "intervals", "bump_test", "plants", "out"])]
    pub reversals: Option<u64>,
    /// Instead of the classifier, measure the judgement of loops that share an oscillation on this many easy and this many
    /// hard simulated plants; with --out, first fit its rules to as many other plants.
    #[arg(long, value_name = "PLANTS", conflicts_with_all = ["labelled", "features", "names", "intervals", "bump_test"])]
    pub plants: Option<u64>,
    /// With --plants: let the loops' clocks differ by up to this many periods.
    #[arg(long, value_name = "PERIODS", default_value_t = 0.0, requires = "plants")]
    pub skew: f64,
    /// Output file for the classifier (or interval widths, or rules for plants), JSON.
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Replace an existing output file.
    #[arg(long)]
    pub force: bool,
}

/// What to compute.
enum Source {
    Loop(Half, u64),
    Recording(labelled::Case),
}

impl Source {
    fn name(&self) -> String {
        match self {
            Self::Loop(half, seed) => format!("{} {seed}", half.name()),
            Self::Recording(case) => case.file.clone(),
        }
    }
}

/// Runs the command.
///
/// # Errors
/// A file cannot be read or written, or there is nothing to fit.
pub fn run(args: &Args, format: Format) -> anyhow::Result<Outcome> {
    if let Some(out) = args.out.as_ref().filter(|out| out.exists() && !args.force) {
        bail!("{}: already exists; use --force to replace it", out.display());
    }
    if let Some(loops) = args.intervals {
        return intervals::run(loops, args.seed, args.out.as_deref(), format);
    }
    if let Some(loops) = args.reversals {
        return reversals::run(loops, args.seed, args.labelled.as_deref(), format);
    }
    if let Some(tests) = args.bump_test {
        return bump_test::run(tests, args.seed, format);
    }
    if let Some(plants) = args.plants {
        return plants::run(plants, args.seed, args.skew, args.out.as_deref(), format);
    }
    if args.weight.is_nan() || args.weight < 0.0 || args.ridge.is_nan() || args.ridge < 0.0 {
        return Err(UsageError("--weight and --ridge must be 0 or more".to_owned()).into());
    }
    let shipped = Rule::shipped();
    let examples = gather(args)?;
    let of_part = |part: &Logistic| part.weights.iter().map(|w| w.feature.clone()).collect();
    let named = |list: &String| list.split(',').map(|name| name.trim().to_owned()).collect();
    let settings = Settings {
        features: match &args.names[..] {
            [] => shipped.parts.iter().map(of_part).collect(),
            lists => lists.iter().map(named).collect(),
        },
        ridge: args.ridge,
        simulated_weight: args.weight,
        cuts: args.cuts.map_or(shipped.cuts, |[called, alarm]| Cuts { called, alarm }),
        seed: args.seed,
    };
    let rule = fit(&examples, &weights(&examples, args.weight), &settings)
        .context("nothing to fit; raise --loops or give --labelled")?;
    let real = leave_one_valve_out(&examples, &settings);
    let held: Vec<(&Example, Scored)> = examples.iter().filter(|e| e.held).map(|e| (e, ask(&rule, e, 1.0))).collect();
    match format {
        Format::Text => say_text(&rule, &real, &held)?,
        Format::Json => say_json(&rule, &real, &held)?,
    }
    if let Some(out) = &args.out {
        let text = serde_json::to_string_pretty(&rule)? + "\n";
        fs::write(out, text).with_context(|| format!("cannot write {}", out.display()))?;
    }
    Ok(Outcome::Done)
}

/// Features of all examples: from the cache file where it has them, else computed.
fn gather(args: &Args) -> anyhow::Result<Vec<Example>> {
    let mut sources: Vec<Source> = Vec::new();
    for half in [Half::Calibration, Half::Report] {
        sources.extend((args.seed..args.seed + args.loops).map(|seed| Source::Loop(half, seed)));
    }
    let mut base = PathBuf::new();
    if let Some(index) = &args.labelled {
        base = index.parent().unwrap_or(Path::new("")).to_owned();
        sources.extend(labelled::read(index)?.into_iter().filter(|c| c.truth().is_some()).map(Source::Recording));
    }
    let mut known = match &args.features {
        Some(path) if path.exists() => read_features(path)?,
        _ => BTreeMap::new(),
    };
    let missing: Vec<Source> = sources.iter().filter(|s| !known.contains_key(&s.name())).map(copy).collect();
    // In batches, so that an interrupted run keeps its results.
    for part in missing.chunks(200) {
        let found = on_all_cores(part, Source::name, |source| look(&base, source));
        let mut lines = String::new();
        for (source, example) in part.iter().zip(found) {
            match example {
                Ok(example) => {
                    lines += &(serde_json::to_string(&example)? + "\n");
                    known.insert(example.name.clone(), example);
                }
                Err(error) => tracing::warn!(name = source.name(), "{error:#}"),
            }
        }
        if let Some(path) = &args.features {
            use std::io::Write as _;
            let file = fs::OpenOptions::new().create(true).append(true).open(path);
            let mut file = file.with_context(|| format!("cannot write {}", path.display()))?;
            file.write_all(lines.as_bytes())?;
        }
    }
    Ok(sources.iter().filter_map(|s| known.remove(&s.name())).collect())
}

fn copy(source: &Source) -> Source {
    match source {
        Source::Loop(half, seed) => Source::Loop(*half, *seed),
        Source::Recording(case) => Source::Recording(case.clone()),
    }
}

fn read_features(path: &Path) -> anyhow::Result<BTreeMap<String, Example>> {
    let text = fs::read_to_string(path).with_context(|| path.display().to_string())?;
    let mut out = BTreeMap::new();
    for (at, line) in text.lines().enumerate() {
        let example: Example =
            serde_json::from_str(line).with_context(|| format!("{}: line {}", path.display(), at + 1))?;
        out.insert(example.name.clone(), example);
    }
    Ok(out)
}

fn look(base: &Path, source: &Source) -> anyhow::Result<Example> {
    let name = source.name();
    let (group, judged, kind, valve, held, truth) = match source {
        Source::Loop(half, seed) => {
            let case = verdict_case(*half, *seed);
            let held = matches!(half, Half::Report);
            (name.clone(), case.judgeable(), case.kind.to_owned(), None, held, case.sticks)
        }
        Source::Recording(case) => {
            let judged = labelled::judgeable(case, &load_samples(&base.join(&case.file))?.loops)?;
            let truth = case.truth().unwrap_or_default();
            (case.group.clone(), judged, case.source.clone(), Some(case.valve.clone()), false, truth)
        }
    };
    let (gate, windows) = match figures(&judged.record, &judged.windows, &judged.params) {
        Ok(windows) => (None, windows),
        Err(gate) => (Some(gate.name().to_owned()), Vec::new()),
    };
    Ok(Example { name, source: kind, valve, group, held, truth, gate, windows })
}

/// Counts by source.
fn by_source<'e>(told: &[(&'e Example, Scored)]) -> BTreeMap<&'e str, Vec<Scored>> {
    let mut out: BTreeMap<&str, Vec<Scored>> = BTreeMap::new();
    for (example, scored) in told {
        out.entry(&example.source).or_default().push(*scored);
    }
    out
}

/// The same answers, with each valve counted once.
fn by_valve<'e>(told: &[(&'e Example, Scored)]) -> Vec<(&'e Example, Scored)> {
    let keys: Vec<&str> = told.iter().map(|(e, _)| e.valve.as_deref().unwrap_or(&e.name)).collect();
    let mut scored: Vec<Scored> = told.iter().map(|(_, s)| *s).collect();
    tally::share_by(&mut scored, &keys);
    told.iter().map(|(e, _)| *e).zip(scored).collect()
}

fn only(told: &[(&Example, Scored)]) -> Vec<Scored> {
    told.iter().map(|(_, s)| *s).collect()
}

fn line_of(name: &str, cases: &[Scored]) -> String {
    let t = Tally::of(cases);
    let brier = tally::brier(cases).map_or("-".to_owned(), |b| format!("{b:.3}"));
    let [low, high] = t.interval().unwrap_or([0.0, 1.0]);
    format!(
        "  {name:<22} {:>7.1}/{:<7.1} {low:.2}..{high:.2}  FN {:>6.1}  FP {:>6.1}  unanswered {:>6.1}  Brier {brier}",
        t.right(),
        t.total(),
        t.missed,
        t.false_alarms,
        t.unanswered
    )
}

/// True and false positive rate.
fn rates(cases: &[Scored]) -> (Option<f64>, Option<f64>) {
    let t = Tally::of(cases);
    let share = |truth: bool, part: f64| {
        let all = cases.iter().filter(|c| c.truth == truth).count();
        (all > 0).then(|| part / all as f64)
    };
    (share(true, t.found), share(false, t.false_alarms))
}

fn say_text(rule: &Rule, real: &[(&Example, Scored)], held: &[(&Example, Scored)]) -> anyhow::Result<()> {
    print(&format!("{}\n", serde_json::to_string_pretty(rule)?))?;
    if !real.is_empty() {
        say(
            "\nrecordings, leave-one-valve-out cross-validation (right/all, 95 %; FN false negatives, FP false positives):",
        )?;
        for (source, cases) in by_source(real) {
            say(line_of(source, &cases))?;
        }
        say(line_of("all", &only(real)))?;
        let valves = by_valve(real);
        say("each valve counted once:")?;
        for (source, cases) in by_source(&valves) {
            say(line_of(source, &cases))?;
        }
        say(line_of("all", &only(&valves)))?;
        say("wrong or unanswered:")?;
        for (example, scored) in real.iter().filter(|(_, s)| s.answer != Some(s.truth)) {
            let p = scored.p.map_or("-".to_owned(), |p| format!("{p:.2}"));
            let why = example.gate.clone().unwrap_or_else(|| said(rule, example));
            say(format!("  {:<50} {} p {p} {why}", example.name, if example.truth { "sticking" } else { "healthy " }))?;
        }
    }
    if held.is_empty() {
        return Ok(());
    }
    say("\nsimulated loops of the report half, 95 % intervals:")?;
    let thresholds = [rule.cuts.called, rule.cuts.alarm];
    let names = thresholds.map(|p| format!("p >= {p}"));
    let called = held.iter().map(|(example, scored)| Called {
        kind: &example.source,
        sticks: scored.truth,
        called: thresholds.map(|p| scored.at(p).answer == Some(true)),
    });
    for line in table([&names[0], &names[1]], &called.collect::<Vec<_>>()) {
        say(line)?;
    }
    for line in reliability_lines(&only(held)) {
        say(line)?;
    }
    Ok(())
}

fn said(rule: &Rule, example: &Example) -> String {
    let features = example.windows.first().map(Figures::features).unwrap_or_default();
    let one = |name: &str| features.get(name).map_or(format!("{name} -"), |x| format!("{name} {x:.2}"));
    rule.names().map(one).collect::<Vec<_>>().join(", ")
}

fn say_json(rule: &Rule, real: &[(&Example, Scored)], held: &[(&Example, Scored)]) -> anyhow::Result<()> {
    let rows = |told: &[(&Example, Scored)]| {
        let row = |cases: &[Scored]| {
            let t = Tally::of(cases);
            json!({"right": t.right(), "total": t.total(), "interval": t.interval(), "counts": t,
                "brier": tally::brier(cases)})
        };
        let sources: BTreeMap<&str, serde_json::Value> =
            by_source(told).into_iter().map(|(s, cases)| (s, row(&cases))).collect();
        json!({"all": row(&only(told)), "sources": sources})
    };
    let kinds: BTreeMap<&str, serde_json::Value> = by_source(held)
        .into_iter()
        .map(|(kind, cases)| {
            let (found, false_alarms) = rates(&cases);
            (kind, json!({"loops": cases.len(), "found": found, "false_alarms": false_alarms}))
        })
        .collect();
    let all = only(held);
    let (found, false_alarms) = rates(&all);
    let bins = tally::reliability_equal(&all, 10);
    say(json!({"schema": "stictiond.calibration.v1", "rule": rule, "recordings": rows(real),
        "valves": rows(&by_valve(real)), "simulated": {"kinds": kinds, "found": found, "false_alarms": false_alarms,
        "brier": tally::brier(&all), "miscalibration": tally::miscalibration(&bins), "reliability": bins}}))?;
    Ok(())
}
