//! One loop with its input series, in scans: built, run, stretched in time and measured.

use super::draw::{Draw, span, std_dev};
use stiction::core::sim::closed_loop::{ClosedLoop, LoopModel, ValveModel};
use stiction::core::sim::controller::{Action, PidSettings};
use stiction::core::sim::process::{ProcessModel, ProcessState};

/// A loop, times in scans.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Rig {
    pub process: ProcessModel,
    /// Controller gain, OP units per PV unit, > 0.
    pub kc: f64,
    /// Integral and derivative time, scans.
    pub ti: f64,
    pub td: f64,
    pub valve: ValveModel,
    pub rest_op: f64,
    pub rest_pv: f64,
    pub op_min: f64,
    pub op_max: f64,
    /// Curvature of the valve's characteristic, 1 / OP unit; 0 for a linear one.
    pub curvature: f64,
}

/// Inputs of a loop, each as long as the run.
#[derive(Debug, Clone, Default)]
pub(crate) struct Drive {
    /// Set point relative to the operating point, PV units.
    pub sp: Vec<f64>,
    /// At the process input, OP units.
    pub load: Vec<f64>,
    /// On PV, PV units.
    pub pv: Vec<f64>,
}

impl Drive {
    pub fn none(n: usize) -> Self {
        Self { sp: vec![0.0; n], load: vec![0.0; n], pv: vec![0.0; n] }
    }

    pub fn len(&self) -> usize {
        self.sp.len()
    }
}

/// The signals of a run.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Run {
    pub op: Vec<f64>,
    pub pv: Vec<f64>,
    pub sp: Vec<f64>,
    pub mv: Vec<f64>,
}

impl Run {
    /// Keeps every `every`-th scan from `from` on.
    pub fn thinned(&self, from: usize, every: usize) -> Self {
        let keep = |x: &[f64]| x.iter().skip(from).step_by(every.max(1)).copied().collect();
        Self { op: keep(&self.op), pv: keep(&self.pv), sp: keep(&self.sp), mv: keep(&self.mv) }
    }

    /// Whether every value is finite.
    pub fn is_finite(&self) -> bool {
        self.pv.iter().chain(&self.op).all(|x| x.is_finite())
    }
}

impl Rig {
    /// The middle of the range, no controller, no process: base for struct updates.
    pub const AT_REST: Self = Self {
        process: ProcessModel { gain: 1.0, tau: 0.0, tau2: 0.0, dead_time: 0.0, integrating: false },
        kc: 0.0,
        ti: f64::INFINITY,
        td: 0.0,
        valve: ValveModel::HEALTHY,
        rest_op: 50.0,
        rest_pv: 0.0,
        op_min: 0.0,
        op_max: 100.0,
        curvature: 0.0,
    };

    pub fn settings(&self, ts_s: f64) -> PidSettings {
        PidSettings {
            kc: self.kc,
            ti_s: self.ti * ts_s,
            td_s: self.td * ts_s,
            action: if self.process.gain > 0.0 { Action::Reverse } else { Action::Direct },
            op_min: self.op_min,
            op_max: self.op_max,
            op_resolution: 0.0,
        }
    }

    /// Runs the loop with white noise of `noise_sd` on PV.
    pub fn run(&self, drive: &Drive, noise_sd: f64, seed: u64) -> Run {
        let model = LoopModel {
            ts_s: 1.0,
            process: self.process,
            rest_op: self.rest_op,
            rest_pv: self.rest_pv,
            controller: self.settings(1.0),
            valve: self.valve,
            pv_noise_sd: noise_sd,
            load: vec![],
            pv_disturbance: vec![],
        };
        let mut closed = ClosedLoop::new(model, 0.0, self.rest_pv, seed);
        let mut run = Run::default();
        for k in 0..drive.len() {
            let bent = |mv: f64| {
                let x = mv - self.rest_op;
                // Equal percentage around the operating point: gain exp(c x), 1 at the point itself.
                let more =
                    if self.curvature > 0.0 { libm::expm1(self.curvature * x) / self.curvature - x } else { 0.0 };
                drive.load[k] + more
            };
            let scan = closed.step_with(self.rest_pv + drive.sp[k], drive.pv[k], bent);
            run.op.push(scan.op);
            run.pv.push(scan.pv);
            run.sp.push(scan.sp);
            run.mv.push(scan.mv);
        }
        run
    }

    /// The same loop, slower by the factor `c`; the valve does not change.
    pub fn stretched(mut self, c: f64) -> Self {
        let p = &mut self.process;
        (p.tau, p.tau2, p.dead_time) = (p.tau * c, p.tau2 * c, p.dead_time * c);
        if p.integrating {
            p.gain /= c;
        }
        (self.ti, self.td) = (self.ti * c, self.td * c);
        self
    }

    /// PV units per OP unit: the static gain, or for an integrating process its change within a sixth of `period`.
    pub fn pv_per_op(&self, period: f64) -> f64 {
        let gain = self.process.gain.abs();
        if self.process.integrating { gain * period / (2.0 * core::f64::consts::PI) } else { gain }
    }

    /// Response of PV to `x` at the process input, without control.
    pub fn through_process(&self, x: &[f64]) -> Vec<f64> {
        let mut process = ProcessState::at_rest(self.process, 0.0);
        x.iter().map(|&v| process.step(v, 0.0)).collect()
    }

