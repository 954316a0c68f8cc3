//! All available recordings of real loops: the headline of `gap` explains something, and a plant could tolerate its bump test.

use crate::labelled;

use stiction::core::detect::oscillation;
use stiction::core::gap::document::GapDocument;
use stiction::core::gap::{GapOptions, Serial, diagnose};
use stiction::core::guard::SHIFT_S;
use stiction::words::gap_text::{answer, summary};

/// Models tried per record: a fraction of those of `gap`, so that the test ends in minutes.
const EVALUATIONS: u64 = 20_000;

/// Smallest share of the gap that a headline may claim to close, %.
const LEAST_CLOSED: f64 = 10.0;

/// The percentage that a sentence claims to be closed.
fn closed_of(sentence: &str) -> Option<f64> {
    let (_, rest) = sentence.split_once("closes ")?;
    rest.split(' ').find_map(|word| word.parse().ok())
}

/// Faults of a displayed diagnosis.
fn faults(d: &GapDocument) -> Vec<String> {
    let [conclusion, next, cost] = summary(d);
    let mut out = Vec::new();
    let headline = answer(d);
    let leads = !["unknown", "none", "good enough"].iter().any(|word| headline.starts_with(word));
    if leads && d.named().is_some_and(|e| e.closed_pct.is_some_and(|c| c < LEAST_CLOSED)) {
        out.push(format!("a headline that closes next to nothing: {headline}"));
    }
    let no_claim = ["Unknown", "No further effect", "The model is good enough"];
    let claims = !no_claim.iter().any(|word| conclusion.starts_with(word));
    if claims && closed_of(&conclusion).is_some_and(|c| c < LEAST_CLOSED) {
        out.push(format!("a conclusion that closes next to nothing: {conclusion}"));
    }
    if leads != (claims || conclusion.starts_with("Unknown: suspected")) {
        out.push(format!("{headline} beside {conclusion}"));
    }
    if d.next_test.as_ref().is_some_and(|t| 4.0 * t.duration_s > SHIFT_S) {
        out.push(format!("a test longer than a shift: {next} {cost}"));
    }
    if d.gap.relative.is_some_and(|r| r > 1.0) && d.next_test.is_some() {
        out.push(format!("a test from a base that is worse than PV's mean: {next}"));
    }
    out
}

#[test]
#[ignore = "long: tests/run.sh --all"]
fn no_headline_on_any_recording_closes_less_than_a_tenth_of_the_gap() {
    let test = "no_headline_on_any_recording_closes_less_than_a_tenth_of_the_gap";
    let Some(all) = labelled::labelled_or_skip(test) else { return };
    assert!(all.len() >= 100, "{} recordings only", all.len());
    let (mut wrong, mut diagnosed) = (Vec::new(), 0);
    for item in &all {
        let period = oscillation::detect(&item.record.op(), &item.record.pv).map(|o| o.period_points);
        let options = GapOptions { period_points: period, budget_evaluations: EVALUATIONS, ..GapOptions::default() };
        // A record without a base is refused with a reason.
        let Ok(diagnosis) = diagnose(&item.record, &options, &Serial) else { continue };
        diagnosed += 1;
        let document = GapDocument::new(&item.file, &item.record, &options, &diagnosis);
        wrong.extend(faults(&document).into_iter().map(|what| format!("{}: {what}", item.file)));
    }
    assert!(diagnosed >= 50, "{diagnosed} of {} recordings were diagnosed", all.len());
    assert!(wrong.is_empty(), "{} of {diagnosed}:\n{}", wrong.len(), wrong.join("\n"));
}
