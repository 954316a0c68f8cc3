//! Draws a plant: its oscillations with their sources and followers, loops that oscillate alone, and how all are archived.

use super::network::{Edge, Entry, Origin, Own, run};
use super::{CaseLoop, Difficulty, Role};
use crate::challenge::generator as one;
use crate::challenge::plant::{Drive, Plant};
use crate::challenge::valve::{Law, Packing, ValveSpec};
use crate::truth::draw::{Draw, std_dev};
use crate::truth::rig::{tune, turns, ultimate};
use crate::truth::storage;
use stiction::core::record::Record;
use stiction::core::sim::process::ProcessModel;
use stiction::core::units::ns_from_s;

/// Typical sampling times of archives, scans.
const SAMPLING: [usize; 7] = [1, 2, 5, 10, 15, 30, 60];
/// Scans before the start of the archive.
const BEFORE: usize = 2000;
/// Draws of one oscillating loop before it is left out.
const TRIES: usize = 12;
/// Longest window, periods.
const PERIODS: f64 = 20.0;

/// A loop during the drawing of its plant.
struct Part {
    plant: Plant,
    role: Role,
    group: Option<usize>,
    sticks: bool,
    period: f64,
    /// Amplitude of its PV, and noise and wander relative to it.
    pv: f64,
    noise: f64,
    wander: f64,
}

/// A plant while it is drawn.
struct Drawn {
    difficulty: Difficulty,
    scans: usize,
    parts: Vec<Part>,
    edges: Vec<Edge>,
    outside: Vec<Vec<f64>>,
    periods: Vec<f64>,
}

pub(super) fn plant(stream: &str, seed: u64, difficulty: Difficulty) -> Vec<CaseLoop> {
    for number in 0.. {
        let mut draw = Draw::new(seed, &format!("plant/{stream}/{}/{number}", difficulty.name()));
        if let Some(case) = attempt(&mut draw, difficulty) {
            return case;
        }
    }
    Vec::new()
}

fn attempt(draw: &mut Draw, difficulty: Difficulty) -> Option<Vec<CaseLoop>> {
    let hard = difficulty == Difficulty::Hard;
    let sizes: &[usize] = if hard { &[8, 8, 12, 12, 16] } else { &[8, 8, 12, 12, 16, 16, 20, 30, 60] };
    let size = draw.pick(sizes, 8);
    let mut drawn = Drawn {
        difficulty,
        scans: draw.pick(&[14_400, 21_600], 14_400),
        parts: Vec::new(),
        edges: Vec::new(),
        outside: Vec::new(),
        periods: Vec::new(),
    };
    for group in 0..draw.pick(&[1, 2], 1) {
        if drawn.parts.len() + 3 <= size {
            drawn.add_group(draw, group, size);
        }
    }
    while drawn.parts.len() < size {
        drawn.add_alone(draw)?;
    }
    drawn.archived(draw)
}

/// A loop whose sticking valve oscillates with about this period, scans, and the amplitude of its PV.
pub(super) fn sticking(draw: &mut Draw, wanted: f64, within: f64) -> Option<(Plant, f64, f64)> {
    for _ in 0..TRIES {
        let Some(plant) = one::plant(draw) else { continue };
        let [fs, _] = plant.valve.bench(1.0);
        let cycle = |plant: &Plant, scans: usize| {
            let mut kick = Drive::none(scans);
            kick.sp.fill(1.5 * fs * plant.process.gain);
            let run = plant.run(&kick);
            let late = scans / 3;
            (
                turns(&run.mv, 2e-3 * fs).1,
                std_dev(&run.pv[late..]),
                stiction::core::signal::stats::span(&run.mv[late..]),
            )
        };
        let (Some(period), ..) = cycle(&plant, 1_500) else { continue };
        let aimed = wanted * draw.between(1.0 - within, 1.0 + within);
        let plant = one::stretched(plant, period, aimed);
        let (Some(period), pv, travel) = cycle(&plant, (12.0 * aimed) as usize) else { continue };
        if (period / aimed - 1.0).abs() < within.max(0.03) && pv > 1e-3 && travel > 0.3 * fs {
            return Some((plant, period, pv));
        }
    }
    None
}

