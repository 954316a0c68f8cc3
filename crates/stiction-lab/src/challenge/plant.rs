//! The loop of the challenge: valve, transport, process, sensor and controller, integrated at sub-sample steps.
//!
//! None of it has the form that the diagnosis fits: dead time is a pipe, lags are advanced by their own exponentials (or by
//! Euler's rule if nonlinear), an inverse response is two opposing processes. `PV[k]` is measured before `OP[k]` is computed,
//! as in [`stiction::core::sim::closed_loop`].

use super::valve::{DT, Valve, ValveSpec};
use stiction::core::sim::controller::{Pid, PidSettings};
use stiction::core::sim::friction::SUB_STEPS;
use stiction::core::sim::noise::Noise;

/// From flow to PV, without state; times in scans. Deviations from the operating point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct ProcessSpec {
    /// PV units per OP unit.
    pub gain: f64,
    pub tau: f64,
    pub dead_time: f64,
    /// Degree to which self-regulation is lost: 0 none, 1 all (integrating).
    pub open: f64,
    /// A lag between valve and process.
    pub input_lag: f64,
    /// A lag of the sensor.
    pub sensor_lag: f64,
    /// Share of the gain that first acts in the wrong direction, and its time constant.
    pub against: f64,
    pub against_tau: f64,
    /// Growth of the gain with the level, per unit of PV.
    pub level_gain: f64,
    /// Natural logarithm of the gain at the end over that at the start.
    pub drift: f64,
    /// When the dead time changes, as a share of the run, and by how much.
    pub pipe_at: f64,
    pub pipe_change: f64,
    /// Time constant over tau falls by this per OP unit of flow (logarithm).
    pub tau_slope: f64,
    /// Falling PV takes `1 + sluggish` times as long as rising PV.
    pub sluggish: f64,
}

impl ProcessSpec {
    /// First order with dead time.
    pub const fn plain(gain: f64, tau: f64, dead_time: f64) -> Self {
        Self {
            gain,
            tau,
            dead_time,
            open: 0.0,
            input_lag: 0.0,
            sensor_lag: 0.0,
            against: 0.0,
            against_tau: 1.0,
            level_gain: 0.0,
            drift: 0.0,
            pipe_at: 1.0,
            pipe_change: 0.0,
            tau_slope: 0.0,
            sluggish: 0.0,
        }
    }

    /// Time constant at flow `u` when PV tends to move by `push` (both as deviations).
    fn time(&self, u: f64, push: f64) -> f64 {
        let slow = if self.sluggish != 0.0 && push < 0.0 { 1.0 + self.sluggish } else { 1.0 };
        let by_flow = if self.tau_slope == 0.0 { 1.0 } else { libm::exp((-self.tau_slope * u).clamp(-2.0, 2.0)) };
        self.tau * slow * by_flow
    }
}

/// A process with its state.
#[derive(Debug, Clone)]
struct Process {
    spec: ProcessSpec,
    /// Flow at every sub-step so far: the content of the pipe.
    pipe: Vec<f64>,
    entered: f64,
    y: f64,
    against: f64,
    shown: f64,
    /// Number of scans of the run.
    length: f64,
}

/// Fraction of the distance to its input that a lag of `tau` scans covers per sub-step.
fn share(tau: f64) -> f64 {
    if tau > 0.0 { 1.0 - libm::exp(-DT / tau) } else { 1.0 }
}

impl Process {
    fn new(spec: ProcessSpec, length: usize, flow: f64) -> Self {
        Self { spec, pipe: vec![flow], entered: flow, y: 0.0, against: 0.0, shown: 0.0, length: length.max(1) as f64 }
    }

