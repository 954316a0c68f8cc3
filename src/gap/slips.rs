//! The search for the right slips that `analyze` makes, for the base and for every effect that leaves more than noise.
//!
//! It knows the two laws, uneven bands, jumps beyond OP, stops of the stem and a lag before it. What an effect does behind
//! the stem is taken out of PV as the search has it so far, so that slips and effect are found in turn.

use core::cell::RefCell;

use super::coarse::led;
use super::evaluator::Evaluator;
use super::problem::Problem;
use super::search::{MIDDLE, Search, hunt};
use super::structure::{MAX_PARAMS, Parameters};
use crate::ident::candidate::{Candidate as SlipCandidate, Question};
use crate::ident::class::Class;
use crate::ident::fit::Target;
use crate::ident::hunt::{Ground, Rival, Scouted, hunt as follow, scout};
use crate::ident::{ModelChoice, Options};
use crate::signal::stats;
use crate::sim::slips::Law;

/// Starts of an effect that are followed to the end at most, of those that look best.
const FOLLOWED: u64 = 4;
/// Responses that following one to the end and climbing from there computes, about.
pub const FOLLOW: u64 = 45_000;

/// Places for a search with the parameters that belong to them, where other slips than its best ones may fit better, and
/// the responses computed for it; nothing for a stem that knows no friction. With the parameters of the search's best place,
/// or of its first start before it has one.
#[must_use]
pub fn right_slips(problem: &Problem, search: &Search, seed: u64) -> (Vec<Parameters>, u64) {
    let p = search.best.first().map(|b| &b.theta.p).or(search.starts.first());
    let Some(posed) = p.and_then(|p| posed(problem, search, p)) else { return (Vec::new(), 0) };
    let signs = [search.sign];
    posed.follow(&posed.scout(&signs, seed), seed)
}

/// The same for all starts of a search, whatever it has found: each is looked at, the best are followed and climbed
/// with all that the effect has, so that they can be compared; how many, about so many `responses` say.
#[must_use]
pub fn right_slips_of_starts(problem: &Problem, search: &Search, responses: u64, seed: u64) -> (Vec<Parameters>, u64) {
    let signs = [search.sign];
    let search = &Search { best: Vec::new(), ..search.clone() };
    let posed: Vec<Posed> = search.starts.iter().filter_map(|start| posed(problem, search, start)).collect();
    let mut seen: Vec<(&Posed, Scouted<'_>)> = posed.iter().map(|p| (p, p.scout(&signs, seed))).collect();
    seen.sort_by(|a, b| a.1.share().total_cmp(&b.1.share()));
    let looked: u64 = seen.iter().map(|(_, s)| s.looked()).sum();
    let followed = ((responses.saturating_sub(looked) + FOLLOW / 2) / FOLLOW).clamp(1, FOLLOWED) as usize;
    let mut count = seen.iter().skip(followed).map(|(_, s)| s.looked()).sum();
    let mut out = Vec::new();
    for (posed, seen) in seen.iter().take(followed) {
        let (places, n) = posed.follow(seen, seed);
        let mut own = Search { starts: Vec::new(), evaluations: n, ..search.clone() };
        hunt(problem, &mut own, &[], &places, &MIDDLE, seed);
        count += own.evaluations;
        out.extend(own.best.iter().map(|b| b.theta));
    }
    (out, count)
}

/// What is asked, of which law, in front of which process.
struct Posed {
    question: Question,
    law: Law,
    class: Class,
    p: [f64; MAX_PARAMS],
}

fn posed(problem: &Problem, search: &Search, p: &[f64; MAX_PARAMS]) -> Option<Posed> {
    let plan = search.structure.plan_of(p);
    let law = plan.law?;
    let added = match search.best.first() {
        Some(best) => Evaluator::new(problem, search.sign).added(&search.structure, best)?,
        None => Vec::new(),
    };
    let mut question = led(problem, &plan);
    question.stroke = plan.stroke;
    question.landing = plan.landing();
    for (y, a) in question.pv.iter_mut().zip(&added) {
        *y -= a;
    }
    let mean = stats::mean(&question.pv);
    question.pv.iter_mut().for_each(|y| *y -= mean);
    Some(Posed { question, law, class: plan.class(), p: *p })
}

impl Posed {
    /// Calls `job` with the ground that the search of `analyze` is made on.
    fn on_ground<T>(&self, seed: u64, job: impl FnOnce(&Ground<'_>) -> T) -> T {
        let question = &self.question;
        let model = if self.class == Class::Second { ModelChoice::Sopdt } else { ModelChoice::Fopdt };
        let options = Options { model, seed, ..Options::default() };
        let (plain, moves) = (Target::new(&question.pv, 0.0, question.from), Ground::moves_of(question));
        job(&Ground { question, plain: &plain, moves: &moves, options: &options, known: RefCell::default() })
    }

    fn scout<'s>(&self, signs: &'s [f64], seed: u64) -> Scouted<'s> {
        self.on_ground(seed, |ground| scout(ground, self.law, signs))
    }

    /// From what was seen to the best places, and the responses computed, those of the look included.
    fn follow(&self, seen: &Scouted<'_>, seed: u64) -> (Vec<Parameters>, u64) {
        let found = self.on_ground(seed, |ground| follow(ground, seen, Rival::NONE));
        let count = found.iter().map(|f| f.evaluations).sum();
        let of_class = found.iter().filter(|f| f.class == self.class);
        let places = of_class.flat_map(|f| &f.finalists).map(|c| self.theta(c));
        (places.collect(), count)
    }

    fn theta(&self, c: &SlipCandidate) -> Parameters {
        let (question, class, mut p) = (&self.question, self.class, self.p);
        if class == Class::Second {
            // The second lag is the first parameter of the one effect that has it.
            p[0] = c.fit.shape[1];
        }
        Parameters {
            s: c.s,
            j: c.j,
            first: question.first_slip(c.start),
            fd: c.fit.fd,
            log_tau: c.fit.shape[0],
            lag: f64::max(class.lag(&c.fit.shape), question.limits.lag[0]),
            p,
        }
    }
}