/// A healthy loop whose process takes about `slowness` scans, its controller tuned to `tight` of the gain at the stability
/// limit; also the period at that limit.
pub(super) fn healthy(draw: &mut Draw, slowness: f64, tight: f64) -> Option<(Plant, f64)> {
    let mut plant = one::plant(draw)?;
    let (tau, dead_time) = (slowness.max(3.0), (slowness * draw.between(0.08, 0.4)).max(1.0));
    let model = ProcessModel { gain: plant.process.gain, tau, tau2: 0.0, dead_time, integrating: false };
    let (kc, ti, td, _) = tune(draw, &model, tight)?;
    let (_, ringing) = ultimate(&model, ti, td)?;
    (plant.process.tau, plant.process.dead_time) = (tau, dead_time);
    (plant.controller.kc, plant.controller.ti_s, plant.controller.td_s) = (kc, ti, td);
    plant.valve = ValveSpec { law: Law::He([[0.0; 2]; 2]), ..ValveSpec::plain(NO_PACKING) };
    plant.strain = 0.0;
    Some((plant, ringing))
}

/// Packing of a valve that follows its signal.
const NO_PACKING: Packing = Packing { fs: 1e-4, fc: 1e-5, vs: 1.0, fv: 1e-3 };

impl Drawn {
    fn is_hard(&self) -> bool {
        self.difficulty == Difficulty::Hard
    }

    fn period(&self, draw: &mut Draw) -> f64 {
        draw.log_between(100.0, self.scans as f64 / 12.0)
    }

    /// An oscillation with its source (one in three is external) and 1 to 8 followers, in a chain or in parallel.
    fn add_group(&mut self, draw: &mut Draw, group: usize, size: usize) {
        let hard = self.is_hard();
        let mut period = self.period(draw);
        let outside = draw.chance(0.3);
        let room = size.saturating_sub(self.parts.len() + 2);
        let followers = (1 + draw.pick(&[0, 1, 2, 3, 4, 5, 6, 7], 0)).min(room).max(1 + usize::from(outside));
        let source = self.parts.len();
        // The output of each member: its origin, and the amplitude of its oscillation, as PV and as flow.
        let mut senders: Vec<(Origin, f64)> = Vec::new();
        if outside {
            self.outside.push(load(draw, period, self.scans, hard));
            senders.push((Origin::Outside(self.outside.len() - 1), 1.0));
        } else {
            let Some((plant, found, pv)) = sticking(draw, period, 0.15) else { return };
            period = found;
            senders.push((Origin::Pv(source), 1.4 * pv));
            senders.push((Origin::Flow(source), 1.4 * pv / plant.process.gain.abs()));
            self.parts.push(Part {
                role: Role::Source,
                group: Some(group),
                sticks: true,
                period,
                pv: 1.4 * pv,
                noise: draw.between(0.02, 0.15),
                wander: draw.between(0.0, 0.3),
                plant,
            });
        }
        let first = senders.len();
        for number in 0..followers {
            let share = draw.log_between(0.02, if hard { 1.0 } else { 0.25 });
            let tight = draw.between(0.15, 0.45);
            let Some((mut plant, _)) = healthy(draw, period * share, tight) else { continue };
            let size = draw.between(0.6, 4.0);
            let sticks = draw.chance(0.08);
            if sticks {
                let fs = size * draw.between(0.1, 0.4);
                let pace = 4.0 * size / period;
                plant.valve =
                    ValveSpec::plain(Packing { fs, fc: fs * draw.between(0.1, 0.7), vs: 3.0 * pace, fv: 0.01 });
            }
            let direct = number == 0 || draw.chance(0.6);
            let (from, amplitude) =
                if direct { draw.pick(&senders[..first], senders[0]) } else { draw.pick(&senders, senders[0]) };
            let input = draw.chance(0.7);
            let to = self.parts.len();
            let gain = plant.process.gain.abs();
            let at_pv = size * gain * 0.7;
            self.edges.push(Edge {
                from,
                to,
                into: if input { Entry::Input } else { Entry::Pv },
                gain: draw.sign() * size / amplitude * if input { 1.0 } else { gain },
                lag: period * if hard { draw.log_between(0.001, 0.06) } else { draw.log_between(0.005, 0.15) },
                dead_time: (period * draw.between(0.0, 0.2)) as usize,
            });
            senders.push((Origin::Pv(to), at_pv));
            self.parts.push(Part {
                role: if outside { Role::Driven } else { Role::Follower },
                group: Some(group),
                sticks,
                period,
                pv: at_pv,
                noise: if hard { draw.log_between(0.003, 0.1) } else { draw.between(0.03, 0.3) },
                wander: draw.between(0.0, 0.3),
                plant,
            });
        }
        let last = self.parts.len() - 1;
        if !outside && last > source + 1 && draw.chance(0.25) {
            // Recycle: the last follower acts back on the source, weakly.
            self.edges.push(Edge {
                from: Origin::Pv(last),
                to: source,
                into: Entry::Input,
                gain: draw.sign() * 0.15 * self.parts[source].pv
                    / self.parts[source].plant.process.gain.abs()
                    / self.parts[last].pv,
                lag: 0.05 * period,
                dead_time: (period * draw.between(0.0, 0.2)) as usize,
            });
        }
        self.periods.push(period);
    }

