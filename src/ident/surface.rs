//! The error over the plane of friction bands, as the toolbox draws and searches it: for a pair (fs, fd) taken at its
//! word, the mean squared free-run error of the best process of one class (Lee, Ren and Huang 2008, their error map).
//!
//! ```
//! use stictiond::ident::class::Class;
//! use stictiond::ident::surface::{Surface, solve};
//! use stictiond::ident::Options;
//! use stictiond::optim::{AdaptiveRandom, Settings};
//! # use stictiond::record::Record;
//! # use stictiond::sim::{slips::Law, valve::he_step};
//! # let op: Vec<f64> = (0..300).map(|k| 6.0 * (f64::from(k) * 0.1).sin()).collect();
//! # let (mut stem, mut level, mut pv) = (0.0, 0.0, Vec::new());
//! # for &u in &op {
//! #     pv.push(level);
//! #     stem = he_step(stem, u, 2.5, 1.0);
//! #     level += 0.1 * (1.5 * stem - level);
//! # }
//! # let record = Record::uniform(1.0, op, pv);
//! let mut surface = Surface::new(&record, &Options::default(), Law::He, Class::First).expect("signals that move");
//! let found = solve(&mut surface, &AdaptiveRandom, &Settings { budget: 500, fineness_pct: 5.0, seed: 1 });
//! assert!(found.fs + found.fd <= found.s0 && found.mse < surface.mse(0.0, 0.0));
//! ```
//!
//! [`super::quantify`] searches otherwise (whole cells of equal slips at once, fd solved, several views of the error);
//! this surface is what a general solver can be set on, and what an error map shows.

use super::bank::Bank;
use super::candidate::{MIN_SLIPS, Question};
use super::class::{Class, Shape};
use super::fit::{Fitted, Fitter, Freedom, Target};
use super::frictionless;
use super::pose::pose;
use super::quantify::Options;
use super::search::FINE;
use super::sign;
use crate::optim::{Objective, Outcome, Settings, Solver};
use crate::record::Record;
use crate::signal::stats;
use crate::sim::slips::{Law, Sequence};

/// Evaluations that a solver may spend unless told otherwise: the toolbox's own limit.
pub const BUDGET: u64 = 10_000;
/// Gauss-Newton steps for each point, from the best of the bank.
const STEPS: usize = 3;
/// Turns of the stem below which several positions before the record are looked at.
const FEW_REVERSALS: usize = 8;
/// s in spans below which there is no friction.
const NOTHING: f64 = 1e-4;

/// What goes with one pair of bands.
#[derive(Debug, Clone, PartialEq)]
pub struct Point {
    /// Static band, OP units.
    pub fs: f64,
    /// Kinetic band, OP units.
    pub fd: f64,
    /// Mean squared free-run error, PV units squared; infinite where the stem hardly moves.
    pub mse: f64,
    /// Process gain, PV units per OP unit (per second too when integrating).
    pub gain: f64,
    /// Time constants, s, largest first.
    pub time_constants_s: Vec<f64>,
    /// Dead time, s.
    pub dead_time_s: f64,
}

/// The error surface of one record, valve law and class of process.
#[derive(Debug)]
pub struct Surface {
    question: Question,
    target: Target,
    law: Law,
    class: Class,
    signs: Vec<f64>,
    bank: Bank,
    sequence: Sequence,
    fitter: Fitter,
    span: f64,
    deviation: f64,
    ts_s: f64,
    box_samples: f64,
    without: Option<Fitted>,
    evaluations: u64,
}

impl Surface {
    /// The surface of a record; `None` where a signal does not move or under 30 points are there.
    #[must_use]
    pub fn new(record: &Record, options: &Options, law: Law, class: Class) -> Option<Self> {
        let span = stats::span(&record.op_path);
        let deviation = stats::std_dev(&record.pv);
        if record.len() < 30 || !span.is_normal() || !deviation.is_normal() {
            return None;
        }
        let question = pose(record, options, span, deviation);
        let target = Target::new(&question.pv, 0.0, question.from);
        let signs = sign::of_gain(&question.mean, &question.pv).map_or(vec![1.0, -1.0], |s| vec![s]);
        let bank = Bank::new(&question, FINE);
        Some(Self {
            bank,
            signs,
            target,
            question,
            law,
            class,
            span,
            deviation,
            ts_s: record.ts_s,
            box_samples: record.box_samples as f64,
            sequence: Sequence::default(),
            fitter: Fitter::default(),
            without: None,
            evaluations: 0,
        })
    }

    /// Span of OP: `fs + fd` stays at or below it.
    #[must_use]
    pub const fn s0(&self) -> f64 {
        self.span
    }

    /// Class of the process.
    #[must_use]
    pub const fn class(&self) -> Class {
        self.class
    }

    /// Pairs asked for so far.
    #[must_use]
    pub const fn evaluations(&self) -> u64 {
        self.evaluations
    }

    /// Mean squared error of the best process for one pair of bands, PV units squared: infinite where the stem hardly
    /// moves and outside `0 <= fd <= fs, fs + fd <= S0`.
    pub fn mse(&mut self, fs: f64, fd: f64) -> f64 {
        self.fit(fs, fd).map_or(f64::INFINITY, |f| f.sse * self.scale())
    }

