//! A simulated plant: the loops of a [`Scenario`], their scans, and the effects of recording and transport on the values.

use std::collections::VecDeque;

use super::scenario::{LoopSpec, Scenario};
use crate::core::record::{Mode, Record, Sample, Signal, Value};
use crate::core::sim::closed_loop::{ClosedLoop, Scan};
use crate::core::sim::noise::{Noise, quantise, stream_of};
use crate::core::units::ns_from_s;

/// Random streams in addition to the simulated loop's own.
const EFFECTS_STREAM: u64 = u64::MAX;

/// A value of a simulated plant at its arrival.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SimulatedSample {
    /// Index of its loop in the scenario.
    pub loop_index: usize,
    /// Arrival time, ns since 1970: the true time of the scan with which it arrives. Never decreases along a stream.
    pub arrival_ns: i64,
    /// The value with its timestamp.
    pub sample: Sample,
}

/// A value in transit.
#[derive(Debug, Clone, Copy)]
struct Delayed {
    due_scan: u64,
    loop_index: usize,
    sample: Sample,
}

/// The loops of a scenario with their state; [`SimulatedPlant::step`] makes one scan of all of them.
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
        // A loop's randomness depends on its name, so loops can be added and re-ordered.
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

    /// The next scan, with the mode given by the scenario for that time.
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

    /// Jump of the timestamp clock at `t_s`, ns.
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

    /// The same plant with its first scan at `start_ns`, for a live plant.
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
    pub(crate) fn next_scan_ns(&self) -> i64 {
        self.time_ns(self.scan)
    }

    fn time_ns(&self, scan: u64) -> i64 {
        let passed = i64::try_from(scan).unwrap_or(i64::MAX).saturating_mul(self.ts_ns);
        self.start_ns.saturating_add(passed)
    }

    /// The next scan of every loop: the values that arrive with it, in order. It never ends; a scenario's duration limits only
    /// [`Scenario::stream`].
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

    /// Values still in transit after the last scan, in order of arrival. The plant does not advance.
    pub fn rest(&mut self) -> Vec<SimulatedSample> {
        let mut out = Vec::with_capacity(self.delayed.len());
        while let Some(due) = self.delayed.iter().map(|d| d.due_scan).min() {
            self.release(due, self.time_ns(due), &mut out);
        }
        out
    }

    /// Outputs due values after those of their scan, in order of sending.
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

/// The effect of transport on one value.
struct Fate {
    lost: bool,
    missing: bool,
    twice: bool,
    delay_scans: u64,
}

impl Fate {
    /// Always the same number of draws, so that changing one probability does not affect the others.
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
    /// Every value of the recording in order of arrival; bit-identical for the same scenario.
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

    /// One loop's recording without losses and delays (but quantised) as a [`Record`] with set point and valve position; `None`
    /// if there is no such loop.
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

#[cfg(test)]
mod tests {
    use super::*;

    const SCENARIOS: [(&str, &str); 4] = [
        ("demo", include_str!("../../../../recordings/scenarios/demo.toml")),
        ("sticking", include_str!("../../../../recordings/scenarios/sticking.toml")),
        ("four-loops", include_str!("../../../../recordings/scenarios/four-loops.toml")),
        ("awkward", include_str!("../../../../recordings/scenarios/awkward.toml")),
    ];

    fn scenario(name: &str) -> Scenario {
        let (_, text) = SCENARIOS.into_iter().find(|(n, _)| *n == name).unwrap();
        Scenario::parse(text).unwrap()
    }

    fn span(x: &[f64]) -> f64 {
        x.iter().copied().fold(f64::MIN, f64::max) - x.iter().copied().fold(f64::MAX, f64::min)
    }

    /// Period in samples and regularity (mean over three standard deviations of the half periods) from the zero crossings of
    /// PV's autocorrelation; `None` with fewer than four crossings.
    fn oscillation(pv: &[f64]) -> Option<(f64, f64)> {
        let n = pv.len();
        let mean = |x: &[f64]| x.iter().sum::<f64>() / x.len() as f64;
        let mid = mean(pv);
        let acf = |lag: usize| -> f64 { (lag..n).map(|k| (pv[k] - mid) * (pv[k - lag] - mid)).sum() };
        let (mut crossings, mut before) = (Vec::new(), acf(0));
        for lag in 1..n / 2 {
            let now = acf(lag);
            if before.signum() != now.signum() && crossings.len() < 11 {
                crossings.push(lag as f64);
            }
            before = now;
        }
        let halves: Vec<f64> = crossings.windows(2).map(|w| w[1] - w[0]).collect();
        let half = mean(&halves);
        let sd = mean(&halves.iter().map(|h| (h - half) * (h - half)).collect::<Vec<_>>()).sqrt();
        (halves.len() >= 3).then_some((2.0 * half, half / sd.max(1e-9) / 3.0))
    }

