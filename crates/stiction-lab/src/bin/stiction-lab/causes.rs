//! `stiction-lab causes`: how often tuning and disturbances are named, and how often correctly.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use serde_json::json;

use stiction::core::verdict::{Assessment, Verdict, assess_in_windows};
use stiction_engine::analysis::Judgeable;
use stiction_files::{labelled, load_samples};
use stiction_lab::truth::rates::share;
use stiction_lab::truth::{CAUSES, Half, TruthLoop, cause_case};
use stictiond::cli::{Format, Outcome, on_all_cores, say};

/// Judge simulated loops of known cause (tuning, disturbance, valve, none), half of them behind a set point that moves, and labelled
/// recordings; tell how often the cause is named, and named rightly.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  stiction-lab causes --loops 800 --seed 54000
  stiction-lab causes --loops 0 --labelled labelled/INDEX.csv")]
pub struct Args {
    /// Number of simulated loops.
    #[arg(long, value_name = "N", default_value_t = 800)]
    pub loops: u64,
    /// Seed of the first loop.
    #[arg(long, value_name = "SEED", default_value_t = 54_000)]
    pub seed: u64,
    /// Draw from the half of the loops that bounds and weights are fitted to, not from the half that is reported.
    #[arg(long)]
    pub calibration: bool,
    /// Index of labelled recordings (CSV), as for `stiction-lab evaluate`; those labelled tuning or disturbance are judged.
    #[arg(long, value_name = "INDEX")]
    pub labelled: Option<PathBuf>,
}

/// One judged loop.
struct Judged {
    name: String,
    truth: &'static str,
    verdict: Verdict,
    p: Option<f64>,
    /// Groups with a row in the table.
    groups: Vec<String>,
    /// Whether an external disturbance acts on the loop, whatever the cause is called.
    disturbed: bool,
}

impl Judged {
    fn simulated(found: &TruthLoop, a: &Assessment) -> Self {
        let moves = found.sp.windows(2).any(|w| w[0] != w[1]);
        let groups = vec![
            format!("process: {}", found.process_kind),
            format!("valve: {}", found.law),
            format!("set point {}", if moves { "moves" } else { "constant" }),
            format!("{}: {}", found.cause, found.kind),
        ];
        let disturbed = found.cause == "none" && found.kind != "noise only";
        let name = format!("seed {} ({}, {}, {})", found.seed, found.kind, found.process_kind, found.law);
        Self { name, truth: found.cause, verdict: a.verdict, p: a.p_calibrated, groups, disturbed }
    }

    /// Whether the named cause is right; `None` if none is named.
    fn right(&self) -> Option<bool> {
        match self.verdict {
            Verdict::Tuning => Some(self.truth == "tuning"),
            Verdict::Disturbance => Some(self.truth == "disturbance" || self.disturbed),
            _ => None,
        }
    }

    fn sticking(&self) -> bool {
        self.verdict.stiction() == Some(true)
    }
}

/// Shares of some judged loops.
struct Shares {
    tuning: [usize; 2],
    disturbance: [usize; 2],
    right: [usize; 2],
    called: [usize; 2],
    found: [usize; 2],
}

impl Shares {
    fn of<'j>(judged: impl Iterator<Item = &'j Judged> + Clone) -> Self {
        let count = |holds: &dyn Fn(&Judged) -> Option<bool>| {
            let told = judged.clone().filter_map(holds);
            told.fold([0, 0], |[part, all], is| [part + usize::from(is), all + 1])
        };
        let of = |truth: &'static str, verdict: Verdict| {
            count(&move |j: &Judged| (j.truth == truth).then(|| j.verdict == verdict))
        };
        Self {
            tuning: of("tuning", Verdict::Tuning),
            disturbance: of("disturbance", Verdict::Disturbance),
            right: count(&Judged::right),
            called: count(&|j| (j.truth != "valve").then(|| j.sticking())),
            found: count(&|j| (j.truth == "valve").then(|| j.sticking())),
        }
    }

    fn cells(&self) -> [[usize; 2]; 5] {
        [self.tuning, self.disturbance, self.right, self.called, self.found]
    }
}

const HEADS: [&str; 5] = ["tuning", "disturbance", "named right", "healthy sticking", "sticking found"];

