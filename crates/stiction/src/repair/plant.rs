//! The plant identified from the record: valve and process over recorded OP, gain and offset by least squares, and the
//! residuals of PV.

use super::NoRepair;
use crate::core::ident::least_squares::Gram;
use crate::core::record::Record;
use crate::core::signal::stats;
use crate::core::sim::closed_loop::{Stem, ValveLaw, ValveModel};
use crate::core::sim::process::{ProcessModel, ProcessState};
use crate::core::sim::slips::Law;
use crate::core::verdict::{Assessment, Controller, Process};

/// Most points simulated; of longer records, the latest ones.
const MOST_POINTS: usize = 2_000;
/// Fewest points for a fit.
const LEAST_POINTS: usize = 60;
/// Least share of OP that the controller model must explain.
const EXPLAINED: f64 = 0.7;
/// Time constants after which the past before the record is forgotten, and the largest part of the record left out for it.
const FORGOTTEN: f64 = 3.0;
const MOST_LEFT_OUT: f64 = 0.4;

/// Results of record and assessment.
pub(super) struct Known<'a> {
    pub process: &'a Process,
    pub controller: &'a Controller,
    pub law: ValveLaw,
    pub assessment: &'a Assessment,
    /// Path of OP, `per_point` values per point.
    path: Vec<f64>,
    per_point: usize,
    /// OP, PV and set point, one value per point.
    pub op: Vec<f64>,
    pub pv: Vec<f64>,
    pub sp: Option<Vec<f64>>,
    /// Time between points, and raw samples per point.
    pub point_s: f64,
    pub box_samples: f64,
}

/// Valve and process, times in points.
#[derive(Debug, Clone, Copy)]
pub(super) struct Shape {
    pub fs: f64,
    pub fd: f64,
    /// `gain` is that of the assessment.
    pub process: ProcessModel,
}

/// A plant that explains the record.
#[derive(Debug, Clone)]
pub(super) struct Plant {
    pub shape: Shape,
    /// Stem position at which the process rests, OP units, and PV there (self-regulating processes).
    pub rest_op: f64,
    pub rest_pv: f64,
    /// Residuals of PV.
    pub residual: Vec<f64>,
    pub mse: f64,
}

impl<'a> Known<'a> {
    pub fn of(record: &Record, a: &'a Assessment) -> Result<Self, NoRepair> {
        if a.stiction.is_none() {
            return Err(NoRepair::Inconclusive(a.reason.unwrap_or("inconclusive").to_owned()));
        }
        let process = a.process.as_ref().ok_or(NoRepair::NoModel)?;
        if !process.tested {
            return Err(NoRepair::Untested);
        }
        let controller = a.controller.as_ref().ok_or(NoRepair::NoController)?;
        if controller.unexplained > 1.0 - EXPLAINED {
            return Err(NoRepair::PartController(100.0 * (1.0 - controller.unexplained)));
        }
        if controller.kc * process.gain <= 0.0 {
            return Err(NoRepair::Signs);
        }
        let n = record.len();
        let latest = record.part(n.saturating_sub(MOST_POINTS), n);
        let finite = |x: &[f64]| x.iter().all(|v| v.is_finite());
        if latest.len() < LEAST_POINTS || !finite(&latest.pv) || !finite(&latest.op_path) {
            return Err(NoRepair::NoModel);
        }
        let law = match a.valve_model {
            Some(Law::Tracking) => ValveLaw::Tracking,
            _ => ValveLaw::He,
        };
        Ok(Self {
            process,
            controller,
            law: if a.stiction == Some(true) { law } else { ValveLaw::None },
            assessment: a,
            per_point: latest.path_per_point(),
            op: latest.op(),
            point_s: latest.point_s(),
            box_samples: latest.box_samples as f64,
            sp: latest.sp.filter(|sp| sp.len() == latest.pv.len() && finite(sp)),
            path: latest.op_path,
            pv: latest.pv,
        })
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.pv.len()
    }

