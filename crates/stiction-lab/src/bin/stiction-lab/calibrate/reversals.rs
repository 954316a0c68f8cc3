//! `stiction-lab calibrate --reversals`: how many reversals of the stem make a verdict without enough periods reliable.

use std::path::Path;

use serde_json::json;

use stiction::core::verdict::{AssessParams, CountedBy, assess_in_windows};
use stiction_engine::analysis::Judgeable;
use stiction_files::{labelled, load_samples};
use stiction_lab::truth::rates::share;
use stiction_lab::truth::{Half, verdict_case};
use stictiond::cli::{Format, Outcome, on_all_cores, say};

/// Rows of the table: first and last number of reversals.
const ROWS: [[usize; 2]; 8] = [[0, 0], [1, 1], [2, 3], [4, 7], [8, 11], [12, 19], [20, 39], [40, usize::MAX]];

/// One record that is called sticking.
struct Called {
    sticks: bool,
    /// `None` if the record counts by its periods.
    reversals: Option<usize>,
    /// Whether the probability is high enough for an alarm.
    alarms: bool,
}

/// Assesses a record; `None` if it is not called sticking.
fn called(judgeable: &Judgeable, sticks: bool) -> Option<Called> {
    let params = AssessParams { min_reversals: 0, ..judgeable.params.clone() };
    let a = assess_in_windows(&judgeable.record, &judgeable.windows, &params);
    let reversals = a.reversals.filter(|_| a.counted_by == Some(CountedBy::Reversals));
    let alarms = a.explanation.is_some_and(|opinion| opinion.alarms());
    (a.stiction == Some(true)).then_some(Called { sticks, reversals, alarms })
}

fn of_half(half: Half, loops: u64, seed: u64) -> Vec<Called> {
    let seeds: Vec<u64> = (seed..seed.saturating_add(loops)).collect();
    let judge = |seed: &u64| {
        let case = verdict_case(half, *seed);
        called(&case.judgeable(), case.sticks)
    };
    on_all_cores(&seeds, |seed| format!("{} {seed}", half.name()), judge).into_iter().flatten().collect()
}

fn of_recordings(index: &Path) -> anyhow::Result<Vec<Called>> {
    let base = index.parent().unwrap_or(Path::new(""));
    let cases: Vec<labelled::Case> = labelled::read(index)?.into_iter().filter(|c| c.truth().is_some()).collect();
    let judge = |case: &labelled::Case| {
        let loops = load_samples(&base.join(&case.file))?.loops;
        anyhow::Ok(called(&labelled::judgeable(case, &loops)?, case.truth().unwrap_or_default()))
    };
    let found = on_all_cores(&cases, |case| case.file.clone(), judge);
    Ok(found.into_iter().filter_map(Result::ok).flatten().collect())
}

/// Prints a table for each half, and one for the labelled recordings if there are any.
pub(super) fn run(loops: u64, seed: u64, index: Option<&Path>, format: Format) -> anyhow::Result<Outcome> {
    let halves = [Half::Calibration, Half::Report].map(|half| (half.name(), of_half(half, loops, seed)));
    let recordings = index.map(of_recordings).transpose()?.map(|found| ("labelled recordings", found));
    for (name, found) in halves.iter().chain(&recordings) {
        if format == Format::Text {
            say(format!("{name}: called sticking, without enough periods by the reversals of the stem"))?;
            say(format!("  {:<12}{:<30}{}", "reversals", "stick, of all at p >= 0.5", "stick, of all at p >= 0.7"))?;
        }
        for row in ROWS.map(Some).into_iter().chain([None]) {
            print(name, found, row, format)?;
        }
    }
    Ok(Outcome::Done)
}

/// Prints one row: records in this range of reversals, or those that count by their periods.
fn print(of: &str, found: &[Called], row: Option<[usize; 2]>, format: Format) -> anyhow::Result<()> {
    let is_here = |one: &&Called| match (row, one.reversals) {
        (Some([from, to]), Some(reversals)) => (from..=to).contains(&reversals),
        (row, reversals) => row.is_none() && reversals.is_none(),
    };
    let here = || found.iter().filter(is_here);
    let count = |surely: bool| {
        let told = || here().filter(|one| one.alarms || !surely);
        (told().filter(|one| one.sticks).count(), told().count())
    };
    let [all, sure] = [false, true].map(count);
    match format {
        Format::Json => say(json!({"schema": "stictiond.reversals.v1", "of": of, "reversals": row,
            "called": {"sticking": all.0, "all": all.1}, "sure": {"sticking": sure.0, "all": sure.1}}))?,
        Format::Text => {
            let name = match row {
                None => "by periods".to_owned(),
                Some([from, usize::MAX]) => format!("{from} on"),
                Some([from, to]) if from == to => from.to_string(),
                Some([from, to]) => format!("{from} to {to}"),
            };
            say(format!("  {name:<12}{:<30}{}", share(all.0, all.1).trim_start(), share(sure.0, sure.1).trim_start()))?;
        }
    }
    Ok(())
}
