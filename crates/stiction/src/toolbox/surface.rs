//! The error surface over the friction bands, as the toolbox plots and searches it: for an exact pair (fs, fd), the mean
//! squared free-run error of the best process of one class (Lee, Ren and Huang 2008, their error map).
//!
//! [`crate::core::ident::quantify`] searches differently (whole cells of equal slips at once, fd solved, several views of the error). This
//! surface is for general solvers and error maps.

use crate::core::ident::NoFit;
use crate::core::ident::Options;
use crate::core::ident::class::Class;
use crate::core::ident::evaluator::{View, lattice_index, lattice_tau};
use crate::core::ident::normalised::{NormalisedRecord, Start};
use crate::core::ident::sign;
use crate::core::ident::slip_search::candidate::{Candidate, LatticeFit};
use crate::core::ident::slip_search::coarse_scan::CoarseScan;
use crate::core::ident::slip_search::evaluator::Evaluator;
use crate::core::ident::slip_search::part::frictionless;
use crate::core::ident::slip_search::problem::Problem;
use crate::core::optim::{Objective, Outcome, Settings, Solver};
use crate::core::record::Record;
use crate::core::sim::slips::Law;

/// Default budget of a solver, evaluations: the toolbox's own limit.
pub const BUDGET: u64 = 10_000;
/// Initial positions of the stem tried, as shares of the static band from OP's first value; only the first for a stem that
/// reverses often.
const STARTS: [f64; 3] = [0.0, -0.9, 0.9];
const FEW_REVERSALS: usize = 8;
/// s in spans below which the valve counts as frictionless.
const NOTHING: f64 = 1e-4;

/// The best model for one pair of bands.
#[derive(Debug, Clone, PartialEq)]
pub struct Point {
    /// Static band, OP units.
    pub fs: f64,
    /// Kinetic band, OP units.
    pub fd: f64,
    /// Mean squared free-run error, PV units squared; infinite if the stem hardly moves.
    pub mse: f64,
    /// Process gain, PV units per OP unit (also per second if integrating).
    pub gain: f64,
    /// Time constants, s, largest first.
    pub time_constants_s: Vec<f64>,
    /// Dead time, s.
    pub dead_time_s: f64,
}

/// The error surface of one record, valve model and process class.
#[derive(Debug)]
pub struct Surface {
    normalised: NormalisedRecord,
    law: Law,
    class: Class,
    sides: Vec<Side>,
    ts_s: f64,
    box_samples: f64,
    evaluations: u64,
}

/// One sign of the gain.
#[derive(Debug)]
struct Side {
    sign: f64,
    scans: Vec<CoarseScan>,
    view: View,
    without: Option<LatticeFit>,
}

impl Surface {
    /// The surface of a record.
    ///
    /// # Errors
    /// The record cannot be fitted.
    pub fn new(record: &Record, options: &Options, law: Law, class: Class) -> Result<Self, NoFit> {
        Self::of_sign(record, options, (law, class), None, 0.0)
    }

    /// As [`Self::new`], by the error filtered with `1 - rho q^-1`, for a given sign of the gain; without one, both signs are
    /// tried if the record does not show it.
    pub(super) fn of_sign(
        record: &Record,
        options: &Options,
        (law, class): (Law, Class),
        sign: Option<f64>,
        rho: f64,
    ) -> Result<Self, NoFit> {
        let normalised = NormalisedRecord::of(record, options)?;
        let sign = sign.or_else(|| sign::of_gain(&normalised.mean, &normalised.pv));
        let signs = sign.map_or(vec![1.0, -1.0], |s| vec![s]);
        let side = |sign: f64| {
            let problem = Problem::new(&normalised, sign);
            let points = problem.points();
            let mut view = problem.view(rho, points);
            let mut evaluator = Evaluator::new(&problem, law, class, points);
            let without = frictionless(&mut evaluator, &mut view, class).filter(|f| f.gain != 0.0);
            Side { sign, scans: CoarseScan::of(&problem, rho, points), view, without }
        };
        Ok(Self {
            sides: signs.into_iter().map(side).collect(),
            normalised,
            law,
            class,
            ts_s: record.ts_s,
            box_samples: record.box_samples as f64,
            evaluations: 0,
        })
    }

    /// Span of OP, the upper limit of `fs + fd`.
    #[must_use]
    pub const fn s0(&self) -> f64 {
        self.normalised.span
    }

    /// Number of pairs evaluated.
    #[must_use]
    pub const fn evaluations(&self) -> u64 {
        self.evaluations
    }

    /// Mean squared error of the best process for one pair of bands, PV units squared: infinite if the stem hardly moves, and
    /// outside `0 <= fd <= fs, fs + fd <= S0`.
    pub fn mse(&mut self, fs: f64, fd: f64) -> f64 {
        self.fit(fs, fd).map_or(f64::INFINITY, |f| f.sse * self.scale())
    }

