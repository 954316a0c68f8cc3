//! `stiction-lab calibrate --bump-test`: runs the proposed bump tests on simulated valves.

use std::collections::BTreeMap;

use serde_json::json;

use stiction_lab::bump_test::{LAWS, NOISE, Row, Trial, enough, sticking, table};
use stiction_lab::truth::Half;
use stictiond::cli::{Format, Outcome, on_all_cores, say};

/// Most loops per law tried for each requested test.
const MORE: u64 = 4;
/// Number of seeds per batch.
const BATCH: u64 = 16;

/// Runs `tests` tests, equally many for each law and level of noise, and repeats each on a valve without friction.
pub(super) fn run(tests: u64, seed: u64, format: Format) -> anyhow::Result<Outcome> {
    let cells = LAWS.len() * (NOISE.len() - 1);
    let each = (tests as usize).div_ceil(cells).max(1);
    let (mut found, mut at) = (Vec::<Trial>::new(), seed);
    let full = |found: &[Trial]| found.iter().filter(|t| t.refused.is_none()).count() >= each * cells;
    while !full(&found) && at < seed.saturating_add(MORE * tests) {
        let items: Vec<(&'static str, u64)> =
            (at..at.saturating_add(BATCH)).flat_map(|s| LAWS.map(|law| (law, s))).collect();
        let name = |item: &(&'static str, u64)| format!("{} {}", item.0, item.1);
        found.extend(on_all_cores(&items, name, |(law, s)| sticking(Half::Report, law, *s)).into_iter().flatten());
        found = enough(found, each);
        at = at.saturating_add(BATCH);
    }
    let rows = table(&found);
    match format {
        Format::Json => say(json!({"schema": "stictiond.bump_test.v1", "rows": rows, "trials": found}))?,
        Format::Text => text(&rows, &found)?,
    }
    Ok(Outcome::Done)
}

fn text(rows: &[Row], trials: &[Trial]) -> anyhow::Result<()> {
    say(
        "law       noise, %   estimates  tests  ended  within 15 %  error %: median   p90  PV's way  time  no friction: none read",
    )?;
    for r in rows {
        let noise = format!("{} to {}", 100.0 * r.noise[0], 100.0 * r.noise[1]);
        let share = |n: usize| format!("{n} ({:.0} %)", 100.0 * n as f64 / r.tests.max(1) as f64);
        let ([median, p90], [way, time]) = (r.error_pct, r.travel_and_time);
        say(format!(
            "{:<9} {noise:<9}  {:>9}  {:>5}  {:>5}  {:>11}  {median:>15.1}  {p90:>4.1}  {way:>8.2}  {time:>4.2}  {:>22}",
            r.law,
            r.estimates,
            r.tests,
            r.ended,
            share(r.close),
            share(r.healthy_below)
        ))?;
    }
    let mut refused: BTreeMap<&str, usize> = BTreeMap::new();
    trials.iter().filter_map(|t| t.refused).for_each(|why| *refused.entry(why).or_default() += 1);
    let refused: Vec<String> = refused.iter().map(|(why, n)| format!("{why} {n}")).collect();
    let refused = if refused.is_empty() { "none".to_owned() } else { refused.join(", ") };
    say(format!("no test proposed: {refused}"))?;
    Ok(())
}
