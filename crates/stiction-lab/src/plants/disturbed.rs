//! One loop with a neighbour that acts on it or follows it, and unrelated loops of nearly the same period.

use super::generator::{healthy, sticking};
use super::network::{Edge, Entry, Origin, Own, run};
use crate::challenge::plant::Plant;
use crate::truth::draw::{Draw, std_dev};
use stiction::core::record::Record;
use stiction::core::units::ns_from_s;

/// Scans before the start of the records.
const BEFORE: usize = 800;
/// Draws of a loop before another case is drawn.
const TRIES: usize = 40;

/// Relation of the other loop to this one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Relation {
    /// Its PV or flow acts on this loop.
    Acts,
    /// This loop's PV or flow acts on it.
    Follows,
}

/// A pair of loops and their relation.
#[derive(Debug, Clone, PartialEq)]
pub struct Disturbed {
    /// The diagnosed loop.
    pub record: Record,
    /// The other loop.
    pub other: Record,
    /// Periods of both, s.
    pub periods_s: [f64; 2],
    /// First-order lag and dead time between them, s.
    pub lag_s: f64,
    /// See `lag_s`.
    pub dead_time_s: f64,
    /// Whether the diagnosed loop's own valve sticks.
    pub sticks: bool,
    /// Standard deviation of the noise on its PV, PV units.
    pub noise_sd: f64,
}

/// A loop with its period, the amplitude of its PV, and its set point.
struct Part {
    plant: Plant,
    period: f64,
    pv: f64,
    sp: f64,
}

/// A loop whose sticking valve cycles with about this period, scans.
fn cycling(draw: &mut Draw, wanted: f64, within: f64) -> Option<Part> {
    let (plant, period, pv) = sticking(draw, wanted, within)?;
    let [fs, _] = plant.valve.bench(1.0);
    let sp = 1.5 * fs * plant.process.gain;
    Some(Part { plant, period, pv, sp })
}

impl Part {
    /// Noise and a wandering load, each relative to the loop's amplitude.
    fn own(&self, scans: usize, noise: f64, wander: f64, draw: &mut Draw) -> Own {
        let step = wander * self.pv / self.plant.process.gain.abs() / (20.0 * self.period).sqrt();
        let mut load = 0.0;
        let mut walk = || {
            load += step * draw.gaussian();
            load
        };
        let load = (0..scans).map(|_| walk()).collect();
        Own { sp: self.sp, load, noise: (0..scans).map(|_| noise * self.pv * draw.gaussian()).collect() }
    }
}

/// Every `every`-th scan from a start on, as a record with `scan_s` seconds per scan.
fn recorded([op, pv]: &[Vec<f64>; 2], rest_pv: f64, scan_s: f64, every: usize, offset: usize) -> Record {
    let from = BEFORE + offset;
    let thin = |x: &[f64]| -> Vec<f64> { x[from..].iter().step_by(every).copied().collect() };
    let mut record = Record::uniform(scan_s * every as f64, thin(op), thin(pv));
    let shift = ns_from_s(from as f64 * scan_s);
    (record.start_ns, record.end_ns) = (record.start_ns + shift, record.end_ns + shift);
    record.sp = Some(vec![rest_pv; record.pv.len()]);
    record
}

/// Seconds per scan, and scans of a case.
fn timing(draw: &mut Draw, period: f64) -> (f64, usize) {
    let scan_s = draw.pick(&[1.0, 2.0, 5.0], 1.0);
    let n = (period * draw.log_between(8.0, 20.0)).clamp(700.0, 1_900.0);
    (scan_s, BEFORE + n as usize)
}

/// The case of a stream, seed and number, bit-identical on every machine.
#[must_use]
pub fn disturbed(stream: &str, seed: u64, number: u64, relation: Relation) -> Disturbed {
    let mut attempt = 0_u64;
    loop {
        let mut draw = Draw::new(seed, &format!("disturbed/{stream}/{relation:?}/{number}/{attempt}"));
        if let Some(case) = attempted(&mut draw, relation) {
            return case;
        }
        attempt += 1;
    }
}

