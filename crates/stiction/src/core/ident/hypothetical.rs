//! Simulates how a healthy valve's record would have looked with a sticking valve.
//!
//! The process is the best one without friction, of the fitted class. The hypothetical PV is the recorded one plus the
//! process's response to the difference between the hypothetical stem and OP: noise and disturbances stay the same. OP stays
//! the same too, although the controller would have reacted: it would have moved OP farther until the stem moved, so here a
//! large band looks larger and moves the stem less often than it would in closed loop.

use super::choice::Options;
use super::class::Class;
use super::evaluator::lattice_tau;
use super::kinetic_band::MIN_SLIPS;
use super::normalised::{NormalisedRecord, Start};
use super::quantify::Estimate;
use super::slip_search::answer::improvement;
use super::slip_search::candidate::LatticeFit;
use super::slip_search::evaluator::on_whole_record;
use super::slip_search::part::frictionless;
use super::slip_search::problem::Problem;
use crate::core::record::Record;
use crate::core::signal::stats;
use crate::core::sim::slips::Law;

/// A record and its process, for simulating any valve in front of it.
#[derive(Debug)]
pub(crate) struct Hypothetical<'a> {
    record: &'a Record,
    normalised: NormalisedRecord,
    class: Class,
    sign: f64,
    process: LatticeFit,
}

/// One hypothetical valve.
#[derive(Debug, Clone)]
pub(crate) struct HypotheticalValve {
    /// PV with this valve, PV units.
    pub pv: Vec<f64>,
    /// s over the robust span of OP.
    pub s_over_span: f64,
    /// Reversals of the stem.
    pub reversals: usize,
    /// s and j, spans of OP.
    bands: [f64; 2],
    start: Start,
    /// The record with that PV.
    normalised: NormalisedRecord,
}

impl<'a> Hypothetical<'a> {
    /// Identifies the process of a record whose valve is assumed healthy; `estimate` comes from [`super::quantify()`] with the
    /// same `options`. `None` if no process is visible.
    #[must_use]
    pub(crate) fn new(record: &'a Record, options: &Options, estimate: &Estimate) -> Option<Self> {
        let normalised = NormalisedRecord::of(record, options).ok()?;
        let (class, sign) = (estimate.class, estimate.gain.signum());
        let process = on_whole_record(&Problem::new(&normalised, sign), Law::He, class, |evaluator, view| {
            frictionless(evaluator, view, class)
        })?;
        (process.gain != 0.0).then_some(Self { record, normalised, class, sign, process })
    }

    /// Span of OP, OP units, to which `s_over_span` refers.
    #[must_use]
    pub(crate) const fn span(&self) -> f64 {
        self.normalised.span
    }

    /// PV with a valve of He's law with the bands `s` and `j`, OP units. The stem starts at OP's first value. `None` if OP
    /// hardly moves such a stem.
    #[must_use]
    pub(crate) fn valve(&self, s: f64, j: f64) -> Option<HypotheticalValve> {
        let (s, j) = (s / self.normalised.span, j / self.normalised.span);
        let normalised = &self.normalised;
        let start = Problem::new(normalised, self.sign).starts(0.5 * (s + j), &[0.0]).first().copied()?;
        let (mut moved, steps) = normalised.path.stem(Law::He, [s, j], 0.5 * (s - j), normalised.first_slip(start));
        if steps.slips < MIN_SLIPS {
            return None;
        }
        moved.iter_mut().zip(&normalised.mean).for_each(|(stem, op)| *stem -= op);
        if self.class.integrates() {
            // The controller would have held the level, so a permanent offset is removed.
            let offset = stats::mean(&moved);
            moved.iter_mut().for_each(|m| *m -= offset);
        }
        let shape = self.class.shape(self.process.places.map(lattice_tau), self.process.lag());
        let mut answer = self.class.respond(&shape, &moved);
        answer.iter_mut().for_each(|a| *a *= self.process.gain);
        let pv = normalised.pv.iter().zip(&answer).map(|(pv, a)| pv + a).collect();
        Some(HypotheticalValve {
            pv: self.record.pv.iter().zip(&answer).map(|(pv, a)| pv + self.normalised.deviation * a).collect(),
            s_over_span: s,
            reversals: steps.reversals,
            bands: [s, j],
            start,
            normalised: NormalisedRecord { pv, ..normalised.clone() },
        })
    }

    /// 1 - error with this exact valve / error without friction, 0..1; each with its own fit of the process.
    #[must_use]
    pub(crate) fn index(&self, of: &HypotheticalValve) -> f64 {
        let mut problem = Problem::new(&of.normalised, self.sign);
        // A small band slips more often than a search would allow.
        problem.moves = [MIN_SLIPS, of.normalised.path.values().len()];
        let index = on_whole_record(&problem, Law::He, self.class, |evaluator, view| {
            let without = frictionless(evaluator, view, self.class)?;
            let with = evaluator.met(view, of.bands, of.start, &self.process)?;
            Some(improvement(with.sse(), without.sse))
        });
        index.unwrap_or(0.0)
    }
}
