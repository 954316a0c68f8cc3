//! Data for the pictures of a fit: the model's signals, the error surface over the bands, and the results for another order or
//! another noise realisation.
//!
//! Everything starts from the [`Model`] of an estimate and is recomputed from the record, so a picture can be made of any
//! document. No verdict or interval depends on it.

mod draws;
mod map;

pub use draws::{Optimum, RESAMPLES, RESTARTS};
pub use map::{Cell, ErrorMap};

use crate::core::ident::Model;
use crate::core::ident::Options;
use crate::core::ident::class::Class;
use crate::core::ident::evaluator::{View, lattice_index};
use crate::core::ident::normalised::NormalisedRecord;
use crate::core::ident::slip_search::answer::{EARNED, FITTED_SHARE, held_out};
use crate::core::ident::slip_search::candidate::{Candidate, LatticeFit};
use crate::core::ident::slip_search::evaluator::{Evaluator, Polished, on_whole_record};
use crate::core::ident::slip_search::part::frictionless;
use crate::core::ident::slip_search::problem::{EVEN_STARTS, Problem};
use crate::core::record::Record;
use crate::core::signal::stats;

/// The class of an order.
const fn class_of(order: u8, integrating: bool) -> Class {
    match (order, integrating) {
        (2, false) => Class::Second,
        (2, true) => Class::LagIntegrating,
        (_, false) => Class::First,
        (_, true) => Class::Integrating,
    }
}

/// The model's process with its time constants on the lattice.
fn on_lattice(model: &Model, record: &Record) -> LatticeFit {
    let (places, lag) = (model.taus(record).map(|tau| lattice_index(tau.max(1e-3))), model.lag(record));
    LatticeFit { sse: 0.0, gain: 0.0, fd: 0.0, places, delay: lag as usize, fraction: lag.fract() }
}

/// A model refitted to its record.
#[derive(Debug)]
pub struct FitPlots<'a> {
    record: &'a Record,
    options: Options,
    normalised: NormalisedRecord,
    /// The valve, with the process's time constants on the lattice.
    candidate: Candidate,
    /// The process with its time constants off the lattice.
    process: Polished,
    sign: f64,
    /// Filter of the error that the estimate minimised.
    rho: f64,
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
    /// Refits `model` to its record; `options` are those of the estimate. `None` if a signal is constant or the stem never
    /// slips.
    #[must_use]
    pub fn new(record: &'a Record, options: &Options, model: &Model) -> Option<Self> {
        let (s, j) = (model.fs + model.fd, model.fs - model.fd);
        if s.is_nan() || s <= 0.0 {
            return None;
        }
        let normalised = NormalisedRecord::of(record, options).ok()?;
        let span = normalised.span;
        let (class, sign) = (model.class()?, if model.gain < 0.0 { -1.0 } else { 1.0 });
        let bands = [s / span, j.clamp(0.0, s) / span];
        let told = on_lattice(model, record);
        let (candidate, process) =
            on_whole_record(&Problem::new(&normalised, sign), model.law, class, |evaluator, view| {
                let candidate = refit(evaluator, view, bands, &told)?;
                Some((candidate, evaluator.polish(view, &candidate)?))
            })?;
        Some(Self { record, options: *options, normalised, candidate, process, sign, rho: 0.0 })
    }

    /// The same, with the error map by the error that the estimate minimised, filtered with `1 - rho q^-1`.
    #[must_use]
    pub fn behind(self, rho: f64) -> Self {
        Self { rho, ..self }
    }

    /// Runs `work` with an evaluator of the record.
    fn evaluate<T>(&self, work: impl FnOnce(&mut Evaluator<'_>, &mut View) -> T) -> T {
        on_whole_record(&Problem::new(&self.normalised, self.sign), self.candidate.law, self.candidate.class, work)
    }

    /// Residual of the model from the first valid point on, standard deviations of PV.
    fn residual(&self) -> Vec<f64> {
        self.evaluate(|evaluator, view| evaluator.residual(view, &self.candidate, &self.process))
    }

    /// Span of OP, OP units, the upper limit of fs + fd.
    #[must_use]
    pub const fn span(&self) -> f64 {
        self.normalised.span
    }

    /// Number of valid points.
    fn count(&self) -> f64 {
        self.normalised.pv.len().saturating_sub(self.normalised.from).max(1) as f64
    }

    /// Root mean square, PV units, of a squared error in normalised units.
    fn rms(&self, sse: f64) -> f64 {
        (sse / self.count()).sqrt() * self.normalised.deviation
    }

    /// The model's signals.
    #[must_use]
    pub fn free_run(&self) -> FreeRun {
        let c = &self.candidate;
        let q = &self.normalised;
        let (stem, _) = q.path.stem(c.law, [c.s, c.j], self.process.fd, q.first_slip(c.start));
        let middle = stats::mean(&self.record.op_path);
        let residual: Vec<f64> = self.residual().iter().map(|r| r * self.normalised.deviation).collect();
        let measured = &self.record.pv[q.from.min(self.record.pv.len())..];
        FreeRun {
            from: q.from,
            valve: stem.iter().map(|v| middle + self.normalised.span * v).collect(),
            pv: measured.iter().zip(&residual).map(|(y, r)| y - r).collect(),
            residual,
        }
    }

    /// The candidate with another order, refitted.
    fn in_order(&self, order: u8, evaluator: &mut Evaluator<'_>, view: &mut View) -> Option<Candidate> {
        let own = &self.candidate;
        let class = class_of(order, own.class.integrates());
        let refitted = evaluator.in_class(view, own, class);
        // The first-order model itself, with a negligible second lag.
        let short = lattice_index(self.normalised.limits.tau[0]);
        let fit = LatticeFit { places: [own.fit.places[0], short], ..own.fit };
        let same = (own.class == Class::First && class == Class::Second)
            .then(|| evaluator.settle(view, &Candidate { class, fit, ..*own }))
            .flatten();
        refitted.into_iter().chain(same).min_by(|a, b| a.sse().total_cmp(&b.sse()))
    }

    /// Errors for both orders of the process, with the same valve.
    #[must_use]
    pub fn orders(&self) -> OrderChart {
        let figures = [1, 2].into_iter().filter_map(|order| {
            let (fitted, held_out) = self.evaluate(|evaluator, view| {
                let fitted = self.in_order(order, evaluator, view)?;
                Some((evaluator.polish(view, &fitted)?, held_out(evaluator, 0.0, &fitted)))
            })?;
            let held_out_rms = held_out.sqrt() * self.normalised.deviation;
            held_out_rms.is_finite().then_some(OrderFigures { order, fitted_rms: self.rms(fitted.sse), held_out_rms })
        });
        OrderChart { figures: figures.collect(), fitted_share: FITTED_SHARE, must_remove: EARNED }
    }
}

/// The best candidate with the `bands` (s, j), spans of OP; its process is fitted from `told` and from the process without
/// friction.
fn refit(evaluator: &mut Evaluator<'_>, view: &mut View, [s, j]: [f64; 2], told: &LatticeFit) -> Option<Candidate> {
    let class = evaluator.class;
    let without = frictionless(evaluator, view, class);
    let mut found = Vec::new();
    for start in evaluator.problem.starts(0.5 * (s + j), &EVEN_STARTS) {
        for near in [Some(told), without.as_ref()].into_iter().flatten() {
            found.extend(evaluator.met(view, [s, j], start, near));
        }
    }
    found.into_iter().min_by(|a, b| a.sse().total_cmp(&b.sse()))
}

#[cfg(test)]
mod tests;