    /// Current output of the pipe.
    fn delayed(&self) -> f64 {
        let now = self.pipe.len() as f64 - 1.0;
        let changed = now * DT >= self.spec.pipe_at * self.length;
        let dead_time = self.spec.dead_time + if changed { self.spec.pipe_change } else { 0.0 };
        let at = (now - dead_time.max(0.0) / DT).max(0.0);
        let (whole, part) = (at as usize, at - at.floor());
        let older = self.pipe[whole.min(self.pipe.len() - 1)];
        let newer = self.pipe[(whole + 1).min(self.pipe.len() - 1)];
        older + part * (newer - older)
    }

    /// One sub-step with `flow` into the pipe and `load` at its output.
    fn sub_step(&mut self, flow: f64, load: f64) {
        let spec = self.spec;
        self.pipe.push(flow);
        self.entered += share(spec.input_lag) * (self.delayed() - self.entered);
        let u = self.entered + load;
        let past = self.pipe.len() as f64 * DT / self.length;
        let drifted = if spec.drift == 0.0 { spec.gain } else { spec.gain * libm::exp(spec.drift * past) };
        let level = (1.0 + spec.level_gain * self.y).clamp(0.25, 4.0);
        let aim = drifted * level * (1.0 + spec.against) * u;
        let tau = spec.time(u, aim - self.y);
        self.y +=
            if spec.open == 0.0 { share(tau) * (aim - self.y) } else { DT / tau * (aim - (1.0 - spec.open) * self.y) };
        if spec.against != 0.0 {
            self.against += share(spec.against_tau) * (drifted * spec.against * u - self.against);
        }
        self.shown += share(spec.sensor_lag) * (self.y - self.against - self.shown);
    }
}

/// External inputs of a loop, one value per scan.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Drive {
    /// Set point as a deviation, PV units.
    pub sp: Vec<f64>,
    /// At the process input, after the dead time, OP units.
    pub load: Vec<f64>,
    /// On PV, PV units.
    pub on_pv: Vec<f64>,
    /// White noise on PV, PV units.
    pub noise: Vec<f64>,
}

impl Drive {
    pub fn none(n: usize) -> Self {
        let zero = vec![0.0; n];
        Self { sp: zero.clone(), load: zero.clone(), on_pv: zero.clone(), noise: zero }
    }
}

/// A second loop that interacts with this one.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Neighbour {
    pub plant: Plant,
    /// Contribution of its PV (as a deviation) to our process input, OP units per PV unit, and of ours to its.
    pub to_us: f64,
    pub to_it: f64,
}

/// Parameters of a loop.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Plant {
    pub valve: ValveSpec,
    pub process: ProcessSpec,
    pub controller: PidSettings,
    pub rest_op: f64,
    pub rest_pv: f64,
    /// Initial strain: OP above the stem, OP units.
    pub strain: f64,
    /// After this share of the run, the controller gain is multiplied by `retuned` and PV filtered over `pv_filter` scans.
    pub retuned_at: f64,
    pub retuned: f64,
    pub pv_filter: f64,
    pub neighbour: Option<Box<Neighbour>>,
    pub seed: u64,
}

/// The signals of a run; `flow` behind the characteristic and `fine` (PV at sub-steps, without noise) are not recorded.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Run {
    pub op: Vec<f64>,
    pub pv: Vec<f64>,
    pub sp: Vec<f64>,
    pub mv: Vec<f64>,
    pub fine: Vec<f64>,
}

/// One running loop.
pub(crate) struct Loop<'a> {
    plant: &'a Plant,
    valve: Valve,
    process: Process,
    pid: Pid,
    filtered: Option<f64>,
    n: usize,
    beside: Option<Box<Loop<'a>>>,
    run: Run,
}

impl<'a> Loop<'a> {
    /// A loop at rest except for its strain, for a run of `n` scans with the set point `sp`.
    pub fn new(plant: &'a Plant, n: usize, sp: f64) -> Self {
        let valve = Valve::new(plant.valve.clone(), plant.rest_op, plant.strain, Noise::new(plant.seed, 7));
        let flow = valve.position() - plant.rest_op;
        let pid = Pid::bumpless(plant.controller, plant.rest_op, plant.rest_pv + sp, plant.rest_pv);
        let beside = plant.neighbour.as_ref().map(|other| Box::new(Loop::new(&other.plant, n, 0.0)));
        let process = Process::new(plant.process, n, flow);
        Self { plant, valve, process, pid, filtered: None, n, beside, run: Run::default() }
    }

