//! Data for the pictures of a fit: the model's signals, the error surface over the bands, and the results for another order or
//! another noise realisation.
//!
//! Everything starts from the [`Model`] of an estimate and is recomputed from the record, so a picture can be made of any
//! document. No verdict or interval depends on it.

mod draws;
mod map;

pub use draws::{Optimum, RESAMPLES, RESTARTS};
pub use map::{Cell, ErrorMap};

use super::candidate::{Candidate, CandidateFitter, Effort, NormalisedRecord};
use super::choice::Options;
use super::class::{Class, Shape};
use super::fit::Target;
use super::frictionless;
use super::normalise::normalise;
use super::quantify::Estimate;
use super::slip_search::answer::{EARNED, FITTED_SHARE};
use crate::record::Record;
use crate::signal::stats;
use crate::sim::slips::{Law, Sequence};

/// Gauss-Newton steps for each first position of the stem.
const GAUSS_NEWTON_STEPS: usize = 6;
/// First positions of the stem that are tried.
const STEM_STARTS: usize = 9;

/// Valve and process of an estimate.
#[derive(Debug, Clone, PartialEq)]
pub struct Model {
    /// Valve model.
    pub law: Law,
    /// Order of the process, 1 or 2.
    pub order: u8,
    /// Whether the process is integrating.
    pub integrating: bool,
    /// Dead band plus stick band, OP units.
    pub s: f64,
    /// Slip jump, OP units.
    pub j: f64,
    /// Process gain; only its sign is used here.
    pub gain: f64,
    /// Time constants, s, largest first.
    pub time_constants_s: Vec<f64>,
    /// Dead time, s.
    pub dead_time_s: f64,
}

impl From<&Estimate> for Model {
    fn from(e: &Estimate) -> Self {
        Self {
            law: e.law,
            order: e.class.order(),
            integrating: e.class.integrates(),
            s: e.s,
            j: e.j,
            gain: e.gain,
            time_constants_s: e.time_constants_s.clone(),
            dead_time_s: e.dead_time_s,
        }
    }
}

/// The class of an order.
const fn class_of(order: u8, integrating: bool) -> Class {
    match (order, integrating) {
        (2, false) => Class::Second,
        (2, true) => Class::LagIntegrating,
        (_, false) => Class::First,
        (_, true) => Class::Integrating,
    }
}

impl Model {
    /// Shape of the process, points.
    fn shape(&self, record: &Record) -> Shape {
        let class = class_of(self.order, self.integrating);
        let mut shape = [0.0; 3];
        for (slot, tau) in shape.iter_mut().zip(&self.time_constants_s) {
            *slot = libm::log((tau / record.point_s()).max(1e-3));
        }
        shape[class.shape_len() - 1] = (self.dead_time_s / record.ts_s + 1.0) / record.box_samples as f64;
        shape
    }
}

/// A model refitted to its record.
#[derive(Debug)]
pub struct FitPlots<'a> {
    record: &'a Record,
    options: Options,
    normalised: NormalisedRecord,
    target: Target,
    candidate: Candidate,
    law: Law,
    class: Class,
    sign: f64,
    span: f64,
    deviation: f64,
}

/// The free run of a model: its response to OP without feedback from PV.
#[derive(Debug, Clone, PartialEq)]
pub struct FreeRun {
    /// First valid point: before it, the unknown past of the stem matters.
    pub from: usize,
    /// Stem position, OP units, at every point of the record.
    pub valve: Vec<f64>,
    /// PV of the model, PV units, starting at `from`.
    pub pv: Vec<f64>,
    /// Measured PV minus that, PV units, starting at `from`.
    pub residual: Vec<f64>,
}

/// Fit of one process order.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OrderFigures {
    /// 1 or 2.
    pub order: u8,
    /// Root mean squared free-run error on the whole fitted record, PV units.
    pub fitted_rms: f64,
    /// The same on the last part of the record, with the process fitted to the part before.
    pub held_out_rms: f64,
}

/// The figures for choosing the order.
#[derive(Debug, Clone, PartialEq)]
pub struct OrderChart {
    /// First order, then second.
    pub figures: Vec<OrderFigures>,
    /// Share of the record used by held-out fits.
    pub fitted_share: f64,
    /// Share of the held-out squared error by which the second lag must reduce it.
    pub must_remove: f64,
}

impl<'a> FitPlots<'a> {
    /// Refits `model` to its record; `options` are those of the estimate. `None` if a signal is constant or the stem never slips.
    #[must_use]
    pub fn new(record: &'a Record, options: &Options, model: &Model) -> Option<Self> {
        let (span, deviation) = (stats::span(&record.op_path), stats::std_dev(&record.pv));
        if record.len() < 30 || !span.is_normal() || !deviation.is_normal() || model.s.is_nan() || model.s <= 0.0 {
            return None;
        }
        let normalised = normalise(record, options, span, deviation);
        let target = Target::new(&normalised.pv, 0.0, normalised.from);
        let class = class_of(model.order, model.integrating);
        let (law, sign) = (model.law, if model.gain < 0.0 { -1.0 } else { 1.0 });
        let told = class.clamp(model.shape(record), &normalised.limits);
        let plain = frictionless::best(&normalised, &target, class, sign, 1).map_or(told, |f| f.shape);
        let bands = [model.s / span, model.j.clamp(0.0, model.s) / span];
        let candidate =
            refit(&mut CandidateFitter::new(&normalised, law, class, &target, sign), bands, &[told, plain])?;
        Some(Self { record, options: *options, normalised, target, candidate, law, class, sign, span, deviation })
    }

