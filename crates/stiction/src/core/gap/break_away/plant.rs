//! The process between stem and PV over a record's points, and its fit to a stem whose slips are known.

use core::ops::Range;

use super::course::{Course, Slip};
use crate::core::gap::model::Process;
use crate::core::gap::types::Fit;
use crate::core::ident::least_squares::Gram;
use crate::core::record::Record;
use crate::core::signal::stats;
use crate::core::sim::process::{Poles, ProcessModel};

/// Steps of the time constants' logarithm by which they are refined, rounds of each, and points of delay for a step of 1.
const FINER: [f64; 4] = [0.3, 0.1, 0.03, 0.01];
const ROUNDS: usize = 3;
const DELAY: f64 = 4.0;
/// Kinetic over static band at least and at most.
const RATIOS: [f64; 2] = [-0.9, 0.95];
/// Kinetic over static band below which a band does not show in where the stem comes to rest.
const LEAST_RATIO: f64 = 0.02;

/// A process behind a stem.
#[derive(Debug, Clone)]
pub(super) struct Plant {
    /// Times in points; its dead time is not used.
    model: ProcessModel,
    /// Points from a move of the stem to its first effect on PV, and the fewest: a sample is held until the next.
    delay: f64,
    least_delay: f64,
    /// Stem at which an integrator rests, OP units.
    rest: f64,
    /// PV less the run at each point, PV units: level, drift, and what the process still does from before.
    pub(super) offset: Vec<f64>,
    /// Kinetic over static band.
    pub(super) ratio: f64,
}

impl Plant {
    /// The process of a fit, with the offset of the fit's prediction.
    pub(super) fn of(fit: &Fit, record: &Record) -> Self {
        let process = &fit.model.process;
        let model = process.in_points(record.point_s());
        let least_delay = 1.0 / record.box_samples as f64;
        let delay = (process.dead_time_s / record.ts_s + 1.0) * least_delay;
        let ratio = fit.model.valve.fd / fit.model.valve.fs;
        let mut plant = Self { model, delay, least_delay, rest: process.op, offset: Vec::new(), ratio };
        let run = plant.run(&fit.valve);
        plant.offset = fit.prediction.iter().zip(&run).map(|(p, run)| p - run).collect();
        plant
    }

    /// Writes its gain and times, in recorded units, into a process.
    pub(super) fn write_to(&self, process: &mut Process, record: &Record) {
        let point_s = record.point_s();
        let ProcessModel { gain, tau, tau2, .. } = self.model;
        process.gain = if process.integrating { gain / point_s } else { gain };
        let both = [tau.max(tau2), tau.min(tau2)];
        process.time_constants_s = both.into_iter().filter(|tau| *tau > 0.0).map(|tau| tau * point_s).collect();
        process.dead_time_s = (self.delay / self.least_delay - 1.0) * record.ts_s;
    }

    /// Whole points of the delay.
    pub(super) fn lag(&self) -> usize {
        self.delay as usize
    }

    /// At rest with a stem.
    pub(super) fn at_rest(&self, stem: f64) -> Poles {
        Poles::at_rest(&self.model, self.delay.fract(), stem - self.rest)
    }

    /// The next value of its run by the stem now and a point before.
    pub(super) fn step(&self, poles: &mut Poles, stem: f64, before: f64) -> f64 {
        poles.step(stem - self.rest, before - self.rest)
    }

    /// Its run over a stem.
    pub(super) fn run(&self, stem: &[f64]) -> Vec<f64> {
        let mut poles = self.at_rest(stem[0]);
        let at = |k: usize| stem[k.saturating_sub(self.lag())];
        (0..stem.len()).map(|k| self.step(&mut poles, at(k), at(k.saturating_sub(1)))).collect()
    }

    /// Its response to a stem that is one OP unit higher at some points, from the first of these to the end of `n` points.
    pub(super) fn pulse_response(&self, points: &Range<usize>, n: usize) -> Vec<f64> {
        let mut poles = Poles::at_rest(&self.model, self.delay.fract(), 0.0);
        let at = |k: usize| f64::from(u8::from(points.contains(&k)));
        let before = |k: usize, back: usize| k.checked_sub(self.lag() + back).map_or(0.0, at);
        (points.start..n).map(|k| poles.step(before(k, 0), before(k, 1))).collect()
    }

    /// PV by a stem, PV units.
    pub(super) fn predicted(&self, stem: &[f64]) -> Vec<f64> {
        self.run(stem).iter().zip(&self.offset).map(|(run, offset)| run + offset).collect()
    }

