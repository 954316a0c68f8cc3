//! Many loops at once, for timing: loops of a few plants at several speeds, among calm ones.

use std::sync::Arc;

use super::{Difficulty, plant, stretched};
use crate::truth::draw::Draw;
use stiction::core::record::Record;
use stiction::core::signal::stats::span;
use stiction::core::verdict::{Assessment, Oscillation, Window};
use stiction::plantwide::{PlantLoop, frequency_hz};

/// Number of plants drawn of either difficulty.
const PLANTS: u64 = 12;
/// Factors on the periods of a plant's fastest and slowest copy.
const SPEEDS: [f64; 2] = [0.25, 4.0];
/// One in this many loops oscillates.
const OSCILLATING: usize = 5;
/// Points of a calm loop.
const CALM_POINTS: usize = 600;
/// End of all windows, ns.
const END_NS: i64 = 1_000_000_000_000_000;

/// A loop with a made-up assessment, which does not affect the time of a comparison.
#[derive(Debug, Clone)]
pub struct FleetLoop {
    /// The loop's name.
    pub name: String,
    /// The loop's window.
    pub record: Arc<Record>,
    /// The made-up assessment.
    pub assessment: Assessment,
}

impl FleetLoop {
    /// The loop as input of the comparison.
    #[must_use]
    pub fn of_plant(&self) -> PlantLoop<'_> {
        PlantLoop { name: &self.name, record: &self.record, assessment: &self.assessment, area: None, upstream: &[] }
    }
}

/// This many loops, one in five of which oscillates; the same loops in every call.
#[must_use]
pub fn fleet(loops: usize) -> Vec<FleetLoop> {
    let wanted = loops / OSCILLATING;
    let seeds = (1..=PLANTS).flat_map(|seed| Difficulty::ALL.map(|difficulty| plant("fleet", seed, difficulty)));
    let plants: Vec<_> = seeds.collect();
    let mut draw = Draw::new(1, "fleet");
    let mut all = Vec::new();
    for copy in 0.. {
        let case = &plants[copy % plants.len()];
        let by = draw.log_between(SPEEDS[0], SPEEDS[1]);
        let end_ns = case.iter().map(|l| l.record.end_ns).max().unwrap_or(0);
        for l in case.iter().filter(|l| frequency_hz(&l.record).is_some()) {
            if all.len() == wanted {
                let calm = Arc::new(calm(&mut draw));
                all.extend((wanted..loops).map(|k| judged(format!("C{k}"), Arc::clone(&calm), false)));
                return all;
            }
            let late_ns = ((end_ns - l.record.end_ns) as f64 * by) as i64;
            let record = stretched(&l.record, by, END_NS - late_ns);
            all.push(judged(format!("P{copy}{}", l.name), Arc::new(record), l.sticks));
        }
    }
    all
}

fn calm(draw: &mut Draw) -> Record {
    let mut noise = || (0..CALM_POINTS).map(|_| 50.0 + draw.gaussian()).collect::<Vec<f64>>();
    let (op, pv) = (noise(), noise());
    Record::uniform(10.0, op, pv)
}

fn judged(name: String, record: Arc<Record>, sticks: bool) -> FleetLoop {
    let nothing =
        Oscillation { oscillating: false, period_s: None, periods: None, samples_per_period: None, regularity: None };
    let band = 0.3 * span(&record.op_path);
    let assessment = Assessment {
        p_calibrated: Some(if sticks { 0.9 } else { 0.1 }),
        stiction: Some(sticks),
        fs: Some(band),
        fd: Some(0.5 * band),
        ..Assessment::empty(Window::of(&record), nothing)
    };
    FleetLoop { name, record, assessment }
}
