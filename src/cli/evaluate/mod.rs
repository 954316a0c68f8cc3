//! `stictiond evaluate`: how often the verdict is right on a labelled set.

pub mod index;
mod report;

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::bail;

use super::reading::ReadArgs;
use super::selection::{Whole, whole_record};
use super::{Format, Outcome, on_all_cores};
use index::Case;
use stiction::record::Record;
use stiction::verdict::{AssessParams, Assessment, assess_in_windows};
use stiction_monitor::config::Config;

/// Judge a labelled set of recordings and print how often the verdict is right, wrong cases included.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "INDEX.csv has the columns file,label with paths relative to itself. Labels stiction and deadband
are positive; no_stiction, tuning and disturbance negative; others are shown but not scored.
Optional columns: same_data_group (recordings that hold the same data), valve, loop. Where valve is
missing it is the loop (else the file's name) without groups of digits behind underscores and
without what follows -DB-: FIC101_0609_0957 and FIC101_0624_0242 are one valve, FIC101.
Example: stictiond evaluate labelled/INDEX.csv"
)]
pub struct Args {
    /// The index.
    pub index: PathBuf,
    /// Loops or files (their names' stems) whose label is not believed: marked, and counted apart too.
    #[arg(long, value_name = "NAME,NAME", value_delimiter = ',')]
    pub doubtful: Vec<String>,
    /// How the files of the index are read.
    #[command(flatten)]
    pub reading: ReadArgs,
}

/// A case with its answer.
struct Judged {
    case: Case,
    result: anyhow::Result<Assessment>,
    elapsed_s: f64,
}

/// A recording as it is judged.
pub(super) struct Judgeable {
    pub record: Record,
    /// The windows that it is judged in where it is long.
    pub windows: Vec<Record>,
    pub params: AssessParams,
}

/// The first loop of a case's file, whole.
pub(super) fn record_of(base: &Path, case: &Case, reading: &ReadArgs) -> anyhow::Result<Judgeable> {
    let loaded = reading.load_file(&base.join(&case.file))?;
    let Some(first) = loaded.loops.first() else { bail!("{}: holds no loop", case.file) };
    let Whole { record, windows, settings } = whole_record(first, &Config::with_prefix("plant"))?;
    let params = AssessParams { always_fit: true, kind: case.kind, ..settings.assess.clone() };
    Ok(Judgeable { record, windows, params })
}

/// Every case of an index that can be read.
///
/// # Errors
/// The index cannot be read.
pub(super) fn records(index: &Path) -> anyhow::Result<Vec<(Record, AssessParams)>> {
    let base = index.parent().unwrap_or(Path::new(""));
    let reading = ReadArgs::default();
    let read = |case: &Case| record_of(base, case, &reading).ok().map(|one| (one.record, one.params));
    Ok(index::read(index)?.iter().filter_map(read).collect())
}

/// Runs the command. A case that cannot be read is an error line, not the end.
///
/// # Errors
/// The index cannot be read.
pub fn run(args: &Args, format: Format) -> anyhow::Result<Outcome> {
    let mut cases = index::read(&args.index)?;
    for case in &mut cases {
        let stem = Path::new(&case.file).file_stem().unwrap_or_default();
        case.doubtful |= args.doubtful.iter().any(|name| stem == name.as_str());
    }
    let base = args.index.parent().unwrap_or(Path::new(""));
    let judge = |case: &Case| {
        let started = Instant::now();
        let result =
            record_of(base, case, &args.reading).map(|one| assess_in_windows(&one.record, &one.windows, &one.params));
        (result, started.elapsed().as_secs_f64())
    };
    let results = on_all_cores(&cases, |case| case.file.clone(), judge);
    let with = |(case, (result, elapsed_s))| Judged { case, result, elapsed_s };
    let judged: Vec<Judged> = cases.into_iter().zip(results).map(with).collect();
    report::print(&judged, format)?;
    Ok(Outcome::Done)
}
