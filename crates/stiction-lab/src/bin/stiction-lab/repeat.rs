//! Repeatability of the intervals for one valve: between both halves of a recording, and between the windows that the daemon
//! would judge.
//!
//! The true size of the stiction in a recording of a real loop is unknown, but within an hour or a day a valve has one size.
//! Two correct intervals of 90 % from different data overlap in about 97 % of all pairs.

use std::path::{Path, PathBuf};

use serde::Serialize;
use serde_json::json;

use stiction::core::signal::stats;
use stiction::core::verdict::{AssessParams, Assessment, assess, assess_in_windows};
use stiction_engine::analysis::{Due, Points, Section};
use stiction_engine::config::Config;
use stiction_engine::engine::Request;
use stiction_files::labelled::{self, Case};
use stiction_files::{LoadedLoop, load_samples};
use stictiond::cli::{Format, Outcome, on_all_cores, say};

/// Judge both halves of each labelled recording, or its last windows, and tell how often the intervals of s agree where both are
/// called sticking.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  stiction-lab repeat labelled/INDEX.csv
  stiction-lab repeat labelled/INDEX.csv --windows 8")]
pub struct Args {
    /// Index of labelled recordings (CSV), as for `stiction-lab evaluate`.
    pub index: PathBuf,
    /// Instead of the halves, the last N windows of each recording as the daemon would judge them, each compared with the next.
    #[arg(long, value_name = "N")]
    pub windows: Option<usize>,
}

/// One judgement of a section that is called sticking.
#[derive(Debug, Clone, Serialize)]
struct Sized {
    s: f64,
    interval: [f64; 2],
    grade: Option<char>,
    p: Option<f64>,
}

impl Sized {
    fn of(a: &Assessment) -> Option<Self> {
        let (s, interval) = (a.s?, a.s_interval?);
        let (grade, p) = (a.grade, a.p_calibrated);
        (a.stiction == Some(true) && interval[0] > 0.0).then_some(Self { s, interval, grade, p })
    }

    /// Logarithm of the interval's upper end over its lower one.
    fn width(&self) -> f64 {
        (self.interval[1] / self.interval[0]).ln()
    }
}

/// Two judgements of one valve that both call it sticking.
#[derive(Debug, Clone, Serialize)]
struct Pair {
    file: String,
    valve: String,
    of: [Sized; 2],
}

impl Pair {
    fn overlap(&self) -> bool {
        let [a, b] = [0, 1].map(|k| self.of[k].interval);
        a[0] <= b[1] && b[0] <= a[1]
    }

    /// Ratio of the wider interval's width to the other's, as logarithms.
    fn ratio(&self) -> f64 {
        let [a, b] = [0, 1].map(|k| self.of[k].width());
        a.max(b) / a.min(b)
    }
}

/// Prints how well repeated judgements of the recordings of an index agree.
///
/// # Errors
/// The index cannot be read, or nothing can be printed.
pub fn run(args: &Args, format: Format) -> anyhow::Result<Outcome> {
    let base = args.index.parent().unwrap_or(Path::new(""));
    let cases = labelled::read(&args.index)?;
    let pairs = on_all_cores(
        &cases,
        |case| case.file.clone(),
        |case| {
            let loaded = load_samples(&base.join(&case.file));
            let first = loaded.ok().and_then(|loaded| loaded.loops.into_iter().next());
            first.map(|first| pairs(case, &first, args.windows)).unwrap_or_default()
        },
    );
    let pairs: Vec<Pair> = pairs.into_iter().flatten().collect();
    match format {
        Format::Json => {
            for pair in &pairs {
                say(
                    json!({"schema": "stictiond.repeat.v1", "file": pair.file, "valve": pair.valve, "overlap": pair.overlap(),
                    "width_ratio": pair.ratio(), "of": pair.of}),
                )?;
            }
        }
        Format::Text => {
            for pair in &pairs {
                say(line(pair))?;
            }
        }
    }
    summary(&pairs, format)?;
    Ok(Outcome::Done)
}

/// Consecutive judgements that both call the valve sticking.
fn pairs(case: &Case, first: &LoadedLoop, last: Option<usize>) -> Vec<Pair> {
    let found = match last {
        None => halves(case, first),
        Some(count) => windows(case, first, count),
    };
    let sized: Vec<Option<Sized>> = found.iter().map(Sized::of).collect();
    let both = |pair: &[Option<Sized>]| Some([pair[0].clone()?, pair[1].clone()?]);
    let pair = |of| Pair { file: case.file.clone(), valve: case.valve.clone(), of };
    sized.windows(2).filter_map(both).map(pair).collect()
}

fn halves(case: &Case, first: &LoadedLoop) -> Vec<Assessment> {
    let points = Points::of(&first.name, &first.samples, &Config::with_prefix("plant"));
    let params = AssessParams { always_fit: true, kind: case.kind, ..points.settings.assess.clone() };
    let most = points.settings.window.max_points;
    let Ok((whole, _)) = points.record(Section::Whole, most) else { return Vec::new() };
    let middle = whole.start_ns + (whole.end_ns - whole.start_ns) / 2;
    let half = |part| {
        let (record, _) = points.record(part, most).ok()?;
        Some(assess_in_windows(&record, &points.windows(part).ok()?, &params))
    };
    let parts = [Section::Window(whole.start_ns, middle), Section::Window(middle + 1, whole.end_ns)];
    parts.into_iter().filter_map(half).collect()
}

fn windows(case: &Case, first: &LoadedLoop, count: usize) -> Vec<Assessment> {
    let config = Config::with_prefix("plant");
    let due: Vec<Request> = Due::of(&first.name, &first.samples, &config).collect();
    let last = due.iter().skip(due.len().saturating_sub(count));
    let params = |r: &Request| AssessParams { kind: case.kind, ..r.settings.assess.clone() };
    last.map(|request| assess(&request.record(), &params(request))).collect()
}

fn line(pair: &Pair) -> String {
    let one = |k: usize| {
        let Sized { s, interval: [low, high], grade, .. } = &pair.of[k];
        format!("{s:>9.4} ({low:.4} to {high:.4}) {}", grade.unwrap_or('-'))
    };
    let verdict = if pair.overlap() { "" } else { "  exclude each other" };
    format!("{:<48} {:<36} {:<36}{verdict}", pair.file, one(0), one(1))
}

fn summary(pairs: &[Pair], format: Format) -> anyhow::Result<()> {
    let share = |holds: &dyn Fn(&Pair) -> bool| pairs.iter().filter(|p| holds(p)).count();
    let widths: Vec<f64> = pairs.iter().flat_map(|p| p.of.iter().map(Sized::width)).collect();
    let (overlap, near) = (share(&Pair::overlap), share(&|p| p.ratio() <= 2.0));
    let (median, wide) = (stats::median(&widths), stats::quantile(&widths, 0.9));
    match format {
        Format::Json => say(json!({"schema": "stictiond.repeats.v1", "pairs": pairs.len(), "overlap": overlap,
            "log_width_median": median, "log_width_p90": wide, "widths_within_twice": near}))?,
        Format::Text => say(format!(
            "{} pairs called sticking twice: the intervals of s overlap in {overlap}; log(upper end / lower end): median {median:.2}, ninth \
             decile {wide:.2}; within a factor of 2 in {near}",
            pairs.len()
        ))?,
    }
    Ok(())
}
