//! State of a round of the search, and the process without friction as its baseline.

use super::candidate::{Candidate, LatticeFit, apart};
use super::coarse_scan::CoarseScan;
use super::evaluator::Evaluator;
use super::scan::Scan;
use rand_chacha::ChaCha8Rng;

use super::local_search::{Nearness, along_ridge, random_steps};
use crate::core::ident::class::Class;
use crate::core::ident::evaluator::{View, lattice_index};
use crate::core::ident::kinetic_band::Freedom;

/// Candidates converted together to another class.
pub(super) const FOLLOWERS: usize = 8;

/// The best process of a class driven by OP itself, starting from the best of many time constants and dead times of a single
/// lag.
pub(crate) fn frictionless(evaluator: &mut Evaluator<'_>, view: &mut View, class: Class) -> Option<LatticeFit> {
    let problem = evaluator.problem;
    let normalised = problem.normalised;
    evaluator.class = class;
    evaluator.follow_op();
    let freedom = Freedom { fd: [0.0; 2], fd_default: 0.0, sign: problem.sign, limits: normalised.limits };
    let scans = CoarseScan::of(problem, view.rho(), evaluator.points);
    let seen = scans.iter().map(|scan| scan.look(&evaluator.steps().list, &freedom));
    let seen = seen.min_by(|a, b| a.share.total_cmp(&b.share))?;
    let starts = match class {
        Class::First | Class::Integrating => [Some(([seen.tau; 2], seen.lag)), None],
        Class::Second => [
            Some(([seen.tau, 0.3 * seen.tau], seen.lag - 0.2 * seen.tau.min(seen.lag))),
            Some(([seen.tau, 0.25 * seen.lag.max(1.0)], 0.75 * seen.lag)),
        ],
        Class::LagIntegrating => [Some(([0.5 * seen.lag.max(1.0); 2], 0.6 * seen.lag)), None],
    };
    let fits = starts.into_iter().flatten().map(|(taus, lag)| {
        let lag = lag.max(normalised.limits.lag[0]);
        let places = taus.map(|t| lattice_index(t.max(0.3)));
        let start = LatticeFit { sse: 0.0, gain: 0.0, fd: 0.0, places, delay: lag as usize, fraction: lag.fract() };
        evaluator.settle_fit(view, &start, &freedom)
    });
    fits.reduce(|a, b| if b.sse < a.sse { b } else { a })
}

/// State of a round for one law while it searches a part of the record.
pub(super) struct Part<'a> {
    pub points: usize,
    pub view: View,
    /// The plain view of the same part.
    pub head: Option<View>,
    pub evaluator: Evaluator<'a>,
    pub held: Vec<Candidate>,
}

/// Candidates whose ridges are searched, how far (share of s), and in how many steps per side.
const ON_RIDGES: (usize, f64, usize) = (4, 0.12, 16);

impl Part<'_> {
    /// Moves the best candidates to the best place along their ridges.
    pub(crate) fn look_along_ridges(&mut self) {
        let (count, reach, steps) = ON_RIDGES;
        for c in self.held.iter_mut().take(count) {
            let found = along_ridge(&mut self.evaluator, &mut self.view, c, reach, steps);
            if let Some(best) = found.first() {
                *c = *best;
            }
        }
        self.held = apart(&self.held, usize::MAX, 0);
    }

    /// Converts all candidates to another class and adds one that was found in it.
    pub(crate) fn move_to(&mut self, class: Class, found: &Candidate) {
        let from: Vec<Candidate> = self.held.iter().take(FOLLOWERS).copied().collect();
        let moved = from.iter().chain([found]).filter_map(|c| self.evaluator.in_class(&mut self.view, c, class));
        let moved: Vec<Candidate> = moved.filter(|c| c.fit.gain != 0.0).collect();
        if !moved.is_empty() {
            self.held = apart(&moved, usize::MAX, 0);
        }
    }
}

/// Results of a round for one law.
pub(super) struct LawRound<'a> {
    pub part: Part<'a>,
    pub rng: ChaCha8Rng,
    /// The coarse scan of the part, with its pool.
    pub scan: Scan,
    /// The next stage.
    pub stage: usize,
    /// Candidates on the whole record.
    pub finals: Vec<Candidate>,
    /// Candidates of the part that were carried to the whole record.
    pub tested: Vec<Candidate>,
    /// Whether further stages are worthwhile.
    pub open: bool,
    /// Whether the best candidate leaves only noise.
    pub is_noise: bool,
    /// Whether hardly any friction is visible.
    pub faint: bool,
    /// Stages without gain.
    pub stale: usize,
    /// Error of the part without friction, once computed.
    pub without: Option<f64>,
}

impl<'a> LawRound<'a> {
    pub(crate) fn new(part: Part<'a>, rng: ChaCha8Rng, scan: Scan) -> Self {
        let (finals, tested) = (Vec::new(), Vec::new());
        let (open, is_noise, faint) = (true, false, false);
        Self { part, rng, scan, stage: 0, finals, tested, open, is_noise, faint, stale: 0, without: None }
    }

    /// Least error on the whole record so far.
    pub(crate) fn least(&self) -> f64 {
        self.finals.iter().map(Candidate::sse).fold(f64::INFINITY, f64::min)
    }

    /// Random steps for the best candidates of the part, `count` of them after the first `skip`.
    pub(crate) fn refine(&mut self, stage: usize, [count, skip]: [usize; 2], steps: usize, near: Nearness) {
        let part = &mut self.part;
        part.held.sort_by(|a, b| a.sse().total_cmp(&b.sse()));
        if stage == 2 {
            part.look_along_ridges();
        }
        if stage > 0 {
            part.held.truncate(count);
        }
        for c in part.held.iter_mut().skip(skip).take(count) {
            *c = random_steps(&mut part.evaluator, &mut part.view, *c, steps, near, &mut self.rng);
        }
        part.held = apart(&part.held, usize::MAX, 0);
    }
}
