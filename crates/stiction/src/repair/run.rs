//! Simulates each draw in every case with the same disturbance and measures a stretch as long as the record.

use super::draws::{DRAWN, Drawn, draws};
use super::plant::Known;
use super::{Case, Figure, NoRepair, Repair, RepairParams};
use crate::core::detect::oscillation;
use crate::core::signal::stats;
use crate::core::sim::closed_loop::{ClosedLoop, LoopModel, Scan};
use crate::core::sim::controller::{Action, PidSettings};
use crate::core::sim::noise::Noise;
use crate::core::sim::process::ProcessModel;

/// Margin of OP beyond its recorded range on both sides, spans, if its range is unknown.
const WIDE: f64 = 10.0;
/// Initial offset from the operating point, bands.
const START_BANDS: f64 = 1.5;
/// Smallest movement that counts as a reversal, as a share of s, or of OP's span without stiction.
const TURN: f64 = 0.1;
const TURN_OF_SPAN: f64 = 0.05;
/// Mean length of the resampled blocks, as a share of the residuals.
const STRETCH: f64 = 0.25;
/// Least share of the residuals that is not attributed to model error.
const LEAST_SHARE: f64 = 0.15;
/// Number of candidates for the next block.
const JOINTS: usize = 12;
/// Largest ratio between simulated and recorded spread of PV, for a draw and for the median of draws; and largest ratio for
/// OP's reversals.
const DRAW_WITHIN: f64 = 1.6;
const SPREAD_WITHIN: f64 = 1.4;
const PACE_WITHIN: f64 = 2.0;
/// Fewest recorded reversals for comparing the rate.
const LEAST_TURNS: usize = 6;
/// Fewest draws that must remain.
const LEAST_DRAWS: usize = 8;
/// Draws tested for oscillation, and the share needed for agreement.
const ASKED: usize = 8;
const AGREED: f64 = 0.75;
/// Intervals are wider than the spread of the draws by this factor, chosen for coverage on simulated loops, see
/// docs/plant.md.
const WIDER: [f64; 3] = [2.5, 2.0, 3.5];
const DAY_S: f64 = 86_400.0;

/// Result of one run.
#[derive(Debug, Clone, Copy)]
struct Shown {
    pv_sd: f64,
    error: f64,
    travel: f64,
    op_travel: f64,
    turns: f64,
    op_turns: usize,
    oscillates: Option<bool>,
}

/// The cases: remaining share of the bands, and of the gain.
const CASES: [[f64; 2]; 3] = [[1.0, 1.0], [0.0, 1.0], [1.0, 0.5]];

/// Runs every case of every draw.
pub(super) fn compare(known: &Known<'_>, params: &RepairParams) -> Result<Repair, NoRepair> {
    let shape = known.shape();
    let recorded_pv_sd = stats::std_dev(&known.pv);
    let op_span = stats::span(&known.op);
    let s = shape.fs + shape.fd;
    let turn_op = if s > 0.0 { TURN * s } else { TURN_OF_SPAN * op_span };
    let drawn = draws(known, params.seed);
    if drawn.is_empty() {
        return Err(NoRepair::NoModel);
    }
    let mut runs: Vec<[Shown; 3]> = Vec::with_capacity(DRAWN);
    let mut spreads = Vec::with_capacity(DRAWN);
    for (k, draw) in drawn.iter().enumerate() {
        let mut noise = Noise::new(params.seed, 1 + k as u64);
        let sticks = shape.fs > 0.0;
        let least = if sticks { least_share(&known.pv, draw.plant.mse.sqrt()) } else { 1.0 };
        let share = libm::pow(least, noise.uniform());
        let disturbance = disturbance(&draw.plant.residual, 2 * known.len(), noise);
        let outlasting: Vec<f64> = disturbance.iter().map(|e| share * e).collect();
        let asked = runs.len() < ASKED;
        let run = |case: [f64; 2], on_pv: &[f64]| Rig { known, draw, params, turn_op, asked }.run(case, on_pv);
        let now = run(CASES[0], &disturbance);
        let ratio = now.pv_sd / recorded_pv_sd;
        spreads.push(ratio);
        if within(ratio, DRAW_WITHIN) {
            runs.push([now, run(CASES[1], &outlasting), run(CASES[2], &disturbance)]);
        }
    }
    let spread = stats::median(&spreads);
    if !within(spread, SPREAD_WITHIN) || runs.len() < LEAST_DRAWS {
        return Err(NoRepair::OtherSpread(spread));
    }
    let recorded_turns = stats::turns(&known.op, turn_op);
    let turns: Vec<f64> = runs.iter().map(|r| r[0].op_turns as f64).collect();
    let pace = stats::median(&turns) / recorded_turns.max(1) as f64;
    if recorded_turns >= LEAST_TURNS && !within(pace, PACE_WITHIN) {
        return Err(NoRepair::OtherPace(pace));
    }
    let [now, repaired, half_gain] = [0, 1, 2].map(|case| as_case(&runs, case));
    Ok(Repair { now, repaired, half_gain, recorded_pv_sd, turn_op, sentences: vec![], assumptions: vec![] })
}

