//! Windows of one valve together: five of four periods against one recording of twenty.
//!
//! `cargo test -p stiction-lab --test proof val_pool -- --ignored --nocapture` prints the table; `SEED` (46), `CASES` (1) of
//! each effect and `EVALUATIONS` choose the loops and the search.

use stiction::gap::pool::{self, PoolError, Window};
use stiction::gap::{Diagnosis, GapOptions, Serial, diagnose};
use stiction::record::Record;
use stiction_lab::challenge::Kind;
use stiction_lab::challenge::windows::{InWindows, in_windows};

/// Model responses that each search may compute: three tenths of what `gap` takes, so that the benchmark ends in half an hour.
const EVALUATIONS: u64 = 300_000;

fn named(records: &[Record]) -> Vec<Window> {
    let name = |(at, record): (usize, &Record)| Window { source: format!("{at}.csv"), record: record.clone() };
    records.iter().enumerate().map(name).collect()
}

fn options() -> GapOptions {
    GapOptions { budget_evaluations: number("EVALUATIONS", EVALUATIONS), ..GapOptions::default() }
}

fn together(records: &[Record]) -> Result<Diagnosis, PoolError> {
    pool::diagnose(&named(records), &options(), &Serial).map(|found| found.diagnosis)
}

fn number(name: &str, usual: u64) -> u64 {
    std::env::var(name).ok().and_then(|text| text.parse().ok()).unwrap_or(usual)
}

#[test]
#[ignore = "a benchmark that prints its table"]
fn five_windows_of_four_periods_answer_as_one_of_twenty() {
    let (seed, cases) = (number("SEED", 46), number("CASES", 1) as usize);
    let kinds = Kind::CATALOGUE.into_iter().chain([Kind::FILTER]).map(Some).chain([None; 4]);
    let mut right = [0; 3];
    let mut all = 0;
    for (kind, index) in kinds.flat_map(|kind| (0..cases).map(move |i| (kind, i))) {
        // Each loop without an effect is another.
        let InWindows { effect, whole, windows } =
            in_windows(seed + if kind.is_none() { 2 * all } else { 0 }, kind, index);
        let options = options();
        let said = |found: Option<Diagnosis>| found.map_or_else(|| "-".to_owned(), |d| d.cause.id);
        let answers = [
            said(diagnose(&whole, &options, &Serial).ok()),
            said(together(&windows).map_err(|e| println!("{e}")).ok()),
            said(diagnose(&windows[0], &options, &Serial).ok()),
        ];
        for (count, answer) in right.iter_mut().zip(&answers) {
            *count += u64::from(*answer == effect);
        }
        all += 1;
        println!("{effect:<20} {:<28} {:<28} {}", answers[0], answers[1], answers[2]);
    }
    let share = right.map(|n| n as f64 / all as f64);
    println!(
        "top 1 of {all}: one of twenty {:.2}, five of four {:.2}, one of four {:.2}",
        share[0], share[1], share[2]
    );
    assert!(share[1] >= share[0] - 0.05, "{share:?}");
}

#[test]
fn windows_at_levels_of_their_own_find_the_levels_and_nothing_else() {
    let InWindows { whole, windows, .. } = in_windows(48, None, 0);
    let found = pool::diagnose(&named(&windows), &options(), &Serial).unwrap();
    assert_eq!(found.diagnosis.cause.id, "none", "{:?}", found.diagnosis.cause);
    assert_eq!(found.windows.len(), 5);
    let sd = stiction::signal::stats::std_dev(&whole.pv);
    let mut at = 0;
    let given: Vec<f64> = windows
        .iter()
        .map(|window| {
            at += window.len();
            window.pv[0] - whole.pv[at - window.len()]
        })
        .collect();
    let middle = given.iter().sum::<f64>() / 5.0;
    for (window, level) in found.windows.iter().zip(given) {
        assert!((window.level - (level - middle)).abs() < 0.1 * sd, "{} {}", window.level, level - middle);
    }
}

#[test]
fn a_window_that_does_not_fit_is_named() {
    let one = in_windows(48, None, 0);
    let pooled = |windows: &[Record]| together(windows).map(|found| found.cause).unwrap_err().to_string();
    let [a, b, c] = [0, 1, 2].map(|at| one.windows[at].clone());
    assert!(pooled(std::slice::from_ref(&a)).contains("at least two"));
    let slow = Record { ts_s: 3.0 * c.ts_s, ..c.clone() };
    let told = pooled(&[a.clone(), b.clone(), slow]);
    assert!(told.starts_with("2.csv: sampled every"), "{told}");
    let told = pooled(&[a.clone(), b.clone(), c.part(0, 70)]);
    assert!(told.starts_with("2.csv: 70 points"), "{told}");
    let told = pooled(&[a.clone(), b.clone(), a.clone()]);
    assert!(told.starts_with("2.csv: the same data as 0.csv"), "{told}");
    let still = Record { op_path: vec![50.0; c.len()], ..c.clone() };
    let told = pooled(&[a.clone(), still]);
    assert!(told.starts_with("1.csv: OP is constant"), "{told}");
    // No model of the first follows a loop with a gain of the other sign.
    let mut turned = c.clone();
    turned.pv.iter_mut().for_each(|y| *y = -*y);
    let told = pooled(&[a, b, turned, one.windows[3].clone(), one.windows[4].clone()]);
    assert!(told.starts_with("2.csv: the model of all windows"), "{told}");
}
