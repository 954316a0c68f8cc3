//! The search for the right slips that `analyze` makes, for the base and for every effect that leaves more than noise.
//!
//! It knows the two laws, uneven bands, stops of the stem and a lag before it. What an effect does behind the stem is
//! taken out of PV as the lane has it so far, so that slips and effect are found in turn.

use core::cell::RefCell;

use super::coarse::led;
use super::kernel::Kernel;
use super::plan::{Gene, MAX_PARAMS};
use super::scene::Scene;
use super::search::Lane;
use crate::ident::candidate::Question;
use crate::ident::class::Class;
use crate::ident::fit::Target;
use crate::ident::hunt::{Ground, Rival, hunt, scout};
use crate::ident::{ModelChoice, Options};
use crate::signal::stats;
use crate::sim::slips::Law;

/// Places for a lane with the parameters that belong to them, where other slips than its best ones may fit better, and
/// the responses computed for it; nothing for a stem that jumps beyond OP or knows no friction.
#[must_use]
pub fn right_slips(scene: &Scene, lane: &Lane, seed: u64) -> (Vec<Gene>, u64) {
    posed(scene, lane).map_or_else(|| (Vec::new(), 0), |p| search(&p, lane.sign, seed))
}

/// What is asked, of which law, in front of which process.
struct Posed {
    question: Question,
    law: Law,
    class: Class,
    p: [f64; MAX_PARAMS],
}

fn posed(scene: &Scene, lane: &Lane) -> Option<Posed> {
    let best = lane.best.first();
    let p = best.map_or_else(|| lane.starts.first().copied(), |b| Some(b.gene.p))?;
    let plan = lane.recipe.plan_of(&p);
    let law = plan.law.filter(|_| !plan.overshoot)?;
    let added = match best {
        Some(best) => Kernel::new(scene, lane.sign).added(&lane.recipe, best)?,
        None => Vec::new(),
    };
    let mut question = led(scene, &plan);
    question.stroke = plan.stroke;
    for (y, a) in question.pv.iter_mut().zip(&added) {
        *y -= a;
    }
    let mean = stats::mean(&question.pv);
    question.pv.iter_mut().for_each(|y| *y -= mean);
    Some(Posed { question, law, class: plan.class(), p })
}

fn search(posed: &Posed, sign: f64, seed: u64) -> (Vec<Gene>, u64) {
    let Posed { question, law, class, p } = posed;
    let model = if *class == Class::Second { ModelChoice::Sopdt } else { ModelChoice::Fopdt };
    let options = Options { model, seed, ..Options::default() };
    let (plain, moves) = (Target::new(&question.pv, 0.0, question.from), Ground::moves_of(question));
    let ground = Ground { question, plain: &plain, moves: &moves, options: &options, known: RefCell::default() };
    let found = hunt(&ground, &scout(&ground, *law, &[sign]), Rival::NONE);
    let count = found.iter().map(|f| f.evaluations).sum();
    let of_class = found.iter().filter(|f| f.class == *class);
    // The second lag is the first parameter of the one effect that has it.
    let with_second_lag = |log_tau2: f64| {
        let mut p = *p;
        p[0] = log_tau2;
        p
    };
    let places = of_class.flat_map(|f| &f.finalists).map(|c| Gene {
        s: c.s,
        j: c.j,
        first: question.first_slip(c.start),
        fd: c.fit.fd,
        log_tau: c.fit.shape[0],
        lag: f64::max(class.lag(&c.fit.shape), question.limits.lag[0]),
        p: if *class == Class::Second { with_second_lag(c.fit.shape[1]) } else { *p },
    });
    (places.collect(), count)
}