/// Least share of the residuals that is a disturbance, at least the measurement noise. The rest may be model error, which would
/// vanish with the cycle.
fn least_share(pv: &[f64], left: f64) -> f64 {
    if left > 0.0 { (stats::noise_sd(pv) / left).clamp(LEAST_SHARE, 1.0) } else { 1.0 }
}

fn within(ratio: f64, factor: f64) -> bool {
    (1.0 / factor..=factor).contains(&ratio)
}

fn as_case(runs: &[[Shown; 3]], case: usize) -> Case {
    let figure = |f: &dyn Fn(&[Shown; 3]) -> f64| figure(&runs.iter().map(f).collect::<Vec<f64>>(), WIDER[case]);
    let asked: Vec<bool> = runs.iter().filter_map(|r| r[case].oscillates).collect();
    let share = asked.iter().filter(|o| **o).count() as f64 / asked.len().max(1) as f64;
    Case {
        pv_sd: figure(&|r| r[case].pv_sd),
        pv_sd_ratio: figure(&|r| r[case].pv_sd / r[0].pv_sd),
        pv_mean_abs_error: figure(&|r| r[case].error),
        travel_per_day: figure(&|r| r[case].travel),
        op_travel_per_day: figure(&|r| r[case].op_travel),
        reversals_per_day: figure(&|r| r[case].turns),
        oscillates: if share >= AGREED {
            Some(true)
        } else if share <= 1.0 - AGREED {
            Some(false)
        } else {
            None
        },
    }
}

/// Median and widened interval; in logarithms, since all figures are positive or 0.
fn figure(x: &[f64], times: f64) -> Figure {
    let sorted = stats::sorted(x);
    let [low, value, high] = [0.05, 0.5, 0.95].map(|q| stats::quantile_sorted(&sorted, q));
    let wider = |end: f64| if value > 0.0 && end > 0.0 { value * libm::pow(end / value, times) } else { end };
    Figure { value, interval: [wider(low), wider(high)] }
}

/// A disturbance of resampled blocks of a plant's residuals with geometric lengths (Politis and Romano 1994). A block starts
/// near the value at which the previous one ended, since a jump would act as an additional load.
fn disturbance(residual: &[f64], n: usize, mut noise: Noise) -> Vec<f64> {
    let known = residual.len();
    let ends = 1.0 / (STRETCH * known as f64).max(1.0);
    let mut at = noise.below(known as u64) as usize;
    let mut next = |at: usize| {
        if at + 1 < known && !noise.chance(ends) {
            return at + 1;
        }
        let goes_on = 2.0 * residual[at] - residual[at.saturating_sub(1)];
        let wanted = 0.5 * (residual[at] + goes_on);
        let places = (0..JOINTS).map(|_| noise.below(known as u64) as usize);
        let near = |place: usize| (residual[place] - wanted).abs();
        places.min_by(|a, b| near(*a).total_cmp(&near(*b))).unwrap_or(0)
    };
    (0..n)
        .map(|_| {
            at = next(at);
            residual[at]
        })
        .collect()
}

