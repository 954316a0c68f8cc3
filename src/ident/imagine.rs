//! What a record would have looked like behind a valve that sticks more or less than its own.
//!
//! The process that moves PV is taken from the record: the fitted one where a valve was found to stick, else the best
//! one without friction, of the same class. The imagined PV is the recorded one plus that process' answer to the
//! difference between the imagined stem and the stem at hand (OP itself where nothing sticks): noise and disturbances
//! stay as they were. OP stays too, although the controller would have answered: it would have gone farther until the
//! stem moved, so a large band looks larger and moves the stem less often here than it would have done.

use super::again::again;
use super::candidate::{Bench, Effort, MIN_SLIPS, Question, Start};
use super::class::{Class, Scratch};
use super::fit::{Fitted, Target};
use super::frictionless;
use super::hunt::improvement;
use super::pose::pose;
use super::quantify::{Estimate, Options};
use crate::record::Record;
use crate::signal::stats;
use crate::sim::slips::{Law, Sequence};

/// A record and its process, behind which any valve can be imagined.
#[derive(Debug)]
pub struct Imagination<'a> {
    record: &'a Record,
    question: Question,
    class: Class,
    sign: f64,
    process: Fitted,
    /// The stem at hand, spans of OP.
    stem: Vec<f64>,
    span: f64,
    deviation: f64,
}

/// One imagined valve.
#[derive(Debug, Clone)]
pub struct Imagined {
    /// PV behind it, PV units.
    pub pv: Vec<f64>,
    /// s over the robust span of OP.
    pub s_over_span: f64,
    /// Changes of the stem's direction.
    pub reversals: usize,
    /// s and j, spans of OP.
    bands: [f64; 2],
    start: Start,
    target: Target,
}

/// Gauss-Newton steps for the process behind an imagined valve, which starts at the process that made PV.
const STEPS: usize = 6;

impl<'a> Imagination<'a> {
    /// Takes the process at hand out of a record; `estimate` is what [`super::quantify()`] made of it with the same
    /// `options`, and `sticks` whether its valve is taken for real. `None` where no process shows.
    #[must_use]
    pub fn new(record: &'a Record, options: &Options, estimate: &Estimate, sticks: bool) -> Option<Self> {
        let (span, deviation) = (estimate.span, stats::std_dev(&record.pv));
        if record.len() < 30 || !span.is_normal() || !deviation.is_normal() {
            return None;
        }
        let question = pose(record, options, span, deviation);
        let target = Target::new(&question.pv, 0.0, question.from);
        let (class, sign) = (estimate.class, estimate.gain.signum());
        let own = frictionless::best(&question, &target, class, sign, 1)?;
        let (process, stem) =
            if sticks { valve(&question, &target, estimate, own)? } else { (own, question.mean.clone()) };
        (process.gain != 0.0).then_some(Self { record, question, class, sign, process, stem, span, deviation })
    }

    /// Span of OP, OP units, that `s_over_span` is a share of.
    #[must_use]
    pub const fn span(&self) -> f64 {
        self.span
    }

    /// What a valve of He's law with the bands `s` and `j`, OP units, makes of PV. The stem starts at OP's first value.
    /// `None` where OP hardly moves such a stem.
    #[must_use]
    pub fn valve(&self, s: f64, j: f64) -> Option<Imagined> {
        let (s, j) = (s / self.span, j / self.span);
        let question = &self.question;
        let start = question.starts(0.5 * (s + j), 1).first().copied()?;
        let mut sequence = Sequence::default();
        sequence.run(Law::He, &question.path, question.per_point, s, j, question.first_slip(start));
        if sequence.slips < MIN_SLIPS {
            return None;
        }
        let stem = position(&sequence, 0.5 * (s - j));
        let mut moved: Vec<f64> = stem.iter().zip(&self.stem).map(|(new, old)| new - old).collect();
        if self.class.integrates() {
            // The controller would have held the level: no offset for good.
            let offset = stats::mean(&moved);
            moved.iter_mut().for_each(|m| *m -= offset);
        }
        let (mut answer, mut unused) = (Vec::new(), Vec::new());
        let mut work = Scratch::default();
        self.class.respond_pair(&self.process.shape, [&moved, &moved], &mut work, [&mut answer, &mut unused]);
        answer.iter_mut().for_each(|a| *a *= self.process.gain);
        let imagined: Vec<f64> = question.pv.iter().zip(&answer).map(|(pv, a)| pv + a).collect();
        Some(Imagined {
            pv: self.record.pv.iter().zip(&answer).map(|(pv, a)| pv + self.deviation * a).collect(),
            s_over_span: s,
            reversals: sequence.reversals,
            bands: [s, j],
            start,
            target: Target::new(&imagined, 0.0, question.from),
        })
    }

    /// 1 - error with this very valve / error without friction, 0..1; the process is fitted anew to each.
    #[must_use]
    pub fn index(&self, of: &Imagined) -> f64 {
        let [s, j] = of.bands;
        let mut bench = Bench::new(&self.question, Law::He, self.class, &of.target, self.sign);
        let effort = Effort::of(STEPS);
        let with = bench.fit(s, j, of.start, &[self.process.shape], effort);
        let without = frictionless::best(&self.question, &of.target, self.class, self.sign, 1);
        with.zip(without).map_or(0.0, |(with, without)| improvement(with.fit.sse, without.sse))
    }
}

/// Stem positions of a sequence of slips with the kinetic band `fd`.
fn position(sequence: &Sequence, fd: f64) -> Vec<f64> {
    sequence.at.iter().zip(&sequence.direction).map(|(at, direction)| at - fd * direction).collect()
}

/// The process behind the valve that was found, and its stem; the stem's start is looked for again.
fn valve(question: &Question, target: &Target, found: &Estimate, near: Fitted) -> Option<(Fitted, Vec<f64>)> {
    let (s, j) = (found.s / found.span, found.j / found.span);
    let mut bench = Bench::new(question, found.law, found.class, target, found.gain.signum());
    let best = again(&mut bench, [s, j], &[near.shape])?;
    if best.fit.gain == 0.0 || best.fit.sse >= near.sse {
        return None;
    }
    let mut sequence = Sequence::default();
    sequence.run(found.law, &question.path, question.per_point, s, j, question.first_slip(best.start));
    Some((best.fit, position(&sequence, best.fit.fd)))
}