    /// Response to a step of load from rest, without friction: span of PV in the second half relative to the first.
    pub fn ringing(&self, n: usize) -> f64 {
        let calm = Self { valve: ValveModel::HEALTHY, op_min: -1e6, op_max: 1e6, curvature: 0.0, ..*self };
        let calm = Self { valve: ValveModel { travel_min: -1e6, travel_max: 1e6, ..calm.valve }, ..calm };
        let mut drive = Drive::none(n);
        drive.load[2.min(n - 1)..].fill(1.0);
        let run = calm.run(&drive, 0.0, 0);
        if !run.is_finite() {
            return f64::INFINITY;
        }
        span(&run.pv[n / 2..]) / span(&run.pv[..n / 2]).max(1e-12)
    }
}

/// Motions of the stem: how often it starts to move, either way; movement below `least` per scan counts as rest.
pub fn motions(mv: &[f64], least: f64) -> usize {
    let moves: Vec<bool> = mv.windows(2).map(|w| (w[1] - w[0]).abs() > least).collect();
    moves.windows(2).filter(|w| w[1] && !w[0]).count()
}

/// Number of reversals of the stem, and its mean period over the last two thirds, scans.
pub fn turns(mv: &[f64], least: f64) -> (usize, Option<f64>) {
    let (mut direction, mut all, mut ups) = (0.0, 0, Vec::new());
    for (k, w) in mv.windows(2).enumerate() {
        let step = w[1] - w[0];
        if step.abs() <= least {
            continue;
        }
        if direction * step < 0.0 {
            all += 1;
            if step > 0.0 {
                ups.push(k);
            }
        }
        direction = step.signum();
    }
    ups.retain(|&k| k >= mv.len() / 3);
    let period = match (ups.first(), ups.last()) {
        (Some(first), Some(last)) if ups.len() >= 3 => Some((last - first) as f64 / (ups.len() - 1) as f64),
        _ => None,
    };
    (all, period)
}

/// Phase and magnitude of the open loop at `w`, 1/scan, for a controller gain of 1; half a scan of dead time for the hold.
fn open_loop(process: &ProcessModel, ti: f64, td: f64, w: f64) -> (f64, f64) {
    let pi = core::f64::consts::PI;
    let mut phase = -w * (process.dead_time + 0.5);
    let mut size = process.gain.abs();
    for tau in [process.tau, process.tau2].into_iter().filter(|tau| *tau > 0.0) {
        phase -= libm::atan(w * tau);
        size /= (1.0 + w * w * tau * tau).sqrt();
    }
    if process.integrating {
        phase -= 0.5 * pi;
        size /= w;
    }
    // Kc (1 + 1/(Ti s) + Td s), without the gain.
    let im = w * td - 1.0 / (w * ti);
    (phase + libm::atan(im), size * (1.0 + im * im).sqrt())
}

/// Frequencies from far below the loop's own up to the Nyquist limit, 1/scan.
fn frequencies(process: &ProcessModel, ti: f64) -> impl Iterator<Item = f64> {
    let lowest = 1e-4 / (process.tau + process.tau2 + process.dead_time + ti + 1.0);
    core::iter::successors(Some(lowest), |w| Some(w * 1.01)).take_while(|w| *w < core::f64::consts::PI)
}

/// Controller gain at the stability limit and the period of the oscillation there, scans, from the frequency response. `None`
/// if the phase never reaches -180 degrees.
pub fn ultimate(process: &ProcessModel, ti: f64, td: f64) -> Option<(f64, f64)> {
    let pi = core::f64::consts::PI;
    let mut was_above = false;
    for w in frequencies(process, ti) {
        let (phase, size) = open_loop(process, ti, td, w);
        if phase > -pi {
            was_above = true;
        } else if was_above {
            return Some((1.0 / size, 2.0 * pi / w));
        }
    }
    None
}

/// Maximum sensitivity Ms of Åström and Hägglund: the largest amplification of a disturbance on PV by the loop.
pub(crate) fn max_sensitivity(process: &ProcessModel, kc: f64, ti: f64, td: f64) -> f64 {
    let distance = |w: f64| {
        let (phase, size) = open_loop(process, ti, td, w);
        let (re, im) = (1.0 + kc * size * libm::cos(phase), kc * size * libm::sin(phase));
        (re * re + im * im).sqrt()
    };
    1.0 / frequencies(process, ti).map(distance).fold(f64::INFINITY, f64::min)
}

/// Typical tuning of a controller for `process`, with `tight` times the gain at the stability limit (0..1).
pub fn tune(draw: &mut Draw, process: &ProcessModel, tight: f64) -> Option<(f64, f64, f64, f64)> {
    let slow = process.tau + process.tau2 + 0.5 * process.dead_time + 0.5;
    let ti = if process.integrating {
        (process.dead_time + process.tau + 0.5) * draw.log_between(4.0, 20.0)
    } else {
        slow * draw.log_between(0.4, 2.0)
    };
    let td = if draw.chance(0.2) { ti * draw.between(0.08, 0.2) } else { 0.0 };
    let (most, period) = ultimate(process, ti, td)?;
    let mut kc = tight * most;
    if process.integrating {
        // Too little gain makes a level oscillate as too much does: keep Kc K Ti at 1 or above.
        kc = kc.max(1.0 / (process.gain.abs() * ti)).min(0.9 * most);
    }
    Some((kc, ti, td, period))
}

/// Amplitude of a sine with the same standard deviation.
pub(crate) fn swing(x: &[f64]) -> f64 {
    (2.0_f64).sqrt() * std_dev(x)
}
