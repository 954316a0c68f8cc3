//! How far records lie from those that the decision was calibrated on.
//!
//! `WRITE=FILE cargo test -p stiction-lab --test proof val_typical -- --ignored --nocapture` writes what decisions were made from, a
//! line each: of the challenge of `SEED` with `CASES` an effect, or of the real recordings without a seed.

use std::io::Write as _;

use crate::labelled;

use stiction::core::detect::oscillation;
use stiction::core::gap::{Diagnosis, GapOptions, Serial, diagnose};
use stiction::core::record::Record;
use stiction_lab::challenge::{Deck, Split};

/// Samples of a recording that are taken.
const SAMPLES: usize = 1_800;

fn diagnosed(record: &Record) -> Option<Diagnosis> {
    let found = oscillation::detect(&record.op(), &record.pv);
    let options = GapOptions { period_points: found.map(|o| o.period_points), ..GapOptions::default() };
    diagnose(record, &options, &Serial).ok()
}

/// Recordings by name: those of a challenge, or the real ones with a regular cycle.
fn records() -> Vec<(String, Record)> {
    let asked = |name: &str| std::env::var(name).ok().and_then(|text| text.parse::<u64>().ok());
    if let Some(seed) = asked("SEED") {
        let deck = Deck::new(seed, Split::of_seed(seed), asked("CASES").unwrap_or(1) as usize);
        let from = asked("FROM").unwrap_or(0) as usize;
        return (from..deck.len()).filter_map(|i| deck.deal(i)).map(|d| (d.truth.effect, d.record)).collect();
    }
    let all = labelled::labelled_or_skip("val_typical").unwrap_or_default();
    let cut = |record: Record| if record.box_samples == 1 { record.part(0, SAMPLES) } else { record };
    let all = all.into_iter().map(|item| (item.file, cut(item.record)));
    all.filter(|(_, r)| oscillation::detect(&r.op(), &r.pv).is_some_and(|o| o.oscillating)).collect()
}

#[test]
#[ignore = "writes a table"]
fn what_decisions_are_made_from_is_written() {
    let path = std::env::var("WRITE").expect("WRITE=FILE");
    let mut file = std::fs::File::create(path).unwrap();
    for (name, record) in records() {
        let Some(d) = diagnosed(&record) else { continue };
        let (base, noise) = (d.findings.basis.base, d.findings.basis.noise);
        let row = serde_json::json!({
            "name": name, "cause": d.cause.id, "p": d.cause.probability, "features": d.features.values().to_vec(),
            "base": [base.over_floor, base.held_over_floor, Some(base.colour), Some(base.with_op)],
            "noise": [noise.over_base, noise.over_best, noise.beyond_first],
            "points": record.len(), "relative": d.findings.relative_gap, "period": d.findings.blocks.length,
        });
        writeln!(file, "{row}").unwrap();
        file.flush().unwrap();
    }
}