    /// The same with the process itself.
    pub fn point(&mut self, fs: f64, fd: f64) -> Option<Point> {
        let fit = self.fit(fs, fd)?;
        let gain = self.class.gain(fit.gain) * self.deviation / self.span;
        let point_s = self.ts_s * self.box_samples;
        Some(Point {
            fs,
            fd,
            mse: fit.sse * self.scale(),
            gain: if self.class.integrates() { gain / point_s } else { gain },
            time_constants_s: self.class.time_constants(&fit.shape).iter().map(|t| t * point_s).collect(),
            dead_time_s: (self.class.lag(&fit.shape) * self.box_samples - 1.0).max(0.0) * self.ts_s,
        })
    }

    /// Squared normalised error to mean squared error in PV units.
    fn scale(&self) -> f64 {
        self.deviation * self.deviation / self.target.y.len().max(1) as f64
    }

    fn fit(&mut self, fs: f64, fd: f64) -> Option<Fitted> {
        self.evaluations += 1;
        let [s, j] = [(fs + fd) / self.span, (fs - fd) / self.span];
        let inside = fd >= 0.0 && fd <= fs && s <= 1.0 + 1e-9;
        if !inside {
            return None;
        }
        if s < NOTHING {
            return self.without();
        }
        let first = self.best_of_starts(s, j, 1);
        if self.sequence.reversals >= FEW_REVERSALS { first } else { better(first, self.best_of_starts(s, j, 3)) }
    }

    /// The best process without friction.
    fn without(&mut self) -> Option<Fitted> {
        if self.without.is_none() {
            let of = |sign: &f64| frictionless::best(&self.question, &self.target, self.class, *sign, 2);
            self.without = self.signs.iter().map(of).fold(None, better);
        }
        self.without
    }

    /// The best fit over `wanted` positions of the stem before the record.
    fn best_of_starts(&mut self, s: f64, j: f64, wanted: usize) -> Option<Fitted> {
        let starts = self.question.starts(0.5 * (s + j), wanted);
        let mut best = None;
        for start in starts {
            let q = &self.question;
            self.sequence.run(self.law, &q.path, q.per_point, s, j, q.first_slip(start));
            if self.sequence.slips >= MIN_SLIPS {
                best = better(best, self.process(0.5 * (s - j)));
            }
        }
        best
    }

    /// The best process behind the valve signal at hand: the bank's best place, then a few steps.
    fn process(&mut self, fd: f64) -> Option<Fitted> {
        let q = &self.question;
        let mut freedom = Freedom { fd: [fd, fd], fd_default: fd, sign: 1.0, limits: q.limits };
        let points = self.bank.points;
        let per_box = |x: &[f64]| crate::signal::detrend::box_means(x, points);
        let boxed = [per_box(&self.sequence.at), per_box(&self.sequence.direction)];
        let glances = self.bank.look(&boxed[0], &boxed[1], &freedom, &self.signs);
        let plain = self.signs.iter().zip(glances).flat_map(|(sign, [plain, _])| plain.map(|glance| (sign, glance)));
        let (sign, glance) = plain.min_by(|a, b| a.1.share.total_cmp(&b.1.share))?;
        freedom.sign = *sign;
        let signal = [&self.sequence.at[..], &self.sequence.direction[..]];
        let first = Class::First.clamp([libm::log(glance.tau), glance.lag, 0.0], &q.limits);
        let mut best: Option<Fitted> = None;
        for shape in starts_of(self.class, &first) {
            let shape = self.class.clamp(shape, &q.limits);
            best = better(best, Some(self.fitter.linear(self.class, &shape, signal, &self.target, &freedom)));
        }
        let best = best?;
        let at = self.fitter.linear(self.class, &best.shape, signal, &self.target, &freedom);
        let fit = self.fitter.improve(self.class, at, signal, &self.target, &freedom, STEPS, [1e-4, f64::INFINITY]);
        (fit.gain != 0.0).then_some(fit)
    }
}

/// Shapes of a class to start from, given the best single lag.
fn starts_of(class: Class, first: &Shape) -> Vec<Shape> {
    let (tau, lag) = (libm::exp(first[0]), first[1]);
    match class {
        Class::First => vec![*first],
        _ => vec![class.start(tau, lag), class.start(0.7 * tau, 0.6 * lag)],
    }
}

fn better(a: Option<Fitted>, b: Option<Fitted>) -> Option<Fitted> {
    match (a, b) {
        (Some(x), Some(y)) => Some(if y.sse < x.sse { y } else { x }),
        (x, y) => x.or(y),
    }
}

impl Objective for Surface {
    fn cost(&mut self, [s, j]: [f64; 2]) -> f64 {
        let (fs, fd) = (0.5 * (s + j) * self.span, 0.5 * (s - j) * self.span);
        self.mse(fs, fd.min(fs))
    }
}

/// What a solver found on a surface, OP and PV units.
#[derive(Debug, Clone, PartialEq)]
pub struct Solved {
    /// Static band.
    pub fs: f64,
    /// Kinetic band.
    pub fd: f64,
    /// Smallest mean squared error, PV units squared; infinite where no model exists.
    pub mse: f64,
    /// Span of OP: `fs + fd <= s0` was enforced.
    pub s0: f64,
    /// How the search went.
    pub outcome: Outcome,
}

impl Solved {
    /// The outcome in OP units.
    #[must_use]
    pub fn of(outcome: Outcome, s0: f64) -> Self {
        let [s, j] = outcome.best;
        Self { fs: 0.5 * (s + j) * s0, fd: 0.5 * (s - j) * s0, mse: outcome.cost, s0, outcome }
    }
}

/// Sets a solver on a surface.
pub fn solve(surface: &mut Surface, solver: &dyn Solver, settings: &Settings) -> Solved {
    let s0 = surface.s0();
    Solved::of(solver.search(surface, settings), s0)
}
