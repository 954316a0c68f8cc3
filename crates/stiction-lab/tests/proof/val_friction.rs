//! Friction that differs from slip to slip: how often it is named, and what is taken for it, on simulated loops of split A:
//!
//! `SEED=65 CASES=10 cargo test -p stiction-lab --test proof val_friction -- --ignored --nocapture`
//!
//! The rule was chosen on seeds 61 and 63.

use std::collections::BTreeMap;

use super::val_effects::asked;
use stiction::core::detect::oscillation;
use stiction::core::gap::{DEFAULT_EVALUATIONS, GapOptions, Serial, diagnose};
use stiction_lab::challenge::{Deck, Kind, Split};

#[test]
#[ignore = "a benchmark of minutes"]
fn friction_that_differs_from_slip_to_slip_is_named_and_little_else_is_taken_for_it() {
    let (seed, cases) = (asked("SEED", 65), asked("CASES", 10) as usize);
    let others = [
        Kind::ChangingStiction,
        Kind::AsymmetricStiction,
        Kind::Backlash,
        Kind::SlidingValve,
        Kind::RateLimit,
        Kind::StepLoad,
        Kind::ColouredNoise,
        Kind::UpstreamCycle,
    ];
    let kinds: Vec<Option<Kind>> = [Kind::ADDED_LATER].into_iter().chain(others).map(Some).chain([None]).collect();
    let deck = Deck::of(seed, Split::of_seed(seed), &kinds, cases);
    let mut rows: BTreeMap<String, [usize; 2]> = BTreeMap::new();
    for index in 0..deck.len() {
        let dealt = deck.deal(index).unwrap();
        let period = oscillation::detect(&dealt.record.op(), &dealt.record.pv).map(|o| o.period_points);
        let budget_evaluations = asked("EVALUATIONS", DEFAULT_EVALUATIONS);
        let options = GapOptions { period_points: period, budget_evaluations, ..GapOptions::default() };
        let Ok(made) = diagnose(&dealt.record, &options, &Serial) else { continue };
        let row = rows.entry(dealt.truth.effect).or_default();
        row[0] += 1;
        row[1] += usize::from(made.cause.id == Kind::ADDED_LATER.id());
    }
    for (effect, [of, named]) in &rows {
        println!("{effect:<24} named {named} of {of}");
    }
    let [of, named] = rows[Kind::ADDED_LATER.id()];
    let wrong: usize = rows.values().map(|row| row[1]).sum::<usize>() - named;
    assert!(2 * named >= of && wrong < named, "{named} of {of}, {wrong} wrong");
}
