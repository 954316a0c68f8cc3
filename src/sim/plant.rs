//! A simulated plant: the loops of a [`Scenario`], their scans, and what recording and transport do to the values.

use std::collections::VecDeque;

use super::closed_loop::{ClosedLoop, Scan};
use super::noise::{Noise, quantise, stream_of};
use super::scenario::{LoopSpec, Scenario};
use crate::record::{Mode, Record, Sample, Signal, Value};
use crate::units::ns_from_s;

/// Streams of randomness beside the simulated loop's own.
const EFFECTS_STREAM: u64 = u64::MAX;

/// A value of a simulated plant as it arrives.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SimulatedSample {
    /// Which loop, counted as in the scenario.
    pub loop_index: usize,
    /// When it arrives, ns since 1970: the true time of the scan that it arrives with. Never falls along a stream.
    pub arrival_ns: i64,
    /// The value with its stamp.
    pub sample: Sample,
}

/// A value that is under way.
#[derive(Debug, Clone, Copy)]
struct Delayed {
    due_scan: u64,
    loop_index: usize,
    sample: Sample,
}

/// The loops of a scenario with their memory; each [`SimulatedPlant::step`] is one scan of all of them.
#[derive(Debug, Clone)]
pub struct SimulatedPlant {
    loops: Vec<PlantLoop>,
    start_ns: i64,
    ts_ns: i64,
    ts_s: f64,
    scan: u64,
    delayed: Vec<Delayed>,
}

#[derive(Debug, Clone)]
struct PlantLoop {
    spec: LoopSpec,
    closed: ClosedLoop,
    effects: Noise,
}

impl PlantLoop {
    fn new(spec: &LoopSpec, scenario: &Scenario) -> Self {
        let run = &scenario.run;
        // A loop's randomness hangs on its name, so loops can be added and re-ordered.
        let seed = run.seed ^ stream_of(&spec.name);
        let warmup = (run.warmup_s / run.ts_s).round();
        let start_s = -warmup * run.ts_s;
        let mut closed = ClosedLoop::new(spec.model(run.ts_s), start_s, spec.setpoint.at(start_s), seed);
        for _ in 0..warmup as u64 {
            let sp = spec.setpoint.at(closed.time_s());
            closed.step(sp);
        }
        Self { spec: spec.clone(), closed, effects: Noise::new(seed, EFFECTS_STREAM) }
    }

    /// The next scan, with the mode that the scenario asks for at that time.
    fn step(&mut self) -> Scan {
        let t_s = self.closed.time_s();
        let within = |from_s: f64, for_s: f64| t_s >= from_s && t_s < from_s + for_s;
        match self.spec.manual.iter().find(|hand| within(hand.from_s, hand.for_s)) {
            Some(hand) => self.closed.set_manual(hand.op),
            None => self.closed.set_auto(),
        }
        let mut scan = self.closed.step(self.spec.setpoint.at(t_s));
        let recording = &self.spec.recording;
        scan.op = quantise(scan.op, recording.op_quantum);
        scan.mv = quantise(scan.mv, recording.op_quantum);
        scan.pv = quantise(scan.pv, recording.pv_quantum);
        scan
    }

    /// Jump of the stamping clock at `t_s`, ns.
    fn clock_error_ns(&self, t_s: f64) -> i64 {
        self.spec.recording.clock_jumps.iter().filter(|jump| jump.at_s <= t_s).map(|jump| ns_from_s(jump.by_s)).sum()
    }

    fn in_gap(&self, t_s: f64) -> bool {
        self.spec.recording.gaps.iter().any(|gap| t_s >= gap.from_s && t_s < gap.from_s + gap.for_s)
    }
}

impl SimulatedPlant {
    /// The plant of a scenario, warmed up, before its first recorded scan.
    #[must_use]
    pub fn new(scenario: &Scenario) -> Self {
        Self::starting_at(scenario, scenario.start_ns())
    }

    /// The same plant with its first scan stamped `start_ns`, for a plant that lives now.
    #[must_use]
    pub fn starting_at(scenario: &Scenario, start_ns: i64) -> Self {
        Self {
            loops: scenario.loops.iter().map(|spec| PlantLoop::new(spec, scenario)).collect(),
            start_ns,
            ts_ns: ns_from_s(scenario.run.ts_s),
            ts_s: scenario.run.ts_s,
            scan: 0,
            delayed: Vec::new(),
        }
    }

    /// True time of the next scan, ns since 1970.
    #[must_use]
    pub fn next_scan_ns(&self) -> i64 {
        self.time_ns(self.scan)
    }

    fn time_ns(&self, scan: u64) -> i64 {
        let passed = i64::try_from(scan).unwrap_or(i64::MAX).saturating_mul(self.ts_ns);
        self.start_ns.saturating_add(passed)
    }