    /// One scan with `[set point, load, on PV, noise]`; OP is given in free run, else computed by the controller.
    pub fn scan(&mut self, k: usize, drive: [f64; 4], given: Option<f64>) {
        let [sp, mut load, on_pv, noise] = drive;
        let plant = self.plant;
        let mut pv = plant.rest_pv + self.process.shown + on_pv + noise;
        let late = k as f64 >= plant.retuned_at * self.n as f64;
        if late && plant.pv_filter > 0.0 {
            let before = self.filtered.unwrap_or(pv);
            pv = before + (1.0 - libm::exp(-1.0 / plant.pv_filter)) * (pv - before);
            self.filtered = Some(pv);
        }
        let sp = plant.rest_pv + sp;
        if late && plant.retuned != 1.0 && !self.pid.is_manual() && k as f64 - 1.0 < plant.retuned_at * self.n as f64 {
            let settings = PidSettings { kc: plant.controller.kc * plant.retuned, ..plant.controller };
            self.pid = Pid::bumpless(settings, self.pid.op(), sp, pv);
        }
        let op = given.unwrap_or_else(|| self.pid.step(sp, pv, plant.controller_scan_s()));
        if let (Some(other), Some(neighbour)) = (&mut self.beside, &plant.neighbour) {
            load += neighbour.to_us * other.process.shown;
            other.scan(k, [0.0, neighbour.to_it * self.process.shown, 0.0, 0.0], None);
        }
        self.valve.age(k as f64 / self.n as f64);
        for _ in 0..SUB_STEPS {
            let flow = self.valve.sub_step(op) - plant.rest_op;
            self.process.sub_step(flow, load);
            self.run.fine.push(plant.rest_pv + self.process.shown + on_pv);
        }
        self.run.op.push(op);
        self.run.pv.push(pv);
        self.run.sp.push(sp);
        self.run.mv.push(self.valve.position());
    }

    /// Output of the process relative to its operating point, PV units.
    pub const fn deviation(&self) -> f64 {
        self.process.shown
    }

    /// Stem position relative to its operating point, OP units.
    pub const fn flow(&self) -> f64 {
        self.valve.position() - self.plant.rest_op
    }

    /// OP and PV so far.
    pub fn into_op_and_pv(self) -> [Vec<f64>; 2] {
        [self.run.op, self.run.pv]
    }
}

impl Plant {
    /// Controller times are in scans here.
    const fn controller_scan_s(&self) -> f64 {
        1.0
    }

    /// Runs the closed loop for the scans of `drive`.
    pub fn run(&self, drive: &Drive) -> Run {
        self.simulate(drive, None)
    }

    /// PV and stem with OP given, without the controller.
    pub fn free_run(&self, drive: &Drive, op: &[f64]) -> Run {
        self.simulate(drive, Some(op))
    }

