//! Pools windows of one valve: five of four periods compared with one recording of twenty.
//!
//! `cargo test -p stiction-lab --test proof val_pool -- --ignored --nocapture` prints the table; `SEED` (46), `CASES` (1) of
//! each effect and `EVALUATIONS` choose the loops and the search.

use stiction::core::gap::pool::{self, PoolError, Together, Window};
use stiction::core::gap::{Diagnosis, GapOptions, NONE, Serial, UNKNOWN, diagnose};
use stiction::core::record::Record;
use stiction_lab::challenge::Kind;
use stiction_lab::challenge::windows::{InWindows, in_windows};

/// Model responses that each search may compute: three tenths of those of `gap`, so that the benchmark ends in half an hour.
const EVALUATIONS: u64 = 300_000;

fn number(name: &str, usual: u64) -> u64 {
    std::env::var(name).ok().and_then(|text| text.parse().ok()).unwrap_or(usual)
}

fn alone(record: &Record) -> Option<Diagnosis> {
    let options = GapOptions { budget_evaluations: number("EVALUATIONS", EVALUATIONS), ..GapOptions::default() };
    diagnose(record, &options, &Serial).ok()
}

fn together(windows: &[(String, &Record, Diagnosis)]) -> Result<Together, PoolError> {
    let each: Vec<Window> =
        windows.iter().map(|(source, record, diagnosis)| Window::of(source, record, diagnosis)).collect();
    pool::decide_together(&each)
}

fn diagnosed<'r>(records: impl IntoIterator<Item = &'r Record>) -> Vec<(String, &'r Record, Diagnosis)> {
    let named = |(at, record): (usize, &'r Record)| Some((format!("{at}.csv"), record, alone(record)?));
    records.into_iter().enumerate().filter_map(named).collect()
}

#[test]
#[ignore = "a benchmark that prints its table"]
fn five_windows_of_four_periods_answer_better_than_one() {
    let (seed, cases) = (number("SEED", 46), number("CASES", 1) as usize);
    let kinds = Kind::CATALOGUE.into_iter().chain([Kind::FILTER]).map(Some).chain([None; 4]);
    // Right name, and wrong name: for the recording of twenty periods, five windows together, one window (mean of the five).
    let (mut right, mut wrong, mut all) = ([0.0; 3], [0.0; 3], 0);
    for (kind, index) in kinds.flat_map(|kind| (0..cases).map(move |i| (kind, i))) {
        // Every loop without an effect has its own seed.
        let InWindows { effect, whole, windows } =
            in_windows(seed + if kind.is_none() { 2 * all } else { 0 }, kind, index);
        let each = diagnosed(&windows);
        let said = |found: Option<Diagnosis>| found.map_or_else(|| "-".to_owned(), |d| d.cause.id);
        let pooled = together(&each).map_err(|e| println!("{e}"));
        let answers = [said(alone(&whole)), pooled.map_or_else(|()| "-".to_owned(), |p| p.cause.id)];
        let singles: Vec<&str> = each.iter().map(|(_, _, d)| d.cause.id.as_str()).collect();
        let mut count = |place: usize, answer: &str, share: f64| {
            right[place] += if answer == effect { share } else { 0.0 };
            wrong[place] += if ![&effect, UNKNOWN, NONE, "-"].contains(&answer) { share } else { 0.0 };
        };
        answers.iter().enumerate().for_each(|(place, answer)| count(place, answer, 1.0));
        singles.iter().for_each(|answer| count(2, answer, 1.0 / windows.len() as f64));
        all += 1;
        println!("{effect:<20} {:<28} {:<28} {}", answers[0], answers[1], singles.join(" "));
    }
    println!(
        "of {all}, one of twenty, five of four together, one of four: right {right:.1?}, another name {wrong:.1?}"
    );
    assert!(right[1] >= right[2] && wrong[1] <= wrong[2]);
}

#[test]
fn what_several_windows_show_is_the_answer_and_the_clearest_is_shown() {
    let InWindows { windows, .. } = in_windows(48, None, 0);
    let each = diagnosed(&windows[..3]);
    let found = together(&each).unwrap();
    assert_eq!(found.cause.id, NONE, "{:?}", found.cause);
    let clearest = &each[found.clearest].2.cause;
    let is_clearest =
        |w: &(String, &Record, Diagnosis)| w.2.cause.id != NONE || w.2.cause.probability <= clearest.probability;
    assert!(each.iter().all(is_clearest));
    // A frozen sensor in one window may be chance; in two windows it is the answer.
    let mut frozen = each.clone();
    let trace = "frozen_sensor".to_owned();
    frozen[0].2.findings.basis.traces = vec![trace.clone()];
    assert_eq!(together(&frozen).unwrap().cause.id, NONE);
    frozen[2].2.findings.basis.traces = vec![trace.clone()];
    assert_eq!(together(&frozen).unwrap().cause.id, trace);
}

#[test]
fn one_window_is_refused() {
    let one = in_windows(48, None, 0);
    let each = diagnosed(&one.windows[..1]);
    assert_eq!(together(&each).unwrap_err(), PoolError::Single);
}