    /// The next scan of every loop: what arrives with it, in order. It never ends; a scenario's duration bounds
    /// [`Scenario::stream`] only.
    pub fn step(&mut self) -> Vec<SimulatedSample> {
        let mut out = Vec::with_capacity(self.loops.len() * Signal::ALL.len());
        let arrival_ns = self.next_scan_ns();
        let now = self.scan;
        for (loop_index, plant_loop) in self.loops.iter_mut().enumerate() {
            let t_s = plant_loop.closed.time_s();
            let scan = plant_loop.step();
            let t_ns = arrival_ns.saturating_add(plant_loop.clock_error_ns(t_s));
            let silent = plant_loop.in_gap(t_s);
            for signal in Signal::ALL {
                if !plant_loop.spec.recording.signals.contains(&signal) {
                    continue;
                }
                let sample = Sample { signal, t_ns, value: value_of(signal, &scan), quality: None };
                let fate = Fate::draw(plant_loop, self.ts_s);
                if silent || fate.lost {
                    continue;
                }
                let sample = if fate.missing { Sample { value: Value::Missing, ..sample } } else { sample };
                if fate.delay_scans == 0 {
                    out.push(SimulatedSample { loop_index, arrival_ns, sample });
                } else {
                    self.delayed.push(Delayed { due_scan: now + fate.delay_scans, loop_index, sample });
                }
                if fate.twice {
                    self.delayed.push(Delayed { due_scan: now + fate.delay_scans + 1, loop_index, sample });
                }
            }
        }
        self.release(now, arrival_ns, &mut out);
        self.scan += 1;
        out
    }

    /// Values that are still under way after the last scan, in order of arrival. The plant does not move.
    pub fn rest(&mut self) -> Vec<SimulatedSample> {
        let mut out = Vec::with_capacity(self.delayed.len());
        while let Some(due) = self.delayed.iter().map(|d| d.due_scan).min() {
            self.release(due, self.time_ns(due), &mut out);
        }
        out
    }

    /// Hands over what is due, behind the values of its scan, in the order in which it was sent.
    fn release(&mut self, scan: u64, arrival_ns: i64, out: &mut Vec<SimulatedSample>) {
        self.delayed.retain(|d| {
            let due = d.due_scan <= scan;
            if due {
                out.push(SimulatedSample { loop_index: d.loop_index, arrival_ns, sample: d.sample });
            }
            !due
        });
    }
}

fn value_of(signal: Signal, scan: &Scan) -> Value {
    match signal {
        Signal::Op => Value::number(scan.op),
        Signal::Sp => Value::number(scan.sp),
        Signal::Mode => Value::Mode(if scan.manual { Mode::Manual } else { Mode::Auto }),
        Signal::Mv => Value::number(scan.mv),
        Signal::Pv => Value::number(scan.pv),
    }
}

/// What becomes of one value on its way.
struct Fate {
    lost: bool,
    missing: bool,
    twice: bool,
    delay_scans: u64,
}

impl Fate {
    /// Always the same number of draws, so that a changed probability leaves the other fates alone.
    fn draw(plant_loop: &mut PlantLoop, ts_s: f64) -> Self {
        let PlantLoop { spec, effects, .. } = plant_loop;
        let recording = &spec.recording;
        let scans = |delay_s: f64| ((delay_s / ts_s).round() as u64).max(1);
        let lost = effects.chance(recording.lost_p);
        let missing = effects.chance(recording.missing_p);
        let twice = effects.chance(recording.duplicate_p);
        let late = effects.chance(recording.late_p);
        let out_of_order = effects.chance(recording.out_of_order_p);
        let behind = 1 + effects.below(scans(recording.out_of_order_s));
        let delay_scans = match (late, out_of_order) {
            (true, _) => scans(recording.late_s),
            (false, true) => behind,
            (false, false) => 0,
        };
        Self { lost, missing, twice, delay_scans }
    }
}

impl Scenario {
    /// Every value of the recording in order of arrival; the same for the same scenario, to the last bit.
    pub fn stream(&self) -> impl Iterator<Item = SimulatedSample> + use<> {
        let mut plant = SimulatedPlant::new(self);
        let mut scans_left = self.scans();
        let mut ready = VecDeque::new();
        core::iter::from_fn(move || {
            while ready.is_empty() && scans_left > 0 {
                scans_left -= 1;
                ready.extend(plant.step());
                if scans_left == 0 {
                    ready.extend(plant.rest());
                }
            }
            ready.pop_front()
        })
    }

    /// One loop's recording without losses and delays (but quantised) as a [`Record`] with set point and valve
    /// position; `None` where there is no such loop.
    #[must_use]
    pub fn record(&self, loop_index: usize) -> Option<Record> {
        let mut plant_loop = PlantLoop::new(self.loops.get(loop_index)?, self);
        let scans: Vec<Scan> = (0..self.scans()).map(|_| plant_loop.step()).collect();
        let column = |pick: fn(&Scan) -> f64| -> Vec<f64> { scans.iter().map(pick).collect() };
        let mut record = Record::uniform(self.run.ts_s, column(|s| s.op), column(|s| s.pv));
        record.start_ns += self.start_ns();
        record.end_ns += self.start_ns();
        record.sp = Some(column(|s| s.sp));
        record.mv = Some(column(|s| s.mv));
        record.facts.manual = scans.iter().filter(|s| s.manual).count() as u32;
        Some(record)
    }
}
