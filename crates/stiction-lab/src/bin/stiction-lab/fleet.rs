//! `stiction-lab fleet`: how long comparing the loops of a plant takes.

use serde_json::json;

use stiction::plantwide::{PlantLoop, assess_plant};
use stiction_lab::plants::{FleetLoop, fleet};
use stictiond::cli::{Format, Outcome, cpu, say};

/// Numbers of loops.
const LOOPS: [usize; 3] = [1_000, 10_000, 100_000];

/// Prints the results for each number of loops as soon as they are available.
///
/// # Errors
/// Stdout is closed.
pub fn run(format: Format) -> anyhow::Result<Outcome> {
    for count in LOOPS {
        let loops = fleet(count);
        let plant: Vec<PlantLoop> = loops.iter().map(FleetLoop::of_plant).collect();
        let started = cpu::seconds();
        let groups = assess_plant(&plant);
        let took_s = cpu::seconds() - started;
        let pairs = groups.first().map_or(0, |group| group.pairs_compared);
        match format {
            Format::Json => say(json!({"schema": "stictiond.fleet.v1", "loops": count, "cpu_s": took_s,
                "pairs_of_nearly_one_period": pairs, "groups": groups.len()}))?,
            Format::Text => say(format!(
                "comparison of {count} loops: {took_s:.2} s of one core, {pairs} pairs of nearly one period, {} groups",
                groups.len()
            ))?,
        }
    }
    Ok(Outcome::Done)
}
