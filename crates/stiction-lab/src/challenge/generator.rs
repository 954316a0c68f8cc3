//! One case: draws a loop, runs it without the effect, measures it, adds the effect and runs it again.
//!
//! A draw is discarded if the loop does not oscillate, reaches the limits of OP, or leaves the required range (55 to 250
//! samples per period, 5 to 30 periods). A case with an effect is drawn again, up to [`TRIES`] times, until the effect is
//! visible: the residual of a refitted first-order process with the loop's own valve is [`SHOWN`] times the noise. The last try
//! is kept in any case, and the truth states its residual.

use super::enter::{Made, Scale};
use super::kinds::Kind;
use super::plant::{Drive, Plant, ProcessSpec, Run};
use super::valve::{Law, Packing, ValveSpec};
use crate::truth::draw::Draw;
use crate::truth::rig::{motions, tune, turns};
use stiction::core::signal::stats::{mean, quantile, std_dev};
use stiction::core::sim::controller::{Action, PidSettings};
use stiction::core::sim::friction::SUB_STEPS;
use stiction::core::sim::noise::Noise;
use stiction::core::sim::process::{Pole, ProcessModel};

/// Draws of a case before an effect that is hardly visible is kept.
const TRIES: u32 = 8;

/// Ratio of residual to noise from which an effect counts as visible while cases are drawn.
const SHOWN: f64 = 1.35;

/// Specification of a case.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Order {
    /// Random stream of the draws.
    pub stream: String,
    pub seed: u64,
    /// None, one, or two effects.
    pub kinds: Vec<Kind>,
    /// 0 small, 1 middle, 2 large.
    pub size: usize,
    pub setpoint_moves: bool,
    pub transient: bool,
    pub mv: bool,
    /// Periods in the record; drawn if `None`.
    pub periods: Option<f64>,
}

/// A generated case.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Case {
    pub op: Vec<f64>,
    pub pv: Vec<f64>,
    pub sp: Vec<f64>,
    pub mv: Vec<f64>,
    pub ts_s: f64,
    pub made: Made,
    /// Size of each effect, about 0.3 to 1.
    pub sizes: Vec<f64>,
    pub noise_sd: f64,
    pub pv_sd: f64,
    pub period: f64,
    /// `[fs, fd]` upwards and downwards as measured on the bench, with the effect.
    pub bands: [[f64; 2]; 2],
    /// Root mean square residual of a refitted base with the true valve, and of the true form with the true sizes.
    pub base_rmse: f64,
    pub oracle_rmse: f64,
}

/// A loop without the effect.
struct Base {
    plant: Plant,
    drive: Drive,
    scale: Scale,
    noise_share: f64,
    ts_s: f64,
}

/// Period, scans, for which a loop is drawn before its time is stretched.
const DRAWN_FOR: f64 = 100.0;

fn packing(draw: &mut Draw) -> Packing {
    let fs = draw.log_between(1.5, 6.0);
    let fc = fs * draw.between(0.05, 0.75);
    // The Stribeck speed is above OP's speed (two bands in half a period), so that the stem sticks and slips; the drag is so
    // small that the stem hardly creeps before a slip (the curve's maximum is far below that speed) and slips at once.
    let pace = 4.0 * fs / DRAWN_FOR;
    let vs = pace * draw.log_between(1.5, 5.0);
    let fv = draw.log_between(0.01, 0.04).min(0.02 * pace * (fs - fc) / (vs * vs));
    Packing { fs, fc, vs, fv }
}

/// A loop with a sticking valve, drawn for a period of about [`DRAWN_FOR`] scans; `None` if no suitable controller is found.
pub(crate) fn plant(draw: &mut Draw) -> Option<Plant> {
    let gain = draw.sign() * draw.log_between(0.4, 3.0);
    let dead_time = 20.0 * draw.log_between(0.1, 0.9);
    let model = ProcessModel { gain, tau: 20.0, tau2: 0.0, dead_time, integrating: false };
    let tight = draw.between(0.2, 0.55);
    let (kc, ti, td, _) = tune(draw, &model, tight)?;
    let packing = packing(draw);
    let controller = PidSettings {
        kc,
        ti_s: ti,
        td_s: td,
        action: if gain > 0.0 { Action::Reverse } else { Action::Direct },
        op_min: 0.0,
        op_max: 100.0,
        op_resolution: 0.0,
    };
    Some(Plant {
        valve: ValveSpec::plain(packing),
        process: ProcessSpec::plain(gain, 20.0, dead_time),
        controller,
        rest_op: draw.between(35.0, 65.0),
        rest_pv: draw.between(20.0, 200.0),
        strain: draw.between(-0.6, 0.6) * packing.fs,
        retuned_at: 1.0,
        retuned: 1.0,
        pv_filter: 0.0,
        neighbour: None,
        seed: draw.seed(),
    })
}

