//! A control loop, scan by scan: PV is measured, the controller computes OP, the valve follows according to its friction, and
//! the process responds to the valve until the next scan.

use super::actuator::Actuator;
use super::controller::{Pid, PidSettings};
use super::disturbance::{Disturbance, DisturbanceState};
use super::friction::{Friction, FrictionState};
use super::noise::Noise;
use super::process::{ProcessModel, ProcessState};
use super::slips::{self, Law, Stroke};
use super::valve::{Tracking, he_step, tracking_step};
use crate::core::record::Record;
use crate::core::units::ns_from_s;

/// Valve model.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ValveLaw {
    /// No friction: the position equals OP.
    None,
    /// He's two-parameter model, [`he_step`].
    He,
    /// The tracking (sliding) model, [`tracking_step`].
    Tracking,
    /// A force model: [`ValveModel::friction`].
    Physical,
}

/// A valve: OP limited to its travel, then its model.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ValveModel {
    /// Law.
    pub law: ValveLaw,
    /// Static band, OP units; 0 without friction.
    pub fs: f64,
    /// Kinetic band, OP units, `0 <= fd <= fs`.
    pub fd: f64,
    /// OP at one end of the travel.
    pub travel_min: f64,
    /// OP at the other end, greater than `travel_min`.
    pub travel_max: f64,
    /// Properties of the stem in addition to its law.
    pub stroke: Stroke,
    /// The parts before and behind the stem.
    pub actuator: Actuator,
    /// Friction of the physical valve; the laws do not use it.
    pub friction: Friction,
}

/// State of a valve.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stem {
    /// Position until the next scan, OP units: the mean if the stem creeps in between, the last value if it is driven in parts.
    pub position: f64,
    direction: i8,
    inner: FrictionState,
    /// State of a stem with additional properties.
    moving: Option<slips::Stem>,
    /// Mean position until the next scan, and the flow behind the stem, as OP units.
    mean: f64,
    flow: f64,
    /// States of the actuator before the stem and of the parts behind it.
    drive: f64,
    follows: [f64; 2],
}

impl Stem {
    /// A stem at rest at `position`.
    #[must_use]
    pub const fn at_rest(position: f64) -> Self {
        Self {
            position,
            direction: 0,
            inner: FrictionState::at_rest(position),
            moving: None,
            mean: position,
            flow: position,
            drive: position,
            follows: [position; 2],
        }
    }
}

impl ValveModel {
    /// A valve without friction over 0..100.
    pub const HEALTHY: Self = Self {
        law: ValveLaw::None,
        fs: 0.0,
        fd: 0.0,
        travel_min: 0.0,
        travel_max: 100.0,
        stroke: Stroke::FREE,
        actuator: Actuator::NONE,
        friction: Friction::NONE,
    };

    /// Next state of the stem and its surroundings for `op`.
    #[must_use]
    pub fn step(&self, stem: Stem, op: f64) -> Stem {
        let op = op.clamp(self.travel_min, self.travel_max);
        if self.actuator.lag == 0.0 {
            let mut next = self.move_stem(stem, op);
            next.mean = next.position;
            next.flow = self.actuator.flow(next.mean, &mut next.follows);
            return next;
        }
        // The drive changes between two scans; the flow is the mean over the scan.
        let (drives, drive) = self.actuator.drives(stem.drive, op);
        let mut next = Stem { drive, mean: 0.0, ..stem };
        for op in drives {
            next = self.move_stem(next, op);
            next.mean += next.position / drives.len() as f64;
        }
        next.flow = self.actuator.flow(next.mean, &mut next.follows);
        next
    }

    fn move_stem(&self, stem: Stem, op: f64) -> Stem {
        match self.law {
            ValveLaw::None => Stem { position: op, ..stem },
            ValveLaw::He if self.stroke != Stroke::FREE => self.move_on(Law::He, stem, op),
            ValveLaw::Tracking if self.stroke != Stroke::FREE => self.move_on(Law::Tracking, stem, op),
            ValveLaw::He => Stem { position: he_step(stem.position, op, self.fs, self.fd), ..stem },
            ValveLaw::Tracking => {
                let now = Tracking { position: stem.position, direction: stem.direction };
                let Tracking { position, direction } = tracking_step(now, op, self.fs, self.fd);
                Stem { position, direction, ..stem }
            }
            ValveLaw::Physical => {
                let mut inner = stem.inner;
                let position = self.friction.step(&mut inner, op);
                Stem { position, inner, ..stem }
            }
        }
    }

