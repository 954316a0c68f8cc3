//! Effects that only the budget names, on simulated loops on which nothing was chosen:
//!
//! `SEED=60 CASES=20 cargo test -p stiction-lab --test proof val_effects -- --ignored --nocapture`
//!
//! Odd seeds are the development set. Seed 66 was used for development, too.

use std::collections::BTreeMap;

use stiction::core::detect::oscillation;
use stiction::core::gap::budget::{Budget, Known};
use stiction::core::gap::{GapOptions, Serial, diagnose};
use stiction::core::record::Record;
use stiction_lab::challenge::{Deck, Kind, Split, TruthCase};

/// Models tried per diagnosis.
const FEW: u64 = 20_000;

/// An environment variable as a number.
pub(crate) fn asked(name: &str, usual: u64) -> u64 {
    std::env::var(name).ok().and_then(|text| text.parse().ok()).unwrap_or(usual)
}

/// The budget of a record after a short diagnosis; also the cause that it contains, and whether the cause is confirmed.
pub(crate) fn budget(record: &Record) -> Option<(Budget, Option<(String, bool)>)> {
    let period = oscillation::detect(&record.op(), &record.pv).map(|o| o.period_points);
    let options = GapOptions { period_points: period, budget_evaluations: FEW, ..GapOptions::default() };
    let made = diagnose(record, &options, &Serial).ok()?;
    let known = Known {
        models: &made.runs.fits_to_all,
        from: made.findings.blocks.from,
        noise_sd: made.findings.floor.noise_sd,
        ..Known::default()
    };
    let budget = Budget::of(record, known)?;
    let cause = budget.model.cause(&budget.series).map(|(run, _)| (run.id.clone(), made.cause.confirmed));
    Some((budget, cause))
}

/// Effects that the budget names, and whether they are confirmed.
fn names(record: &Record) -> Vec<(String, bool)> {
    budget(record).map(|(budget, cause)| budget.named().into_iter().chain(cause).collect()).unwrap_or_default()
}

/// Number of loops, how many name the added effect (and confirm it), and the same for each effect that was not added.
#[derive(Default)]
struct Row {
    of: usize,
    right: [usize; 2],
    others: BTreeMap<String, [usize; 2]>,
}

#[test]
#[ignore = "a benchmark of minutes"]
fn effects_that_the_budget_alone_names() {
    let (seed, cases) = (asked("SEED", 60), asked("CASES", 20) as usize);
    let beside = [Kind::StepLoad, Kind::Sinusoid, Kind::Ramp, Kind::ColouredNoise, Kind::UpstreamCycle];
    let kinds: Vec<Option<Kind>> = [Kind::OF_BUDGET].into_iter().chain(beside).map(Some).chain([None]).collect();
    let deck = Deck::of(seed, Split::of_seed(seed), &kinds, cases);
    let mut rows: BTreeMap<String, Row> = BTreeMap::new();
    for index in 0..deck.len() {
        let dealt = deck.deal(index).unwrap();
        let names = names(&dealt.record);
        let TruthCase { effect, form, .. } = dealt.truth;
        let row = rows.entry(form.map_or(effect.clone(), |form| format!("{effect}, {form}"))).or_default();
        row.of += 1;
        let mut once: BTreeMap<String, bool> = BTreeMap::new();
        for (id, sure) in names {
            *once.entry(id).or_default() |= sure;
        }
        for (id, sure) in once {
            let count = if id == effect { &mut row.right } else { row.others.entry(id).or_default() };
            count[0] += 1;
            count[1] += usize::from(sure);
        }
    }
    println!("{:<32} {:>4} {:>6} {:>10}  other names (confirmed)", "effect", "of", "named", "confirmed");
    for (effect, row) in &rows {
        let others: Vec<String> = row.others.iter().map(|(id, [all, sure])| format!("{id} {all} ({sure})")).collect();
        println!("{effect:<32} {:>4} {:>6} {:>10}  {}", row.of, row.right[0], row.right[1], others.join(", "));
    }
    // A load through the process looks like a wandering load; one on PV itself must be found.
    let seen = &rows["upsets, on pv"];
    assert!(2 * seen.right[0] >= seen.of, "{} of {}", seen.right[0], seen.of);
    let wrong = rows["none"].others.get(Kind::OF_BUDGET.id()).map_or(0, |[all, _]| *all);
    assert!(10 * wrong <= rows["none"].of, "{wrong} of {}", rows["none"].of);
}