    /// The valve with the bands of `shape`, for any travel.
    pub fn valve(&self, fs: f64, fd: f64, travel: [f64; 2]) -> ValveModel {
        let law = if fs > 0.0 { self.law } else { ValveLaw::None };
        ValveModel { law, fs, fd, travel_min: travel[0], travel_max: travel[1], ..ValveModel::HEALTHY }
    }

    /// Valve and process as assessed.
    pub fn shape(&self) -> Shape {
        let sticks = self.law != ValveLaw::None;
        let band = |x: Option<f64>| x.filter(|_| sticks).unwrap_or(0.0).max(0.0);
        let fs = band(self.assessment.fs);
        let taus = |k: usize| self.process.time_constants_s.get(k).map_or(0.0, |t| t / self.point_s);
        let process = ProcessModel {
            gain: self.process.gain * if self.process.integrating { self.point_s } else { 1.0 },
            tau: taus(0),
            tau2: taus(1),
            dead_time: self.process.dead_time_s / self.point_s,
            integrating: self.process.integrating,
        };
        Shape { fs, fd: band(self.assessment.fd).min(fs), process }
    }

    /// The plant of this shape with the gain and offset that fit the record best; `None` if the gain has the opposite sign.
    pub fn plant(&self, shape: Shape) -> Option<Plant> {
        let n = self.len();
        let stem = self.stem(shape.fs, shape.fd);
        let unit = ProcessModel { gain: 1.0, ..shape.process };
        let middle = stats::mean(&stem);
        let rest = if unit.integrating { middle } else { 0.0 };
        let mut process = ProcessState::at_rest(unit, *stem.first()?);
        let response: Vec<f64> = (0..n).map(|k| process.step(stem[k.saturating_sub(1)], rest)).collect();
        let forgets = unit.dead_time + FORGOTTEN * if unit.integrating { unit.tau } else { unit.tau + unit.tau2 };
        // The initial stem position is forgotten once the stem has moved both ways.
        let from = (moved_both_ways(&stem) + forgets.ceil().max(0.0) as usize).min((MOST_LEFT_OUT * n as f64) as usize);
        // The effect of the time before the record: a transient that decays, or a drift of the level.
        let before: Vec<f64> = if unit.integrating {
            (from..n).map(|k| k as f64 / n as f64).collect()
        } else {
            (from..n).map(|k| libm::exp(-(k as f64) / unit.tau.max(0.1))).collect()
        };
        let (response, pv) = (&response[from..], &self.pv[from..]);
        let one = vec![1.0; n - from];
        let mut gram = Gram::of(&[&one, response, &before, pv]);
        gram.eliminate(3);
        let [level, gain, start, ..] = gram.back(3, &[]);
        if !(gain * shape.process.gain).is_normal() || gain * shape.process.gain < 0.0 {
            return None;
        }
        let left = (0..pv.len()).map(|k| pv[k] - level - gain * response[k] - start * before[k]);
        let residual: Vec<f64> = left.collect();
        let mse = stats::dot(&residual, &residual) / residual.len() as f64;
        let rest_op = if unit.integrating { middle - start / n as f64 / gain } else { middle };
        Some(Plant {
            shape: Shape { process: ProcessModel { gain, ..shape.process }, ..shape },
            rest_op,
            rest_pv: level + gain * middle,
            residual,
            mse,
        })
    }

    /// Stem positions for recorded OP, averaged over each point.
    fn stem(&self, fs: f64, fd: f64) -> Vec<f64> {
        let valve = self.valve(fs, fd, [f64::NEG_INFINITY, f64::INFINITY]);
        let mut stem = Stem::at_rest(self.path.first().copied().unwrap_or(0.0));
        let mean = |path: &[f64]| {
            let sum: f64 = path
                .iter()
                .map(|op| {
                    stem = valve.step(stem, *op);
                    stem.position
                })
                .sum();
            sum / path.len() as f64
        };
        self.path.chunks_exact(self.per_point).map(mean).collect()
    }
}

/// First point at which the stem has moved both up and down.
fn moved_both_ways(stem: &[f64]) -> usize {
    let first = |up: f64| stem.windows(2).position(|w| up * (w[1] - w[0]) > 0.0).unwrap_or(stem.len());
    first(1.0).max(first(-1.0))
}