    /// A loop that no other drives: calm, sticking or tuned too tight, often with nearly a group's period.
    fn add_alone(&mut self, draw: &mut Draw) -> Option<()> {
        let near = !self.periods.is_empty() && draw.chance(0.7);
        let wanted = if near { draw.pick(&self.periods, 300.0) } else { self.period(draw) };
        let within = draw.pick(&[0.01, 0.1], 0.1);
        let role = draw.pick(&[Role::Calm, Role::Calm, Role::Sticking, Role::Sticking, Role::Tight], Role::Calm);
        let (plant, period, pv, noise) = match role {
            Role::Sticking => {
                let (plant, period, pv) = sticking(draw, wanted, within)?;
                (plant, period, 1.4 * pv, draw.between(0.02, 0.15))
            }
            Role::Tight => {
                let tight = draw.between(0.9, 0.985);
                let (plant, ringing) = healthy(draw, wanted / 6.0, tight)?;
                let plant = one::stretched(plant, ringing, wanted * draw.between(1.0 - within, 1.0 + within));
                (plant, wanted, 1.0, 0.1)
            }
            _ => {
                let slowness = wanted * draw.between(0.02, 0.2);
                let tight = draw.between(0.15, 0.45);
                let (plant, _) = healthy(draw, slowness, tight)?;
                let pv = plant.process.gain.abs() * draw.between(0.3, 2.0);
                (plant, wanted, pv, 0.3)
            }
        };
        let sticks = role == Role::Sticking;
        self.parts.push(Part { plant, role, group: None, sticks, period, pv, noise, wander: draw.between(0.0, 0.3) });
        Some(())
    }