    fn move_on(&self, law: Law, stem: Stem, op: f64) -> Stem {
        let bands = [self.fs, self.fd];
        let mut moving = stem.moving.unwrap_or_else(|| slips::Stem::resting(stem.position, bands, self.stroke));
        let position = moving.follow(law, op, bands, self.stroke.uneven);
        Stem { position, moving: Some(moving), ..stem }
    }
}

/// Parameters of a loop. The process acts on deviations from its operating point.
#[derive(Debug, Clone, PartialEq)]
pub struct LoopModel {
    /// Time between scans, s.
    pub ts_s: f64,
    /// Process, in samples of `ts_s`.
    pub process: ProcessModel,
    /// Valve position at the operating point, OP units; OP starts here.
    pub rest_op: f64,
    /// PV at the operating point, PV units; PV starts here.
    pub rest_pv: f64,
    /// Controller.
    pub controller: PidSettings,
    /// Valve.
    pub valve: ValveModel,
    /// Standard deviation of the white measurement noise, PV units.
    pub pv_noise_sd: f64,
    /// Disturbances at the process input, OP units (they pass the dead time and the process).
    pub load: Vec<Disturbance>,
    /// Disturbances added to PV, PV units (the controller sees them).
    pub pv_disturbance: Vec<Disturbance>,
}

/// Signals of one scan.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scan {
    /// Controller output of this scan, OP units.
    pub op: f64,
    /// PV as measured, before OP was computed, PV units.
    pub pv: f64,
    /// Set point that OP was computed from, PV units.
    pub sp: f64,
    /// Valve position after this OP, OP units; it acts until the next scan.
    pub mv: f64,
    /// Whether the controller is in manual.
    pub manual: bool,
}

/// A loop with its state.
#[derive(Debug, Clone)]
pub struct ClosedLoop {
    model: LoopModel,
    process: ProcessState,
    pid: Pid,
    stem: Stem,
    noise: Noise,
    load: Vec<DisturbanceState>,
    pv_disturbance: Vec<DisturbanceState>,
    /// Load since the last scan.
    held_load: f64,
    t_s: f64,
    scans: u64,
    start_s: f64,
}

impl ClosedLoop {
    /// A loop at rest that starts at `start_s` (disturbances count from 0) with the set point `sp`.
    ///
    /// Measurement noise uses stream 0 of `seed`, the disturbances the following streams.
    ///
    /// At the first step, if a lower limit of OP or of the valve's travel is above the upper one.
    #[must_use]
    pub fn new(model: LoopModel, start_s: f64, sp: f64, seed: u64) -> Self {
        let mut streams = 1..;
        let mut states = |shapes: &[Disturbance]| -> Vec<DisturbanceState> {
            let noises = streams.by_ref().map(|stream| Noise::new(seed, stream));
            shapes.iter().zip(noises).map(|(shape, noise)| DisturbanceState::new(*shape, model.ts_s, noise)).collect()
        };
        let load = states(&model.load);
        let pv_disturbance = states(&model.pv_disturbance);
        Self {
            process: ProcessState::at_rest(model.process, 0.0),
            pid: Pid::bumpless(model.controller, model.rest_op, sp, model.rest_pv),
            stem: Stem::at_rest(model.rest_op),
            noise: Noise::new(seed, 0),
            load,
            pv_disturbance,
            held_load: 0.0,
            t_s: start_s,
            scans: 0,
            start_s,
            model,
        }
    }

    /// Time of the next scan, s from the start of the recording.
    #[must_use]
    pub(crate) const fn time_s(&self) -> f64 {
        self.t_s
    }

    /// Switches to manual with OP at `op` (or at its current value).
    pub fn set_manual(&mut self, op: Option<f64>) {
        self.pid.set_manual(op);
    }

    /// Switches back to automatic.
    pub const fn set_auto(&mut self) {
        self.pid.set_auto();
    }

    /// One scan with the set point `sp`.
    pub fn step(&mut self, sp: f64) -> Scan {
        self.step_with(sp, 0.0, |_| 0.0)
    }

    /// One scan with the set point `sp`, an addition to PV (PV units), and an additional load at the process input until the
    /// next scan (OP units), which may depend on the valve position: this allows a curved valve characteristic.
    pub fn step_with(&mut self, sp: f64, on_pv: f64, more_load: impl FnOnce(f64) -> f64) -> Scan {
        let model = &self.model;
        let input = self.stem.flow - model.rest_op + self.held_load;
        let mut pv = model.rest_pv + self.process.step(input, 0.0) + on_pv;
        for disturbance in &mut self.pv_disturbance {
            pv += disturbance.at(self.t_s);
        }
        // Drawn even if the spread is 0, so that changing the spread leaves all other draws the same.
        pv += model.pv_noise_sd * self.noise.gaussian();
        let op = self.pid.step(sp, pv, model.ts_s);
        self.stem = model.valve.step(self.stem, op);
        self.held_load = self.load.iter_mut().map(|disturbance| disturbance.at(self.t_s)).sum();
        self.held_load += more_load(self.stem.mean);
        self.scans += 1;
        self.t_s = self.start_s + self.scans as f64 * model.ts_s;
        Scan { op, pv, sp, mv: self.stem.mean, manual: self.pid.is_manual() }
    }