/// Stretches the time of a loop from the period `now` to the period `wanted`, scans; forces are unchanged, and the packing's
/// speed keeps its ratio to OP's speed.
pub(crate) fn stretched(mut plant: Plant, now: f64, wanted: f64) -> Plant {
    let c = wanted / now;
    plant.process.tau *= c;
    plant.process.dead_time *= c;
    plant.controller.ti_s *= c;
    plant.controller.td_s *= c;
    plant.valve.packing.vs *= DRAWN_FOR / wanted;
    plant
}

/// Whether OP stays off its limits and all values are finite.
fn is_sane(run: &Run, from: usize) -> bool {
    run.pv.iter().all(|y| y.is_finite()) && run.op[from..].iter().all(|u| (1.0..99.0).contains(u))
}

impl Base {
    fn draw(order: &Order, draw: &mut Draw) -> Option<Self> {
        let mut plant = plant(draw)?;
        let [fs, fd] = plant.valve.bench(1.0);
        // A first run gives the period of the limit cycle; then the loop is stretched to the requested period.
        let mut kick = Drive::none(1_500);
        kick.sp.fill(1.5 * fs * plant.process.gain);
        let period = turns(&plant.run(&kick).mv, 2e-3 * fs).1?;
        let wanted = draw.log_between(65.0, order.periods.map_or(200.0, |_| 95.0));
        plant = stretched(plant, period, wanted);
        let drawn = draw.log_between(7.0, 20.0);
        let n = (wanted * order.periods.unwrap_or(drawn)).clamp(700.0, 1_900.0);
        let from = if order.transient { 0.0 } else { wanted * draw.between(3.0, 5.0) };
        let scans = (n + from) as usize;
        let mut drive = Drive::none(scans);
        // Moves of PV by the effect of a few slips.
        let unit = (fs + fd).max(0.6 * fs) * plant.process.gain.abs();
        let hold = wanted * draw.between(1.2, 2.5);
        let moves = draw.steps(hold, scans);
        let size = unit * draw.between(0.6, 1.6);
        let start = unit * draw.between(1.0, 2.0) * draw.sign();
        drive
            .sp
            .iter_mut()
            .zip(moves)
            .for_each(|(sp, step)| *sp = start + if order.setpoint_moves { size * step } else { 0.0 });
        let run = plant.run(&drive);
        let from = from as usize;
        let stem = [quantile(&run.mv[from..], 0.01), quantile(&run.mv[from..], 0.99)];
        let period = turns(&run.mv, 2e-3 * fs).1.unwrap_or(wanted);
        let (pv_mean, pv_sd) = (mean(&run.pv[from..]), std_dev(&run.pv[from..]));
        let scale = Scale { pv_mean, pv_sd, stem, jump: (fs - fd).max(0.1 * fs), period, scans, from };
        let swings = motions(&run.mv[from..], 2e-3 * fs) >= 10 && scale.pv_sd > 1e-6 && stem[1] - stem[0] > 0.3 * fs;
        let fits = (55.0..250.0).contains(&period) && (5.0..30.0).contains(&((scans - from) as f64 / period));
        let noise_share = draw.log_between(0.005, 0.1);
        let ts_s = draw.pick(&[1.0, 2.0, 5.0, 10.0], 1.0);
        (swings && fits && is_sane(&run, from)).then_some(Self { plant, drive, scale, noise_share, ts_s })
    }
}

/// The recording of a run: the part after the start, PV with random delays, then the effects of recording.
fn recorded(made: &Made, run: &Run, from: usize, noise: &mut Noise) -> [Vec<f64>; 4] {
    let cut = |x: &[f64]| x[from..].to_vec();
    let mut pv = cut(&run.pv);
    if made.jitter > 0.0 {
        for (k, y) in pv.iter_mut().enumerate() {
            let late = made.jitter * noise.uniform();
            let at = ((from + k) as f64 - late) * SUB_STEPS as f64;
            // The measurement noise belongs to the sample and is not delayed.
            let own = made.drive.noise[from + k];
            *y = run.fine[(at.max(0.0) as usize).min(run.fine.len() - 1)] + own;
        }
    }
    made.artefacts.iter().for_each(|artefact| artefact.apply(&mut pv));
    [cut(&run.op), pv, cut(&run.sp), cut(&run.mv)]
}

/// Draws a case until it meets the requirements.
pub(super) fn case(order: &Order) -> Case {
    let (mut number, mut tries) = (0_u32, 0);
    loop {
        // This ends only on success, like the loops of `truth`.
        let mut draw = Draw::new(order.seed, &format!("{}/{number}", order.stream));
        number += 1;
        let Some(found) = attempt(order, &mut draw) else { continue };
        tries += 1;
        let shows = order.kinds.is_empty() || found.base_rmse >= SHOWN * found.noise_sd;
        if shows || tries >= TRIES {
            return found;
        }
    }
}

fn attempt(order: &Order, draw: &mut Draw) -> Option<Case> {
    let base = Base::draw(order, draw)?;
    let tier = [0.35, 0.65, 1.0][order.size.min(2)];
    let sizes: Vec<f64> = order.kinds.iter().map(|_| tier * draw.between(0.85, 1.15)).collect();
    let seeds = [draw.seed(), draw.seed(), draw.seed()];
    let mut made = Made::new(base.plant.clone(), base.drive.clone());
    for (kind, size) in order.kinds.iter().zip(&sizes) {
        made.enter(*kind, *size, &base.scale, &mut Draw::new(seeds[0], kind.id()));
    }
    finish(&base, made, sizes, seeds)
}