/// Prints the tables of the simulated loops and the answers to the recordings.
///
/// # Errors
/// The index cannot be read, or nothing can be printed.
pub fn run(args: &Args, format: Format) -> anyhow::Result<Outcome> {
    let half = if args.calibration { Half::Calibration } else { Half::Report };
    let seeds: Vec<u64> = (args.seed..args.seed.saturating_add(args.loops)).collect();
    let judge = |seed: &u64| {
        let case = cause_case(half, *seed);
        Judged::simulated(&case, &assess(&case.judgeable()))
    };
    let judged: Vec<Judged> =
        on_all_cores(&seeds, |seed| format!("{} {seed}", half.name()), judge).into_iter().collect();
    if !judged.is_empty() {
        simulated(&judged, half, format)?;
    }
    if let Some(index) = &args.labelled {
        recordings(index, format)?;
    }
    Ok(Outcome::Done)
}

fn assess(of: &Judgeable) -> Assessment {
    assess_in_windows(&of.record, &of.windows, &of.params)
}

fn simulated(judged: &[Judged], half: Half, format: Format) -> anyhow::Result<()> {
    let groups: BTreeSet<&String> = judged.iter().flat_map(|j| &j.groups).collect();
    let rows = groups.into_iter().map(|group| {
        let here = judged.iter().filter(move |j| j.groups.contains(group));
        (group.as_str(), Shares::of(here))
    });
    let rows: Vec<(&str, Shares)> = [("all", Shares::of(judged.iter()))].into_iter().chain(rows).collect();
    if format == Format::Json {
        for (group, shares) in rows {
            let cells: BTreeMap<&str, [usize; 2]> = HEADS.into_iter().zip(shares.cells()).collect();
            say(json!({"schema": "stictiond.causes.v1", "half": half.name(), "group": group, "shares": cells}))?;
        }
        for j in judged {
            say(json!({"schema": "stictiond.cause.v1", "loop": j.name, "truth": j.truth, "verdict": j.verdict.name(),
                "p_calibrated": j.p}))?;
        }
        return Ok(());
    }
    say(format!("{} loops of the {} half: verdicts by cause", judged.len(), half.name()))?;
    let heads: String = Verdict::ALL.iter().map(|v| format!("{:>17}", v.name())).collect();
    say(format!("  {:<12}{heads}", "cause"))?;
    for cause in CAUSES {
        let count = |v: Verdict| judged.iter().filter(|j| j.truth == cause && j.verdict == v).count();
        let cells: String = Verdict::ALL.iter().map(|v| format!("{:>17}", count(*v))).collect();
        say(format!("  {cause:<12}{cells}"))?;
    }
    say(
        "shares (Wilson's 95 %): tuning and disturbances named; causes named right; healthy valves called sticking; sticking valves found",
    )?;
    let line = |name: &str, cells: Vec<String>| {
        let cells: String = cells.iter().map(|cell| format!("  {cell:<25}")).collect();
        format!("  {name:<34}{cells}").trim_end().to_owned()
    };
    say(line("", HEADS.map(str::to_owned).into()))?;
    for (group, shares) in rows {
        say(line(group, shares.cells().map(|[part, all]| share(part, all)).into()))?;
    }
    say("named wrongly, or healthy and called sticking:")?;
    for j in judged.iter().filter(|j| j.right() == Some(false) || (j.sticking() && j.truth != "valve")) {
        say(format!("  {:<12} called {:<12} p {:.2}  {}", j.truth, j.verdict.name(), j.p.unwrap_or(f64::NAN), j.name))?;
    }
    Ok(())
}

fn recordings(index: &Path, format: Format) -> anyhow::Result<()> {
    let base = index.parent().unwrap_or(Path::new(""));
    let labels = ["tuning", "disturbance"];
    let cases: Vec<labelled::Case> =
        labelled::read(index)?.into_iter().filter(|c| labels.contains(&c.label.as_str())).collect();
    let judge = |case: &labelled::Case| {
        let loops = load_samples(&base.join(&case.file))?.loops;
        anyhow::Ok(assess(&labelled::judgeable(case, &loops)?))
    };
    let found = on_all_cores(&cases, |case| case.file.clone(), judge);
    for (case, answer) in cases.iter().zip(found) {
        let answer = answer?;
        let missing: Vec<&str> = answer.missing.iter().map(|m| m.words()).collect();
        let (verdict, p) = (answer.verdict.name(), answer.p_calibrated);
        match format {
            Format::Json => {
                say(json!({"schema": "stictiond.cause_recording.v1", "file": case.file, "label": case.label,
                "verdict": verdict, "missing": answer.missing, "reason": answer.reason, "p_calibrated": p}))?
            }
            Format::Text => {
                let why = answer.reason.map_or_else(|| missing.join(", "), |reason| reason.replace('_', " "));
                say(format!("  {:<56}{:<13}{verdict:<16} {why}", case.file, case.label).trim_end())?;
            }
        }
    }
    Ok(())
}
