//! How long the loops of a plant take to compare.

use super::{Row, cpu};
use stiction::plantwide::{PlantLoop, assess_plant};
use stiction_lab::plants::{FleetLoop, fleet};

/// Numbers of loops.
const LOOPS: [usize; 3] = [1_000, 10_000, 100_000];

/// The rows of each number of loops, as soon as they are there.
///
/// # Errors
/// Those of `print`.
pub fn rows(print: impl Fn(Vec<Row>) -> anyhow::Result<()>) -> anyhow::Result<()> {
    for count in LOOPS {
        let loops = fleet(count);
        let plant: Vec<PlantLoop> = loops.iter().map(FleetLoop::of_plant).collect();
        let started = cpu::seconds();
        let groups = assess_plant(&plant);
        let took_s = cpu::seconds() - started;
        let pairs = groups.first().map_or(0, |group| group.pairs_compared);
        print(vec![
            Row { name: format!("comparison of {count} loops"), value: took_s, unit: "s" },
            Row { name: "  pairs of nearly one period".into(), value: pairs as f64, unit: "pairs" },
            Row { name: "  groups found".into(), value: groups.len() as f64, unit: "groups" },
        ])?;
    }
    Ok(())
}