/// Runs a loop with its effects, once without noise for the spread of PV, once with noise.
fn finish(base: &Base, mut made: Made, sizes: Vec<f64>, seeds: [u64; 3]) -> Option<Case> {
    let from = base.scale.from;
    let quiet = made.plant.run(&made.drive);
    let pv_sd = std_dev(&quiet.pv[from..]);
    if !is_sane(&quiet, from) || pv_sd > 8.0 * base.scale.pv_sd || pv_sd < 0.25 * base.scale.pv_sd {
        return None;
    }
    let noise_sd = base.noise_share * pv_sd;
    let mut noise = Noise::new(seeds[1], 0);
    made.drive.noise.iter_mut().for_each(|x| *x = noise_sd * noise.gaussian());
    let run = made.plant.run(&made.drive);
    if !is_sane(&run, from) || motions(&run.mv[from..], 2e-3 * base.plant.valve.packing.fs) < 8 {
        return None;
    }
    let bands = [made.plant.valve.bench(1.0), made.plant.valve.bench(-1.0)];
    let [op, pv, sp, mv] = recorded(&made, &run, from, &mut Noise::new(seeds[2], 0));
    let base_rmse = left_by_base(base, &run.op, &pv);
    let oracle_rmse = left_by_truth(&made, bands, &run.op, from, &pv, seeds[2]);
    let period = base.scale.period;
    let ts_s = base.ts_s;
    Some(Case { op, pv, sp, mv, ts_s, made, sizes, noise_sd, pv_sd, period, bands, base_rmse, oracle_rmse })
}

/// Root mean square residual of the best first-order process behind the valve without the effect.
fn left_by_base(base: &Base, op: &[f64], pv: &[f64]) -> f64 {
    let [up, down] = [base.plant.valve.bench(1.0), base.plant.valve.bench(-1.0)];
    let mut plain = base.plant.clone();
    plain.valve.law = Law::He([up, down]);
    let stem = plain.free_run(&Drive::none(op.len()), op).mv;
    let from = base.scale.from;
    let process = base.plant.process;
    let mut best = f64::INFINITY;
    let mut x = Vec::new();
    for slow in [0.4, 0.6, 0.8, 1.0, 1.25, 1.6, 2.2, 3.5] {
        for more in [-0.2, -0.1, 0.0, 0.1, 0.2, 0.35, 0.5, 0.7] {
            let tau = slow * process.tau;
            let delay = (process.dead_time + more * process.tau).max(0.0) + 1.0;
            Pole::lag(tau, delay - delay.floor()).run(delay as usize, &stem, stem[0], &mut x);
            // The time before the record is forgotten after a few time constants.
            let skip = ((delay + 3.0 * tau) as usize).saturating_sub(from).min(pv.len() / 2);
            best = best.min(residual_rms(&x[from + skip..], &pv[skip..]));
        }
    }
    best
}

/// Root mean square of `y` minus the best line in `x`.
fn residual_rms(x: &[f64], y: &[f64]) -> f64 {
    let n = y.len().max(1) as f64;
    let mean = |v: &[f64]| v.iter().sum::<f64>() / n;
    let (mx, my) = (mean(x), mean(y));
    let cross: f64 = x.iter().zip(y).map(|(a, b)| (a - mx) * (b - my)).sum();
    let (xx, yy) = (variation(x, mx), variation(y, my));
    let left = if xx > 0.0 { yy - cross * cross / xx } else { yy };
    (left.max(0.0) / n).sqrt()
}

fn variation(v: &[f64], mean: f64) -> f64 {
    v.iter().map(|a| (a - mean) * (a - mean)).sum()
}

/// Residual of the catalogue's form of the truth: the valve laws with bench bands instead of forces, all other effects with
/// their true sizes, gain and bias refitted; coloured noise and spikes count as unknown.
fn left_by_truth(made: &Made, bands: [[f64; 2]; 2], op: &[f64], from: usize, pv: &[f64], seed: u64) -> f64 {
    let mut known = made.clone();
    let slides = known.plant.valve.packing.vs < 0.02 * known.plant.valve.packing.fs;
    known.plant.valve.law = if slides { Law::Tracking(bands[0]) } else { Law::He(bands) };
    known.drive.noise.iter_mut().for_each(|x| *x = 0.0);
    if made.form == Some("random walk") || made.form == Some("first order") {
        known.drive.on_pv.iter_mut().for_each(|x| *x = 0.0);
    }
    let run = known.plant.free_run(&known.drive, op);
    let [_, model, _, _] = recorded(&known, &run, from, &mut Noise::new(seed, 0));
    let skip = (4.0 * made.plant.process.tau) as usize;
    let skip = skip.saturating_sub(from).min(pv.len() / 3);
    residual_rms(&model[skip..], &pv[skip..])
}