    fn oscillates(record: &Record) -> bool {
        oscillation(&record.pv).is_some_and(|(_, regularity)| regularity > 1.0)
    }

    fn without_friction(scenario: &Scenario, index: usize) -> Record {
        let mut healthy = scenario.clone();
        healthy.loops[index].valve = super::super::scenario::ValveSpec::default();
        healthy.record(index).unwrap()
    }

    #[test]
    fn sticking_loops_cycle_because_of_their_valves() {
        for (name, index) in [("demo", 0), ("sticking", 0), ("four-loops", 0), ("four-loops", 1), ("awkward", 0)] {
            let scenario = scenario(name);
            let record = scenario.record(index).unwrap();
            let (period, regularity) = oscillation(&record.pv).unwrap();
            assert!(period > 50.0 && regularity > 1.0, "{name} {index}: {period} {regularity}");
            assert!(record.len() as f64 / period > 9.0, "{name} {index}");
            // The stem moves both ways: OP swings by more than s.
            let valve = &scenario.loops[index].valve;
            assert!(span(&record.op()) > valve.fs + valve.fd, "{name} {index}");
            let healthy = without_friction(&scenario, index);
            assert!(!oscillates(&healthy), "{name} {index}: {:?}", oscillation(&healthy.pv));
            assert!(span(&healthy.pv) < 0.2 * span(&record.pv), "{name} {index}");
        }
    }

    #[test]
    fn the_sticking_tour_shows_several_slips_a_half_cycle() {
        let scenario = scenario("sticking");
        let record = scenario.record(0).unwrap();
        let (period, _) = oscillation(&record.pv).unwrap();
        let slips = record.mv.clone().unwrap().windows(2).filter(|w| w[0] != w[1]).count() as f64;
        assert!(slips / (2.0 * record.len() as f64 / period) > 1.8);
    }

    #[test]
    fn recorded_op_is_what_the_valve_obeyed() {
        for (name, index) in [("demo", 0), ("sticking", 0), ("four-loops", 0), ("four-loops", 1), ("awkward", 0)] {
            let scenario = scenario(name);
            let valve = &scenario.loops[index].valve;
            let record = scenario.record(index).unwrap();
            let mv = record.mv.unwrap();
            let mut stem = mv[0];
            for (op, position) in record.op_path.iter().zip(&mv).skip(1) {
                stem = crate::core::sim::valve::he_step(stem, *op, valve.fs, valve.fd);
                assert_eq!(stem, *position, "{name} {index}");
            }
        }
    }

    #[test]
    fn tight_tuning_and_disturbances_oscillate_with_a_healthy_valve() {
        for (name, index, period) in
            [("demo", 2, 82.0), ("demo", 3, 90.0), ("four-loops", 2, 75.0), ("four-loops", 3, 100.0)]
        {
            let scenario = scenario(name);
            let record = scenario.record(index).unwrap();
            let (found, regularity) = oscillation(&record.pv).unwrap();
            assert!((found / period - 1.0).abs() < 0.08 && regularity > 1.0, "{name} {index}: {found} {regularity}");
            let (op, mv) = (record.op(), record.mv.clone().unwrap());
            assert!(op == mv && span(&op) > 3.0 && op.iter().all(|u| (10.0..90.0).contains(u)), "{name} {index}");
            // Sustained: both halves oscillate.
            let (first, second) = record.pv.split_at(record.len() / 2);
            assert!((0.4..2.5).contains(&(span(first) / span(second))), "{name} {index}");
        }
        // Without the disturbance, or with half the gain, the loops are calm.
        let mut calm = scenario("demo");
        calm.loops[3].disturbance.load.remove(0);
        calm.loops[2].controller.kc *= 0.5;
        assert!(!oscillates(&calm.record(3).unwrap()) && !oscillates(&calm.record(2).unwrap()));
    }