    /// The same, including the process.
    pub fn point(&mut self, fs: f64, fd: f64) -> Option<Point> {
        let fit = self.fit(fs, fd)?;
        let gain = self.class.gain(fit.gain) * self.normalised.deviation / self.normalised.span;
        let point_s = self.ts_s * self.box_samples;
        let taus = fit.places.map(lattice_tau);
        Some(Point {
            fs,
            fd,
            mse: fit.sse * self.scale(),
            gain: if self.class.integrates() { gain / point_s } else { gain },
            time_constants_s: taus[..self.class.lags()].iter().map(|t| t * point_s).collect(),
            dead_time_s: (fit.lag() * self.box_samples - 1.0).max(0.0) * self.ts_s,
        })
    }

    /// Factor from the squared normalised error to the mean squared error in PV units.
    fn scale(&self) -> f64 {
        let count = self.sides.first().map_or(1.0, |side| side.view.count());
        self.normalised.deviation * self.normalised.deviation / count.max(1.0)
    }

    fn fit(&mut self, fs: f64, fd: f64) -> Option<LatticeFit> {
        self.evaluations += 1;
        let [s, j] = [(fs + fd) / self.normalised.span, (fs - fd) / self.normalised.span];
        let inside = fd >= 0.0 && fd <= fs && s <= 1.0 + 1e-9;
        if !inside {
            return None;
        }
        let (normalised, law, class) = (&self.normalised, self.law, self.class);
        let fits = self.sides.iter_mut().map(|side| {
            if s < NOTHING { side.without } else { side.fit(normalised, law, class, [s, j]).map(|c| c.fit) }
        });
        fits.flatten().reduce(|a, b| if b.sse < a.sse { b } else { a })
    }
}

impl Side {
    /// The best process for exactly this pair of bands, over the initial positions of the stem.
    fn fit(&mut self, normalised: &NormalisedRecord, law: Law, class: Class, [s, j]: [f64; 2]) -> Option<Candidate> {
        let problem = Problem::new(normalised, self.sign);
        let mut evaluator = Evaluator::new(&problem, law, class, problem.points());
        let mut best: Option<Candidate> = None;
        for (which, start) in problem.starts(0.5 * (s + j), &STARTS).into_iter().enumerate() {
            if which > 0 && evaluator.steps().reversals >= FEW_REVERSALS {
                break;
            }
            let found = self.process(&mut evaluator, [s, j], start).filter(|c| c.fit.gain != 0.0);
            best = found.filter(|f| best.is_none_or(|b| f.sse() < b.sse())).or(best);
        }
        best
    }

    /// The best process behind one valve signal, starting from the best place of the coarse scan.
    fn process(&mut self, evaluator: &mut Evaluator<'_>, [s, j]: [f64; 2], start: Start) -> Option<Candidate> {
        let fd = 0.5 * (s - j);
        let freedom = evaluator.slip(s, j, start)?;
        let freedom = crate::core::ident::kinetic_band::Freedom { fd: [fd; 2], fd_default: fd, ..freedom };
        let seen = self.scans.iter().map(|scan| scan.look(&evaluator.steps().list, &freedom));
        let seen = seen.min_by(|a, b| a.share.total_cmp(&b.share))?;
        let place = lattice_index(seen.tau);
        let near = LatticeFit {
            sse: 0.0,
            gain: 0.0,
            fd,
            places: [place; 2],
            delay: seen.lag as usize,
            fraction: seen.lag.fract(),
        };
        evaluator.at_bands(&mut self.view, [s, j], start, &near, &freedom)
    }
}

impl Objective for Surface {
    fn cost(&mut self, [s, j]: [f64; 2]) -> f64 {
        let (fs, fd) = (0.5 * (s + j) * self.normalised.span, 0.5 * (s - j) * self.normalised.span);
        self.mse(fs, fd.min(fs))
    }
}

/// Result of a solver on a surface, OP and PV units.
#[derive(Debug, Clone, PartialEq)]
pub struct Solved {
    /// Static band.
    pub fs: f64,
    /// Kinetic band.
    pub fd: f64,
    /// Smallest mean squared error, PV units squared; infinite if no model exists.
    pub mse: f64,
    /// Span of OP; the constraint was `fs + fd <= s0`.
    pub s0: f64,
    /// Statistics of the search.
    pub outcome: Outcome,
}

impl Solved {
    /// The result in OP units.
    #[must_use]
    pub fn of(outcome: Outcome, s0: f64) -> Self {
        let [s, j] = outcome.best;
        Self { fs: 0.5 * (s + j) * s0, fd: 0.5 * (s - j) * s0, mse: outcome.cost, s0, outcome }
    }
}

/// Runs a solver on a surface.
pub fn solve(surface: &mut Surface, solver: &dyn Solver, settings: &Settings) -> Solved {
    let s0 = surface.s0();
    Solved::of(solver.search(surface, settings), s0)
}