    /// Fits gain, times, kinetic band and offset to a course's slips, with PV from point `from` on.
    pub(super) fn refit(&mut self, course: &mut Course, pv: &[f64], from: usize) {
        let Some(mut best) = self.fitted(course, pv, from) else { return };
        for by in FINER {
            for _ in 0..ROUNDS {
                let before = best.sse;
                for tried in best.plant.neighbours(by) {
                    if let Some(other) = tried.fitted(course, pv, from).filter(|other| other.sse < best.sse) {
                        best = other;
                    }
                }
                if best.sse >= before {
                    break;
                }
            }
        }
        // A gain of the other sign, or a kinetic band beyond the static one, is no better model.
        if best.gain > 0.0 && (RATIOS[0]..=RATIOS[1]).contains(&best.kinetic) {
            *self = best.settled(course, self.ratio);
        }
    }

    /// Moves each slip's band of a course, in time, between its two forces to where the run meets PV best from point
    /// `from` on.
    pub(super) fn polish(&self, course: &mut Course, pv: &[f64], from: usize) {
        let ratio = self.ratio;
        if ratio.abs() < LEAST_RATIO {
            return;
        }
        let mut left: Vec<f64> = pv.iter().zip(self.predicted(&course.stem)).map(|(pv, p)| pv - p).collect();
        for which in 0..course.slips.len() {
            let rest = course.rest(which);
            let response = self.pulse_response(&rest, pv.len());
            let late = |k: usize| k.max(from).min(pv.len());
            let counted = &response[late(rest.start) - rest.start..];
            let power = stats::dot(counted, counted);
            if power <= 0.0 {
                continue;
            }
            let wanted = stats::dot(counted, &left[late(rest.start)..]) / power;
            let Slip { band, between: [held, broke], .. } = course.slips[which];
            let polished = (band.abs() - wanted * band.signum() / ratio).clamp(held, broke).copysign(band);
            let moved = -ratio * (polished - band);
            course.slips[which].band = polished;
            course.last_band[rest.clone()].fill(polished);
            course.stem[rest.clone()].iter_mut().for_each(|stem| *stem += moved);
            left[rest.start..].iter_mut().zip(&response).for_each(|(left, r)| *left -= moved * r);
        }
    }

    /// The same with one time constant or the delay changed.
    fn neighbours(&self, by: f64) -> Vec<Self> {
        let model = self.model;
        let mut out = Vec::new();
        for up in [by, -by] {
            let longer = libm::exp(up);
            let scaled = [
                ProcessModel { tau: model.tau * longer, ..model },
                ProcessModel { tau2: model.tau2 * longer, ..model },
            ];
            out.extend(scaled.into_iter().filter(|m| *m != model).map(|model| Self { model, ..self.clone() }));
            let delay = self.delay + DELAY * up;
            out.extend((delay >= self.least_delay).then(|| Self { delay, ..self.clone() }));
        }
        out
    }

    /// The coefficients that fit a course best.
    fn fitted(&self, course: &Course, pv: &[f64], from: usize) -> Option<Fitted> {
        let n = pv.len();
        let held = course.op_at_slip(self.ratio);
        let mut columns = vec![self.run(&held), self.run(&course.last_band), vec![1.0; n]];
        let ProcessModel { tau, tau2, integrating, .. } = self.model;
        let decay = |tau: f64| (0..n).map(|k| libm::exp((from as f64 - k.max(from) as f64) / tau)).collect();
        columns.extend([tau, tau2].into_iter().filter(|tau| *tau > 0.0).map(decay));
        if integrating {
            columns.push((0..n).map(|k| k as f64 / n as f64).collect());
        }
        let count = columns.len();
        let mut late: Vec<&[f64]> = columns.iter().map(|column| &column[from..]).collect();
        late.push(&pv[from..]);
        let mut gram = Gram::of(&late);
        gram.eliminate(count);
        let beta = gram.back(count, &[]);
        let sse = gram.at(count, count);
        let usable = sse.is_finite() && beta[..count].iter().all(|b| b.is_finite());
        let beta = beta[..count].to_vec();
        usable.then(|| Fitted { plant: self.clone(), sse, gain: beta[0], kinetic: -beta[1] / beta[0], columns, beta })
    }
}

/// A plant with the coefficients that fit a course best.
struct Fitted {
    plant: Plant,
    sse: f64,
    /// Factor of the gain.
    gain: f64,
    /// Kinetic over static band.
    kinetic: f64,
    columns: Vec<Vec<f64>>,
    beta: Vec<f64>,
}

impl Fitted {
    /// The plant with its coefficients, and the course moved to its kinetic band; `ratio` is the course's own.
    fn settled(self, course: &mut Course, ratio: f64) -> Plant {
        let mut plant = self.plant;
        plant.model.gain *= self.gain;
        plant.ratio = self.kinetic;
        course.stem =
            course.op_at_slip(ratio).iter().zip(&course.last_band).map(|(held, b)| held - plant.ratio * b).collect();
        let run = plant.run(&course.stem);
        let at = |k: usize| -> f64 { self.columns.iter().zip(&self.beta).map(|(column, b)| column[k] * b).sum() };
        plant.offset = run.iter().enumerate().map(|(k, run)| at(k) - run).collect();
        plant
    }
}