    fn simulate(&self, drive: &Drive, op: Option<&[f64]>) -> Run {
        let n = drive.sp.len();
        let mut now = Loop::new(self, n, drive.sp.first().copied().unwrap_or(0.0));
        for k in 0..n {
            let given = op.and_then(|op| op.get(k).copied());
            now.scan(k, [drive.sp[k], drive.load[k], drive.on_pv[k], drive.noise[k]], given);
        }
        now.run
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::challenge::valve::Packing;
    use stiction::core::sim::controller::Action;

    pub(crate) fn plain() -> Plant {
        let packing = Packing { fs: 1e-4, fc: 1e-5, vs: 1.0, fv: 1e-3 };
        let controller = PidSettings {
            kc: 0.4,
            ti_s: 20.0,
            td_s: 0.0,
            action: Action::Reverse,
            op_min: 0.0,
            op_max: 100.0,
            op_resolution: 0.0,
        };
        Plant {
            valve: ValveSpec::plain(packing),
            process: ProcessSpec::plain(2.0, 20.0, 5.3),
            controller,
            rest_op: 50.0,
            rest_pv: 60.0,
            strain: 0.0,
            retuned_at: 1.0,
            retuned: 1.0,
            pv_filter: 0.0,
            neighbour: None,
            seed: 1,
        }
    }

    /// PV for a step of OP by 1 at scan 10, over 400 scans.
    fn response(plant: &Plant) -> Vec<f64> {
        let mut op = vec![50.0; 400];
        op[10..].fill(51.0);
        plant.free_run(&Drive::none(400), &op).pv
    }

    #[test]
    fn a_step_is_answered_as_the_textbook_says() {
        let pv = response(&plain());
        for (k, y) in pv.iter().enumerate() {
            let t = k as f64 - 10.0 - 5.3;
            let want = 60.0 + if t > 0.0 { 2.0 * (1.0 - libm::exp(-t / 20.0)) } else { 0.0 };
            assert!((y - want).abs() < 0.02, "{k}: {y} {want}");
        }
    }

    #[test]
    fn lags_processes_and_pipes_do_what_they_say() {
        let with = |change: fn(&mut ProcessSpec)| {
            let mut plant = plain();
            change(&mut plant.process);
            response(&plant)
        };
        let base = response(&plain());
        let behind = |pv: &[f64]| base.iter().zip(pv).map(|(a, b)| a - b).sum::<f64>() / 2.0;
        // The area between two step responses is the sum of the additional lags times the gain.
        assert!((behind(&with(|p| p.input_lag = 8.0)) - 8.0).abs() < 0.2);
        assert!((behind(&with(|p| p.sensor_lag = 8.0)) - 8.0).abs() < 0.2);
        let wrong_way = with(|p| (p.against, p.against_tau) = (0.6, 5.0));
        let lowest = wrong_way.iter().copied().fold(f64::MAX, f64::min);
        assert!(lowest < 59.95 && (wrong_way[399] - 62.0).abs() < 0.01, "{lowest}");
        let open = with(|p| p.open = 1.0);
        assert!((open[300] - open[200] - 10.0).abs() < 0.1);
        let drifted = with(|p| p.drift = 0.5);
        assert!(drifted[399] > 63.0);
        let longer = with(|p| (p.pipe_at, p.pipe_change) = (0.0, 6.0));
        assert!((behind(&longer) - 6.0).abs() < 0.2);
    }

    #[test]
    fn free_run_on_its_own_op_repeats_the_closed_loop() {
        let mut plant = plain();
        plant.valve.packing = Packing { fs: 3.0, fc: 0.6, vs: 0.3, fv: 0.01 };
        let mut drive = Drive::none(900);
        drive.sp[20..].fill(7.0);
        let closed = plant.run(&drive);
        let free = plant.free_run(&drive, &closed.op);
        assert_eq!(closed.pv, free.pv);
        let late: Vec<f64> = closed.pv[500..].to_vec();
        let swing = stiction::core::signal::stats::span(&late);
        assert!(swing > 0.2, "it cycles: {swing}");
    }

    #[test]
    fn a_neighbour_is_felt() {
        let mut plant = plain();
        plant.valve.packing = Packing { fs: 3.0, fc: 0.6, vs: 0.3, fv: 0.01 };
        let mut drive = Drive::none(900);
        drive.sp[20..].fill(7.0);
        let alone = plant.run(&drive).pv;
        let mut other = plant.clone();
        other.strain = 2.0;
        plant.neighbour = Some(Box::new(Neighbour { plant: other, to_us: 0.3, to_it: 0.3 }));
        let both = plant.run(&drive).pv;
        assert!(alone.iter().zip(&both).any(|(a, b)| (a - b).abs() > 0.2));
    }
}