    #[test]
    fn healthy_sane_loops_do_not_oscillate() {
        assert!(!oscillates(&scenario("demo").record(1).unwrap()));
        assert!(!oscillates(&scenario("awkward").record(1).unwrap()));
    }

    /// Every bit of a stream.
    fn bits(stream: impl Iterator<Item = SimulatedSample>) -> Vec<(usize, i64, Signal, i64, Option<u64>)> {
        stream
            .map(|v| {
                let number = v.sample.value.as_number().map(f64::to_bits);
                (v.loop_index, v.arrival_ns, v.sample.signal, v.sample.t_ns, number)
            })
            .collect()
    }

    #[test]
    fn streams_repeat_to_the_last_bit_and_hang_on_the_seed() {
        for (name, _) in SCENARIOS {
            let mut scenario = scenario(name);
            scenario.run.duration_s = 300.0;
            let first = bits(scenario.stream());
            assert_eq!(first, bits(scenario.stream()), "{name}");
            scenario.run.seed += 1;
            assert_ne!(first, bits(scenario.stream()), "{name}");
        }
    }

    #[test]
    fn a_loop_does_not_hang_on_its_neighbours() {
        let mut scenario = scenario("demo");
        let before = scenario.record(3).unwrap();
        scenario.loops.remove(0);
        assert_eq!(before, scenario.record(2).unwrap());
    }

    #[test]
    fn an_undisturbed_stream_is_the_record_scan_by_scan() {
        let scenario = scenario("sticking");
        let record = scenario.record(0).unwrap();
        let values: Vec<SimulatedSample> = scenario.stream().collect();
        assert_eq!(values.len(), 4 * record.len());
        for (k, scan) in values.chunks_exact(4).enumerate() {
            let signals: Vec<Signal> = scan.iter().map(|v| v.sample.signal).collect();
            assert_eq!(signals, [Signal::Op, Signal::Sp, Signal::Mode, Signal::Pv]);
            let t_ns = 1_767_600_000_000_000_000 + k as i64 * 1_000_000_000;
            assert!(scan.iter().all(|v| v.sample.t_ns == t_ns && v.arrival_ns == t_ns));
            assert_eq!(scan[0].sample.value, Value::Number(record.op_path[k]));
            assert_eq!(scan[2].sample.value, Value::Mode(Mode::Auto));
            assert_eq!(scan[3].sample.value, Value::Number(record.pv[k]));
        }
    }

    #[test]
    fn stepping_a_live_plant_gives_the_same_values_with_other_stamps() {
        let scenario = scenario("demo");
        let mut live = SimulatedPlant::starting_at(&scenario, 5_000);
        assert_eq!(live.next_scan_ns(), 5_000);
        let stepped: Vec<SimulatedSample> = (0..50).flat_map(|_| live.step()).collect();
        for (a, b) in stepped.iter().zip(scenario.stream()) {
            assert_eq!(
                (a.loop_index, a.sample.signal, a.sample.value),
                (b.loop_index, b.sample.signal, b.sample.value)
            );
            assert_eq!(a.sample.t_ns - 5_000, b.sample.t_ns - scenario.start_ns());
        }
    }