    /// Runs the plant and archives the end of every loop's signals.
    fn archived(self, draw: &mut Draw) -> Option<Vec<CaseLoop>> {
        let own: Vec<Own> = self.parts.iter().map(|part| self.own(part, draw)).collect();
        let plants: Vec<Plant> = self.parts.iter().map(|part| part.plant.clone()).collect();
        let runs = run(&plants, &own, &self.edges, &self.outside);
        let sane = |[op, pv]: &[Vec<f64>; 2]| {
            pv.iter().all(|y| y.is_finite()) && op[BEFORE..].iter().all(|u| (0.5..99.5).contains(u))
        };
        if !runs.iter().all(sane) {
            return None;
        }
        let periods = if self.is_hard() { draw.log_between(6.0, PERIODS) } else { PERIODS };
        let archive = |(number, (part, run)): (usize, (&Part, [Vec<f64>; 2]))| CaseLoop {
            name: format!("L{number:02}"),
            record: self.record(part, run, periods, draw),
            role: part.role,
            group: part.group,
            sticks: part.sticks,
        };
        Some(self.parts.iter().zip(runs).enumerate().map(archive).collect())
    }

    fn own(&self, part: &Part, draw: &mut Draw) -> Own {
        let oscillates = matches!(part.role, Role::Source | Role::Sticking);
        let [fs, _] = if oscillates { part.plant.valve.bench(1.0) } else { [0.0; 2] };
        let step = part.wander * part.pv / part.plant.process.gain.abs() / (20.0 * part.period).sqrt();
        let mut load = 0.0;
        Own {
            sp: 1.5 * fs * part.plant.process.gain,
            load: (0..self.scans)
                .map(|_| {
                    load += step * draw.gaussian();
                    load
                })
                .collect(),
            noise: (0..self.scans).map(|_| part.noise * part.pv * draw.gaussian()).collect(),
        }
    }

    fn record(&self, part: &Part, [op, pv]: [Vec<f64>; 2], periods: f64, draw: &mut Draw) -> Record {
        let fitting: Vec<usize> =
            SAMPLING.into_iter().filter(|ts| (25.0..=200.0).contains(&(part.period / *ts as f64))).collect();
        let ts = draw.pick(&fitting, ((part.period / 40.0) as usize).max(1));
        let start = BEFORE.max((self.scans as f64 - periods * part.period).max(0.0) as usize);
        let from = start + (draw.between(0.0, ts as f64) as usize).min(ts - 1);
        let thin = |x: &[f64]| -> Vec<f64> { x[from..].iter().step_by(ts).copied().collect() };
        let (mut op, mut pv) = (thin(&op), thin(&pv));
        if self.is_hard() && draw.chance(0.4) {
            let round = draw.chance(0.5);
            let shares = [draw.between(0.03, 0.15), draw.between(0.05, 0.35)];
            for (x, share) in [&mut op, &mut pv].into_iter().zip(shares) {
                let band = share * std_dev(x);
                if round { storage::rounded(x, band) } else { storage::exception_hold(x, band) }
            }
        }
        let mut record = Record::uniform(ts as f64, op, pv);
        let shift = ns_from_s(from as f64);
        (record.start_ns, record.end_ns) = (record.start_ns + shift, record.end_ns + shift);
        record.sp = Some(vec![part.plant.rest_pv; record.pv.len()]);
        record
    }
}

/// An external load of size 1 whose phase wanders slightly.
fn load(draw: &mut Draw, period: f64, scans: usize, hard: bool) -> Vec<f64> {
    let shape = draw.between(0.0, 1.0);
    let [sines, squares] = if hard { [0.2, 0.55] } else { [0.5, 0.8] };
    let jitter = draw.pick(&[0.0, 0.02, 0.05], 0.0);
    let mut cycles = draw.between(0.0, 1.0);
    let mut pace = 1.0;
    (0..scans)
        .map(|k| {
            if k % (period as usize).max(1) == 0 {
                pace = 1.0 + jitter * draw.gaussian();
            }
            cycles += pace / period;
            let at = cycles - cycles.floor();
            match shape {
                s if s < sines => libm::sin(2.0 * core::f64::consts::PI * at),
                s if s < squares => {
                    if at < 0.5 {
                        1.0
                    } else {
                        -1.0
                    }
                }
                _ => 4.0 * (at - 0.5).abs() - 1.0,
            }
        })
        .collect()
}
