//! The search for the right slips that `analyze` makes, for the base and for every effect that leaves more than noise.
//!
//! It knows the two laws, uneven bands and a lag before the valve. What an effect does behind the stem is taken out of PV
//! as the lane has it so far, so that slips and effect are found in turn.

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

/// Places where a lane's best may be improved upon, by other slips, and the responses computed for it; nothing for a stem
/// that jumps beyond OP or knows no friction.
#[must_use]
pub fn right_slips(scene: &Scene, lane: &Lane, seed: u64) -> (Vec<Gene>, u64) {
    posed(scene, lane).map_or_else(|| (Vec::new(), 0), |p| search(&p, lane.sign, seed))
}

/// What is asked, of which law, in front of which process.
struct Posed {
    question: Question,
    law: Law,
    class: Class,
}

fn posed(scene: &Scene, lane: &Lane) -> Option<Posed> {
    let best = lane.best.first()?;
    let plan = lane.recipe.plan(&best.gene);
    let law = plan.law.filter(|_| !plan.overshoot)?;
    let added = Kernel::new(scene, lane.sign).added(&lane.recipe, best)?;
    let mut question = led(scene, &plan);
    question.uneven = plan.uneven;
    for (y, a) in question.pv.iter_mut().zip(&added) {
        *y -= a;
    }
    let mean = stats::mean(&question.pv);
    question.pv.iter_mut().for_each(|y| *y -= mean);
    let class = if plan.integrating { Class::Integrating } else { Class::First };
    Some(Posed { question, law, class })
}

fn search(posed: &Posed, sign: f64, seed: u64) -> (Vec<Gene>, u64) {
    let Posed { question, law, class } = posed;
    let options = Options { model: ModelChoice::Fopdt, seed, ..Options::default() };
    let (plain, moves) = (Target::new(&question.pv, 0.0, question.from), Ground::moves_of(question));
    let ground = Ground { question, plain: &plain, moves: &moves, options: &options, known: RefCell::default() };
    let found = hunt(&ground, &scout(&ground, *law, &[sign]), Rival::NONE);
    let count = found.iter().map(|f| f.evaluations).sum();
    let of_class = found.iter().filter(|f| f.class == *class);
    let places = of_class.flat_map(|f| &f.finalists).map(|c| Gene {
        s: c.s,
        j: c.j,
        first: question.first_slip(c.start),
        fd: c.fit.fd,
        log_tau: c.fit.shape[0],
        lag: f64::max(class.lag(&c.fit.shape), question.limits.lag[0]),
        p: [0.0; MAX_PARAMS],
    });
    (places.collect(), count)
}