    fn fits(&self, class: Class) -> CandidateFitter<'_> {
        CandidateFitter::new(&self.normalised, self.law, class, &self.target, self.sign)
    }

    /// Span of OP, OP units, the upper limit of fs + fd.
    #[must_use]
    pub const fn span(&self) -> f64 {
        self.span
    }

    /// Number of valid points.
    fn count(&self) -> f64 {
        self.target.y.len().max(1) as f64
    }

    /// Root mean square, PV units, of a squared error in normalised units.
    fn rms(&self, sse: f64) -> f64 {
        (sse / self.count()).sqrt() * self.deviation
    }

    /// The model's signals.
    #[must_use]
    pub fn free_run(&self) -> FreeRun {
        let c = &self.candidate;
        let residual = self.fits(self.class).residual(c);
        let mut sequence = Sequence::default();
        let q = &self.normalised;
        sequence.run(self.law, &q.path, q.per_point, c.s, c.j, q.first_slip(c.start));
        let middle = stats::mean(&self.record.op_path);
        let stem = sequence.at.iter().zip(&sequence.direction).map(|(at, direction)| at - c.fit.fd * direction);
        let residual: Vec<f64> = residual.iter().map(|r| r * self.deviation).collect();
        let measured = &self.record.pv[q.from.min(self.record.pv.len())..];
        FreeRun {
            from: q.from,
            valve: stem.map(|v| middle + self.span * v).collect(),
            pv: measured.iter().zip(&residual).map(|(y, r)| y - r).collect(),
            residual,
        }
    }

    /// The candidate with another order, refitted.
    fn in_order(&self, order: u8) -> Option<Candidate> {
        let class = class_of(order, self.class.integrates());
        let mut fits = self.fits(class);
        let mut shapes = vec![self.shape_in(class)];
        if class == Class::Second && self.class == Class::First {
            // The first order itself, with a second lag too short to matter.
            let shape = &self.candidate.fit.shape;
            shapes.push([shape[0], libm::log(self.normalised.limits.tau[0]), shape[1] - self.normalised.limits.tau[0]]);
        }
        let settled = shapes.into_iter().filter_map(|shape| {
            let mut start = self.candidate;
            start.fit.shape = class.clamp(shape, &self.normalised.limits);
            fits.settle(&start)
        });
        settled.min_by(|a, b| a.fit.sse.total_cmp(&b.fit.sse))
    }

    /// The candidate's shape in another class of the same family.
    fn shape_in(&self, class: Class) -> Shape {
        let shape = &self.candidate.fit.shape;
        match (self.class.order(), class.order()) {
            (1, 2) if self.class.integrates() => class.start(self.normalised.period, self.class.lag(shape)),
            (1, 2) => class.start(libm::exp(shape[0]), self.class.lag(shape)),
            (2, 1) => reduced(self.class, class, shape),
            _ => *shape,
        }
    }

    /// The figures for either order of the process, with the same valve.
    #[must_use]
    pub fn orders(&self) -> OrderChart {
        let figures = [1, 2].into_iter().filter_map(|order| {
            let fitted = self.in_order(order)?;
            let mut fits = self.fits(class_of(order, self.class.integrates()));
            let held_out = fits.held_out(&fitted, FITTED_SHARE);
            let held_out_rms = held_out.sqrt() * self.deviation;
            held_out_rms.is_finite().then_some(OrderFigures {
                order,
                fitted_rms: self.rms(fitted.fit.sse),
                held_out_rms,
            })
        });
        OrderChart { figures: figures.collect(), fitted_share: FITTED_SHARE, must_remove: EARNED }
    }
}

/// The best candidate with the bands (s, j), spans of OP, its process fitted from the best of `shapes`.
fn refit(fits: &mut CandidateFitter<'_>, [s, j]: [f64; 2], shapes: &[Shape]) -> Option<Candidate> {
    let effort = Effort::of(GAUSS_NEWTON_STEPS);
    let mut best: Option<Candidate> = None;
    for start in fits.normalised.starts(0.5 * (s + j), STEM_STARTS) {
        let fitted = fits.fit(s, j, start, shapes, effort);
        if let Some(fitted) = fitted.filter(|f| best.is_none_or(|b| f.fit.sse < b.fit.sse)) {
            best = Some(fitted);
        }
    }
    fits.settle(&best?)
}

/// The simpler class' shape whose lag takes the place of the second lag.
fn reduced(class: Class, simpler: Class, shape: &Shape) -> Shape {
    let lost = libm::exp(shape[if class == Class::Second { 1 } else { 0 }]);
    simpler.start(libm::exp(shape[0]), class.lag(shape) + lost)
}

#[cfg(test)]
mod tests;
