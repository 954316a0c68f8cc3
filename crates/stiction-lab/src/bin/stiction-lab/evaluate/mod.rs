//! `stiction-lab evaluate`: how often the verdict is right on a labelled set.

mod methods;
mod report;
mod simulated;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::ensure;

use stiction::core::record::Record;
use stiction::core::verdict::{AssessParams, Assessment, assess_in_windows};
use stiction_engine::analysis::Judgeable;
use stiction_files::labelled::{self, Case};
use stictiond::cli::reading::ReadArgs;
use stictiond::cli::{Format, Outcome, on_all_cores};

/// Judge a labelled set of recordings, or simulated loops of known truth, and print how often the verdict is right, with every
/// wrong case.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "INDEX.csv has the columns file and label, with paths relative to itself. The labels stiction and deadband are \
    positive; no_stiction, tuning and disturbance negative; other labels are shown but not scored. Optional columns: \
    same_data_group (recordings with the same data), valve, loop. Without a valve column the valve is the loop (else the file \
    name) without groups of digits after underscores and without what follows -DB-: FIC101_0609_0957 and FIC101_0624_0242 are \
    one valve, FIC101.

Simulated loops have seeds of the half that nothing was fitted to; half of them stick.

Examples:
  stiction-lab evaluate labelled/INDEX.csv
  stiction-lab evaluate --simulated 1000
  stiction-lab evaluate --simulated 1000 --alarms
  stiction-lab evaluate labelled/INDEX.csv --simulated 1000 --methods"
)]
pub struct Args {
    /// Index of the labelled set (CSV).
    #[arg(required_unless_present = "simulated")]
    pub index: Option<PathBuf>,
    /// Judge this many simulated loops of known truth.
    #[arg(long, value_name = "LOOPS", value_parser = clap::value_parser!(u64).range(1..))]
    pub simulated: Option<u64>,
    /// Seed of the first simulated loop.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Judge consecutive windows of each simulated loop, and count the loops that would raise an alarm.
    #[arg(long, requires = "simulated")]
    pub alarms: bool,
    /// Compare the shipped classifier with published methods on the same data.
    #[arg(long, conflicts_with = "alarms")]
    pub methods: bool,
    /// Loops or files (name without extension) with a doubtful label; marked, and also counted apart.
    #[arg(long, value_name = "NAME,NAME", value_delimiter = ',')]
    pub doubtful: Vec<String>,
    /// Options for reading the files of the index.
    #[command(flatten)]
    pub reading: ReadArgs,
}

/// A case with its answer.
struct Judged {
    case: Case,
    result: anyhow::Result<Assessment>,
    /// Answers of the published methods in addition to the classifier's, if requested.
    answers: Option<methods::Answers>,
    elapsed_s: f64,
}

/// The first loop of a case's file, whole.
fn judgeable(base: &Path, case: &Case, reading: &ReadArgs) -> anyhow::Result<Judgeable> {
    labelled::judgeable(case, &reading.load_file(&base.join(&case.file))?.loops)
}

/// Every readable case of an index.
///
/// # Errors
/// The index cannot be read.
pub(super) fn records(index: &Path) -> anyhow::Result<Vec<(Record, AssessParams)>> {
    let base = index.parent().unwrap_or(Path::new(""));
    let reading = ReadArgs::default();
    let read = |case: &Case| judgeable(base, case, &reading).ok().map(|one| (one.record, one.params));
    Ok(labelled::read(index)?.iter().filter_map(read).collect())
}

/// Runs the command. A case that cannot be read gives an error line and does not end the command.
///
/// # Errors
/// The index cannot be read, or none of its files.
pub fn run(args: &Args, format: Format) -> anyhow::Result<Outcome> {
    let loops = args.simulated.map(|count| simulated::Loops { count, seed: args.seed });
    let judged = match &args.index {
        Some(index) => judge_all(index, args)?,
        None => Vec::new(),
    };
    if args.methods {
        methods::print(&judged, loops, format)?;
        return Ok(Outcome::Done);
    }
    if args.index.is_some() {
        warn_of_labels(&judged);
        report::print(&judged, format)?;
        let unreadable = judged.iter().filter(|one| one.result.is_err()).count();
        ensure!(unreadable < judged.len(), "no file of the index can be read");
    }
    match loops {
        Some(loops) if args.alarms => simulated::print_alarms(loops, format)?,
        Some(loops) => simulated::print(loops, format)?,
        None => {}
    }
    Ok(Outcome::Done)
}

/// Warns of labels that are not scored: one may be misspelt.
fn warn_of_labels(judged: &[Judged]) {
    let mut unscored: BTreeMap<&str, u64> = BTreeMap::new();
    for one in judged.iter().filter(|one| one.case.truth().is_none()) {
        *unscored.entry(&one.case.label).or_default() += 1;
    }
    for (label, count) in unscored {
        stictiond::cli::warn(format_args!(
            "label {label:?} ({count} of {} recordings) is not scored; scored labels are {}",
            judged.len(),
            Case::SCORED.join(", ")
        ));
    }
}

fn judge_all(index: &Path, args: &Args) -> anyhow::Result<Vec<Judged>> {
    let mut cases = labelled::read(index)?;
    for case in &mut cases {
        let stem = Path::new(&case.file).file_stem().unwrap_or_default();
        case.doubtful |= args.doubtful.iter().any(|name| stem == name.as_str());
    }
    let base = index.parent().unwrap_or(Path::new(""));
    let judge = |case: &Case| {
        let started = Instant::now();
        let judged = judgeable(base, case, &args.reading).map(|Judgeable { record, windows, params }| {
            let assessment = assess_in_windows(&record, &windows, &params);
            let integrating = methods::integrates(case.kind);
            let answers = args.methods.then(|| methods::answers(&record, &assessment, integrating));
            (assessment, answers)
        });
        (judged, started.elapsed().as_secs_f64())
    };
    let results = on_all_cores(&cases, |case| case.file.clone(), judge);
    let with = |(case, (judged, elapsed_s)): (Case, (anyhow::Result<_>, f64))| {
        let (result, answers) = match judged {
            Ok((assessment, answers)) => (Ok(assessment), answers),
            Err(error) => (Err(error), None),
        };
        Judged { case, result, answers, elapsed_s }
    };
    Ok(cases.into_iter().zip(results).map(with).collect())
}