fn attempted(draw: &mut Draw, relation: Relation) -> Option<Disturbed> {
    let wanted = draw.log_between(65.0, 180.0);
    let sticks = relation == Relation::Follows || draw.chance(0.5);
    // The acting loop cycles by its valve; the loop that it acts on may do so, too, with its own period.
    let source = cycling(draw, wanted, 0.15)?;
    let share = draw.pick(&[0.9, 0.97, 1.03, 1.1, 0.6, 1.6], 1.0);
    let target = if relation == Relation::Acts && sticks {
        cycling(draw, wanted * share, 0.05)?
    } else {
        let slowness = source.period * draw.log_between(0.05, 0.4);
        let tight = draw.between(0.15, 0.45);
        let (plant, _) = healthy(draw, slowness, tight)?;
        let pv = plant.process.gain.abs() * draw.between(0.6, 4.0);
        Part { plant, period: source.period, pv, sp: 0.0 }
    };
    let (scan_s, scans) = timing(draw, source.period.max(target.period));
    let from_pv = draw.chance(0.6);
    let into = if draw.chance(0.6) { Entry::Input } else { Entry::Pv };
    let gain = target.plant.process.gain.abs();
    let amplitude = if from_pv { source.pv } else { source.pv / source.plant.process.gain.abs() };
    let size = target.pv * if sticks { draw.log_between(0.3, 1.2) } else { 1.0 };
    let edge = Edge {
        from: if from_pv { Origin::Pv(0) } else { Origin::Flow(0) },
        to: 1,
        into,
        gain: draw.sign() * size / amplitude / if into == Entry::Input { gain } else { 1.0 },
        lag: source.period * draw.log_between(0.01, 0.2),
        dead_time: (source.period * draw.between(0.0, 0.2)) as usize,
    };
    // Nothing else acts on the diagnosed loop.
    let (me, other) = if relation == Relation::Acts { (1, 0) } else { (0, 1) };
    let mut own = [Own::default(), Own::default()];
    for (k, part) in [&source, &target].into_iter().enumerate() {
        let (noise, wander) = (draw.log_between(0.01, 0.1), draw.between(0.0, 0.3));
        own[k] = part.own(scans, noise, if k == me { 0.0 } else { wander }, draw);
    }
    let plants = [source.plant.clone(), target.plant.clone()];
    let runs = run(&plants, &own, &[edge], &[]);
    let sane = runs
        .iter()
        .all(|[op, pv]| pv.iter().all(|y| y.is_finite()) && op[BEFORE..].iter().all(|u| (0.5..99.5).contains(u)));
    if !sane {
        return None;
    }
    let every = draw.pick(&[1, 2, 4], 1);
    let offset = draw.pick(&[0, 1], 0);
    let parts = [&source, &target];
    let rest = |k: usize| plants[k].rest_pv;
    Some(Disturbed {
        record: recorded(&runs[me], rest(me), scan_s, 1, 4),
        other: recorded(&runs[other], rest(other), scan_s, every, offset),
        periods_s: [parts[me].period * scan_s, parts[other].period * scan_s],
        lag_s: edge.lag * scan_s,
        dead_time_s: edge.dead_time as f64 * scan_s,
        sticks,
        noise_sd: std_dev(&own[me].noise),
    })
}

/// Loops unrelated to `like`, recorded over the same time: each cycles by its own valve, with a period that differs by 1 to 10
/// % from one of `periods_s`.
#[must_use]
pub fn unrelated_loops(seed: u64, number: u64, count: usize, like: &Record, periods_s: &[f64]) -> Vec<Record> {
    let scan_s = like.ts_s;
    let duration = (like.end_ns - like.start_ns) as f64 * 1e-9;
    let mut draw = Draw::new(seed, &format!("strangers/{number}"));
    let mut out = Vec::new();
    for _ in 0..TRIES * count {
        if out.len() == count {
            break;
        }
        let period_s = draw.pick(periods_s, 100.0 * scan_s);
        let within = draw.pick(&[0.01, 0.03, 0.1], 0.1);
        let Some(part) = cycling(&mut draw, period_s / scan_s, within) else { continue };
        let scans = BEFORE + 8 + (duration / scan_s) as usize;
        let (noise, wander) = (draw.log_between(0.01, 0.1), draw.between(0.0, 0.3));
        let own = part.own(scans, noise, wander, &mut draw);
        let runs = run(core::slice::from_ref(&part.plant), &[own], &[], &[]);
        let Some(run) = runs.first().filter(|[_, pv]| pv.iter().all(|y| y.is_finite())) else { continue };
        let every = draw.pick(&[1, 2, 4], 1);
        let mut record = recorded(run, part.plant.rest_pv, scan_s, every, draw.pick(&[0, 1, 2], 0));
        let shift = like.start_ns - ns_from_s((BEFORE + 4) as f64 * scan_s);
        (record.start_ns, record.end_ns) = (record.start_ns + shift, record.end_ns + shift);
        out.push(record);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use stiction::core::gap::Neighbour;

    #[test]
    fn a_case_is_repeated_by_its_seed_and_its_others_share_its_time() {
        let case = disturbed("A", 1, 0, Relation::Acts);
        assert_eq!(case, disturbed("A", 1, 0, Relation::Acts));
        assert_ne!(case, disturbed("A", 1, 1, Relation::Acts));
        let others = unrelated_loops(1, 0, 3, &case.record, &case.periods_s);
        assert_eq!(others.len(), 3);
        for other in others.iter().chain([&case.other]) {
            let on_grid = Neighbour::of("other", other, &case.record).unwrap();
            assert_eq!(on_grid.pv.len(), case.record.len());
        }
    }
}