/// A draw prepared for its runs.
struct Rig<'a> {
    known: &'a Known<'a>,
    draw: &'a Drawn,
    params: &'a RepairParams,
    turn_op: f64,
    asked: bool,
}

impl Rig<'_> {
    /// Simulates a case for twice the record and measures the second half.
    fn run(&self, [bands, gain]: [f64; 2], disturbance: &[f64]) -> Shown {
        let known = self.known;
        let n = known.len();
        let sp = |k: usize| known.sp.as_ref().map_or_else(|| self.level(), |sp| sp[k]);
        let mut closed = ClosedLoop::new(self.model(bands, gain, sp(0)), 0.0, sp(0), 0);
        for on_pv in &disturbance[..n] {
            closed.step_with(sp(0), *on_pv, |_| 0.0);
        }
        let scans: Vec<Scan> = (0..n).map(|k| closed.step_with(sp(k), disturbance[n + k], |_| 0.0)).collect();
        self.measured(&scans)
    }

    /// Without a recorded set point, PV's mean is used.
    fn level(&self) -> f64 {
        stats::mean(&self.known.pv)
    }

    fn measured(&self, scans: &[Scan]) -> Shown {
        let column = |pick: fn(&Scan) -> f64| -> Vec<f64> { scans.iter().map(pick).collect() };
        let (op, pv, mv) = (column(|s| s.op), column(|s| s.pv), column(|s| s.mv));
        let per_day = DAY_S / (scans.len() as f64 * self.known.point_s);
        let travel = |x: &[f64]| x.windows(2).map(|w| (w[1] - w[0]).abs()).sum::<f64>() * per_day;
        let errors = column(|s| (s.sp - s.pv).abs());
        Shown {
            pv_sd: stats::std_dev(&pv),
            error: stats::mean(&errors),
            travel: travel(&mv),
            op_travel: travel(&op),
            turns: stats::turns(&mv, self.turn_op) as f64 * per_day,
            op_turns: stats::turns(&op, self.turn_op),
            oscillates: self.asked.then(|| oscillation::detect(&op, &pv).is_some_and(|o| o.oscillating)),
        }
    }

    fn model(&self, bands: f64, gain: f64, sp: f64) -> LoopModel {
        let (known, plant) = (self.known, &self.draw.plant);
        let c = known.controller;
        let shape = plant.shape;
        let p = shape.process;
        let limits = self.params.op_range.unwrap_or_else(|| {
            let op = stats::sorted(&known.op);
            let (low, high) = (op.first().copied().unwrap_or(0.0), op.last().copied().unwrap_or(0.0));
            [low - WIDE * (high - low), high + WIDE * (high - low)]
        });
        let off = START_BANDS * (shape.fs + shape.fd);
        let (rest_op, rest_pv) = if p.integrating {
            (plant.rest_op, sp + off / self.draw.kc)
        } else {
            (plant.rest_op + off, plant.rest_pv + p.gain * off)
        };
        let late = c.lag_samples / known.box_samples;
        LoopModel {
            ts_s: known.point_s,
            process: ProcessModel { dead_time: (p.dead_time + late).max(0.0), ..p },
            rest_op,
            rest_pv,
            controller: PidSettings {
                kc: gain * self.draw.kc,
                ti_s: self.draw.ti_s,
                td_s: c.td_s,
                action: if c.kc > 0.0 { Action::Reverse } else { Action::Direct },
                op_min: limits[0],
                op_max: limits[1],
                op_resolution: 0.0,
            },
            valve: known.valve(bands * shape.fs, bands * shape.fd, limits),
            pv_noise_sd: 0.0,
            load: vec![],
            pv_disturbance: vec![],
        }
    }
}