    #[test]
    fn awkward_values_arrive_as_the_scenario_says() {
        let scenario = scenario("awkward");
        let start = scenario.start_ns();
        let values: Vec<SimulatedSample> = scenario.stream().collect();
        assert!(values.windows(2).all(|w| w[0].arrival_ns <= w[1].arrival_ns));
        let pv = |index: usize| {
            values.iter().filter(move |v| v.loop_index == index && v.sample.signal == Signal::Pv).collect::<Vec<_>>()
        };
        let (sticky, jumpy) = (pv(0), pv(1));
        let second = |t_ns: i64| (t_ns - start) / 1_000_000_000;
        // FIC301: no values in the gap; lost, doubled, late, disordered and empty values about as often as configured.
        assert!(sticky.iter().all(|v| !(400..460).contains(&second(v.sample.t_ns))));
        let mut stamps: Vec<i64> = sticky.iter().map(|v| v.sample.t_ns).collect();
        let disordered = stamps.windows(2).filter(|w| w[1] < w[0]).count();
        stamps.sort_unstable();
        let doubled = stamps.windows(2).filter(|w| w[0] == w[1]).count();
        stamps.dedup();
        let lost = 840 - stamps.len();
        let age = |v: &&&SimulatedSample| second(v.arrival_ns) - second(v.sample.t_ns);
        let late = sticky.iter().filter(|v| age(v) >= 30).count();
        let behind = sticky.iter().filter(|v| (1..=4).contains(&age(v))).count();
        let empty = sticky.iter().filter(|v| v.sample.value == Value::Missing).count();
        assert!((25..65).contains(&doubled) && (60..140).contains(&behind), "{doubled} {behind}");
        assert!(
            (2..25).contains(&late) && (1..12).contains(&lost) && (1..12).contains(&empty),
            "{late} {lost} {empty}"
        );
        assert!(disordered > 30, "{disordered}");
        // FIC302: every value once, with stamps 90 s ahead from 500 s to 700 s, and in manual from 200 s to 260 s.
        assert_eq!(jumpy.len(), 900);
        for (k, v) in (0_i64..).zip(&jumpy) {
            let ahead = if (500..700).contains(&k) { 90 } else { 0 };
            assert_eq!(second(v.sample.t_ns), k + ahead);
        }
        let hand = |v: &&SimulatedSample| v.loop_index == 1 && v.sample.value == Value::Mode(Mode::Manual);
        assert_eq!(values.iter().filter(hand).count(), 60);
        assert_eq!(scenario.record(1).unwrap().facts.manual, 60);
    }

    #[test]
    fn quantised_values_are_multiples() {
        let record = scenario("four-loops").record(1).unwrap();
        assert!(record.pv.iter().all(|y| ((y * 200.0).round() / 200.0) == *y));
        assert!(record.op_path.iter().all(|u| ((u * 100.0).round() / 100.0) == *u));
    }

    /// A record's oscillation in numbers, for debugging: period, samples per period, slips per half cycle, spans.
    fn numbers(record: &Record) -> String {
        let n = record.pv.len();
        let op = record.op();
        let mv = record.mv.clone().unwrap();
        let mean = |x: &[f64]| x.iter().sum::<f64>() / x.len() as f64;
        let span = |x: &[f64]| x.iter().copied().fold(f64::MIN, f64::max) - x.iter().copied().fold(f64::MAX, f64::min);
        // Upward crossings of OP's mean with a hysteresis of a tenth of its span.
        let (mid, h) = (mean(&op), 0.1 * span(&op));
        let (mut above, mut ups) = (op[0] > mid, Vec::new());
        for (k, &u) in op.iter().enumerate() {
            if above && u < mid - h {
                above = false;
            } else if !above && u > mid + h {
                above = true;
                ups.push(k as f64);
            }
        }
        let cycles: Vec<f64> = ups.windows(2).map(|w| w[1] - w[0]).collect();
        let period = mean(&cycles);
        let spread = mean(&cycles.iter().map(|c| (c - period) * (c - period)).collect::<Vec<_>>()).sqrt();
        let moves = mv.windows(2).filter(|w| w[0] != w[1]).count();
        let tail = &record.pv[n / 2..];
        format!(
            "acf period and regularity {:.1?}; period {period:.1} +- {spread:.1} samples ({} cycles), op {:.2}..{:.2} span {:.2}, pv span {:.2} (2nd half {:.2}), mv span {:.2}, stem moves a half cycle {:.2}",
            oscillation(&record.pv),
            cycles.len(),
            op.iter().copied().fold(f64::MAX, f64::min),
            op.iter().copied().fold(f64::MIN, f64::max),
            span(&op),
            span(&record.pv),
            span(tail),
            span(&mv),
            moves as f64 / (2.0 * n as f64 / period),
        )
    }

    #[test]
    #[ignore = "prints, for tuning scenarios by eye"]
    fn scenario_numbers() {
        for (name, text) in SCENARIOS {
            let scenario = Scenario::parse(text).unwrap();
            println!("{name}: {} values", scenario.stream().count());
            for (index, loop_name) in scenario.loop_names().enumerate() {
                println!("  {loop_name}: {}", numbers(&scenario.record(index).unwrap()));
                println!("    without friction: {}", numbers(&without_friction(&scenario, index)));
            }
        }
    }
}