    /// The next `n` scans at a constant set point as a [`Record`] with set point and valve position, unquantised.
    pub fn record(&mut self, n: usize, sp: f64) -> Record {
        let start_ns = ns_from_s(self.t_s);
        let scans: Vec<Scan> = (0..n).map(|_| self.step(sp)).collect();
        let column = |pick: fn(&Scan) -> f64| -> Vec<f64> { scans.iter().map(pick).collect() };
        let mut record = Record::uniform(self.model.ts_s, column(|s| s.op), column(|s| s.pv));
        (record.start_ns, record.end_ns) = (start_ns, start_ns + record.end_ns);
        record.sp = Some(column(|s| s.sp));
        record.mv = Some(column(|s| s.mv));
        record.facts.manual = scans.iter().filter(|s| s.manual).count() as u32;
        record
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::sim::controller::Action;

    /// First order with gain 2, 20 s, dead time 5 s, with a well-tuned controller (lambda tuning, lambda = 20 s).
    fn sane() -> LoopModel {
        LoopModel {
            ts_s: 1.0,
            process: ProcessModel { gain: 2.0, tau: 20.0, tau2: 0.0, dead_time: 5.0, integrating: false },
            rest_op: 50.0,
            rest_pv: 60.0,
            controller: PidSettings {
                kc: 0.4,
                ti_s: 20.0,
                td_s: 0.0,
                action: Action::Reverse,
                op_min: 0.0,
                op_max: 100.0,
                op_resolution: 0.0,
            },
            valve: ValveModel::HEALTHY,
            pv_noise_sd: 0.0,
            load: vec![],
            pv_disturbance: vec![],
        }
    }

    fn span(x: &[f64]) -> f64 {
        x.iter().copied().fold(f64::MIN, f64::max) - x.iter().copied().fold(f64::MAX, f64::min)
    }

    fn run(model: LoopModel, n: usize, sp: f64) -> Record {
        ClosedLoop::new(model, 0.0, sp, 1).record(n, sp)
    }

    /// Mean time between upward crossings of the midrange, samples.
    fn period(x: &[f64]) -> f64 {
        let mid = x.iter().sum::<f64>() / x.len() as f64;
        let ups: Vec<usize> = (1..x.len()).filter(|&k| x[k - 1] < mid && x[k] >= mid).collect();
        (ups[ups.len() - 1] - ups[0]) as f64 / (ups.len() - 1) as f64
    }

    #[test]
    fn a_loop_at_rest_stays_there_to_the_last_bit() {
        let record = run(sane(), 500, 60.0);
        assert!(record.pv.iter().all(|&y| y == 60.0) && record.op_path.iter().all(|&u| u == 50.0));
    }

    #[test]
    fn a_healthy_sane_loop_settles_on_a_new_set_point() {
        let record = run(sane(), 600, 64.0);
        assert!((record.pv[599] - 64.0).abs() < 1e-6 && (record.op_path[599] - 52.0).abs() < 1e-6);
        // PV cannot respond to OP of its own scan, or before the dead time is over.
        assert!(record.pv[..6].iter().all(|&y| y == 60.0) && record.pv[7] > 60.0);
        let peak = record.pv.iter().copied().fold(f64::MIN, f64::max);
        assert!(peak < 64.5, "{peak}");
    }

    #[test]
    fn a_healthy_loop_with_noise_does_not_oscillate_by_itself() {
        let record = run(LoopModel { pv_noise_sd: 0.1, ..sane() }, 3_000, 60.0);
        // Noise passes through the proportional part, and little more.
        assert!(span(&record.pv[500..]) < 1.2 && span(&record.op()[500..]) < 1.0);
    }

    #[test]
    fn a_set_point_out_of_reach_saturates_without_oscillation_and_is_left_at_once() {
        let model = LoopModel { pv_noise_sd: 0.05, ..sane() };
        let mut closed = ClosedLoop::new(model, 0.0, 60.0, 1);
        // With the valve wide open PV is 60 + 2 * 50 = 160.
        let stuck = closed.record(2_000, 200.0);
        assert!(stuck.op_path[500..].iter().all(|&u| u == 100.0));
        assert!((stuck.pv[1_999] - 160.0).abs() < 0.3);
        let back = closed.record(400, 60.0);
        assert!((back.pv[399] - 60.0).abs() < 0.5);
        let least = back.pv.iter().copied().fold(f64::MAX, f64::min);
        assert!(least > 45.0, "undershoot down to {least}");
        // No windup with a set point right at the limit either.
        let edge = ClosedLoop::new(LoopModel { pv_noise_sd: 0.05, ..sane() }, 0.0, 160.0, 2).record(3_000, 160.0);
        assert!(span(&edge.pv[1_000..]) < 1.5, "{}", span(&edge.pv[1_000..]));
    }

    #[test]
    fn a_sticking_valve_limit_cycles_under_integral_action() {
        for law in [ValveLaw::He, ValveLaw::Tracking] {
            let valve = ValveModel { law, fs: 3.0, fd: 1.0, ..ValveModel::HEALTHY };
            let record = run(LoopModel { valve, ..sane() }, 3_000, 61.0);
            let (op, mv, pv) = (record.op(), record.mv.clone().unwrap(), record.pv.clone());
            assert!(span(&op[1_500..]) >= 3.9 && span(&pv[1_500..]) > 1.0, "{law:?} {}", span(&op[1_500..]));
            // Sustained: the last third is as large as the previous one.
            assert!((span(&pv[2_000..]) / span(&pv[1_000..2_000]) - 1.0).abs() < 0.1);
            // The stem rests most of the time.
            let rests = mv[1_500..].windows(2).filter(|w| w[0] == w[1]).count();
            assert!(rests > 750, "{law:?} {rests}");
        }
    }

    #[test]
    fn proportional_action_alone_does_not_limit_cycle() {
        let valve = ValveModel { law: ValveLaw::He, fs: 3.0, fd: 1.0, ..ValveModel::HEALTHY };
        let controller = PidSettings { ti_s: f64::INFINITY, ..sane().controller };
        let record = run(LoopModel { valve, controller, ..sane() }, 2_000, 75.0);
        assert!(span(&record.pv[1_500..]) < 1e-9);
    }

    #[test]
    fn the_ultimate_gain_is_the_textbooks() {
        // Proportional control of a first-order lag with dead time becomes unstable at w theta + atan(w tau) = pi (solved by
        // bisection); the hold adds half a sample of dead time.
        let (tau, theta, gain) = (20.0_f64, 5.5_f64, 2.0_f64);
        let (mut lo, mut hi) = (0.01_f64, 3.0_f64);
        for _ in 0..100 {
            let w = 0.5 * (lo + hi);
            if w * theta + (w * tau).atan() < core::f64::consts::PI { lo = w } else { hi = w }
        }
        let ultimate = (1.0 + lo * lo * tau * tau).sqrt() / gain;
        let swing = |share: f64| {
            let controller = PidSettings { kc: share * ultimate, ti_s: f64::INFINITY, ..sane().controller };
            let load = vec![Disturbance::Step { size: 0.1, at_s: 10.0 }];
            let record = run(LoopModel { controller, load, ..sane() }, 1_200, 60.0);
            (span(&record.pv[1_000..]) / span(&record.pv[200..400]), period(&record.pv[200..]))
        };
        let ((below, _), (above, p)) = (swing(0.97), swing(1.03));
        assert!(below < 0.8 && above > 1.25, "{below} {above}");
        assert!((p * lo / (2.0 * core::f64::consts::PI) - 1.0).abs() < 0.05, "{p}");
    }

    #[test]
    fn a_sine_load_is_passed_on_as_the_frequency_response_says() {
        let (period_s, amplitude) = (100.0, 2.0);
        let load = vec![Disturbance::Sine { amplitude, period_s, phase_deg: 0.0 }];
        let record = run(LoopModel { load, ..sane() }, 3_000, 60.0);
        // |G / (1 + G C)| with G = 2 e^-5.5s / (20 s + 1), C = 0.4 (1 + 1 / 20 s): here G C = 0.8 e^-5.5s / 20 s.
        let w = 2.0 * core::f64::consts::PI / period_s;
        let g = 2.0 / (1.0 + 400.0 * w * w).sqrt();
        let (re, im) = (-0.04 / w * (5.5 * w).sin(), -0.04 / w * (5.5 * w).cos());
        let want = amplitude * g / ((1.0 + re) * (1.0 + re) + im * im).sqrt();
        assert!((span(&record.pv[1_000..]) / 2.0 / want - 1.0).abs() < 0.02, "{} {want}", span(&record.pv[1_000..]));
        assert!((period(&record.pv[1_000..]) - period_s).abs() < 0.5);
    }

    #[test]
    fn a_disturbance_at_pv_is_seen_at_once_and_a_load_after_the_dead_time() {
        let step = Disturbance::Step { size: 1.0, at_s: 10.0 };
        let at_pv = run(LoopModel { pv_disturbance: vec![step], ..sane() }, 30, 60.0);
        assert!(at_pv.pv[9] == 60.0 && at_pv.pv[10] == 61.0);
        let at_load = run(LoopModel { load: vec![step], ..sane() }, 30, 60.0);
        assert!(at_load.pv[15] == 60.0 && at_load.pv[16] > 60.0);
    }

    #[test]
    fn a_level_loop_with_direct_action_holds_its_set_point() {
        // The valve empties the vessel: negative gain, direct action.
        let model = LoopModel {
            process: ProcessModel { gain: -0.05, tau: 0.0, tau2: 0.0, dead_time: 2.0, integrating: true },
            controller: PidSettings { kc: 2.0, ti_s: 120.0, action: Action::Direct, ..sane().controller },
            load: vec![Disturbance::Step { size: 3.0, at_s: 50.0 }],
            ..sane()
        };
        let record = run(model, 2_000, 60.0);
        assert!((record.pv[1_999] - 60.0).abs() < 1e-3 && (record.op_path[1_999] - 47.0).abs() < 1e-2);
    }

    #[test]
    fn equal_seeds_give_equal_bits_and_others_do_not() {
        let noisy = || LoopModel {
            pv_noise_sd: 0.3,
            load: vec![Disturbance::Ar1 { sd: 1.0, time_constant_s: 30.0 }],
            pv_disturbance: vec![Disturbance::RandomWalk { sd_per_root_s: 0.01 }],
            ..sane()
        };
        let bits = |seed: u64| -> Vec<u64> {
            let record = ClosedLoop::new(noisy(), 0.0, 60.0, seed).record(500, 60.0);
            record.pv.iter().chain(&record.op_path).map(|x| x.to_bits()).collect()
        };
        assert_eq!(bits(5), bits(5));
        assert_ne!(bits(5), bits(6));
    }

    #[test]
    fn manual_holds_op_and_automatic_goes_on_without_a_bump() {
        let mut closed = ClosedLoop::new(sane(), 0.0, 60.0, 1);
        closed.set_manual(Some(55.0));
        let hand = closed.record(300, 60.0);
        assert!(hand.op_path.iter().all(|&u| u == 55.0) && hand.facts.manual == 300);
        assert!((hand.pv[299] - 70.0).abs() < 1e-3);
        closed.set_auto();
        // One scan integrates the error of -10: 0.4 * -10 / 20.
        let first = closed.step(60.0);
        assert!((first.op - 54.8).abs() < 1e-3 && !first.manual);
    }

    #[test]
    fn a_stem_with_more_than_a_law_steps_as_its_whole_path_runs() {
        let free = Stroke::FREE;
        let cases = [
            (ValveLaw::He, Law::He, Stroke { carried: 0.6, ..free }),
            (ValveLaw::He, Law::He, Stroke { rate: 0.3, uneven: -0.3, ..free }),
            (ValveLaw::Tracking, Law::Tracking, Stroke { drag: 0.5, slowest: 0.05, ..free }),
            (ValveLaw::He, Law::He, Stroke { ends: [48.0, 52.5], ..free }),
        ];
        let op: Vec<f64> = (0..700).map(|k| 50.0 + 5.0 * libm::sin(f64::from(k) * 0.07)).collect();
        for (law, same, stroke) in cases {
            let (fs, fd) = (3.0, 1.2);
            let valve = ValveModel { law, fs, fd, stroke, ..ValveModel::HEALTHY };
            let first = slips::FirstSlip { direction: 1.0, threshold: op[0] + fs * (1.0 + stroke.uneven) };
            let whole = slips::by_sample::Sequence::of(stroke, same, &op, 1, [fs + fd, fs - fd], first);
            let mut stem = Stem::at_rest(op[0]);
            for (k, op) in op.iter().enumerate() {
                stem = valve.step(stem, *op);
                let position = whole.at[k] - fd * (whole.direction[k] + stroke.uneven);
                assert!((stem.position - position).abs() < 1e-9, "{stroke:?} at {k}: {} {position}", stem.position);
            }
            assert!(whole.slips > 10, "{}", whole.slips);
        }
    }
}
