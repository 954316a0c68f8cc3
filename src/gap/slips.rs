//! The search of [`crate::ident`] for slips and process, asked for the base and for every effect that leaves more than
//! noise.
//!
//! It knows both laws, uneven bands, jumps beyond OP, stops of the stem and a lag before it, and all classes of process.
//! What an effect does behind the stem is taken out of PV as its search has it so far, so that slips and effect are found
//! in turn. It sees the whole record; what it finds are starts for the fits to the training blocks.

use super::plain::PlainPass;
use super::problem::Problem;
use super::scan::behind_positioner;
use super::search::Search;
use super::structure::{MAX_PARAMS, Parameters};
use crate::ident::ModelChoice;
use crate::ident::class::Class;
use crate::ident::slip_search::candidate::Candidate;
use crate::ident::slip_search::problem::Problem as SlipProblem;
use crate::ident::slip_search::settings::SearchSettings;
use crate::ident::slip_search::stages::{Request, Search as SlipSearch};
use crate::optim;
use crate::signal::stats;

/// Candidates taken from one search.
const TAKEN: usize = 8;
/// Step of its coarse scan's grid, % of OP's span.
const FINENESS_PCT: f64 = 5.0;

/// Starts for a search, with the parameters that belong to them, and evaluations made; nothing for a stem that knows no
/// friction. With the parameters of its best candidate, or of its first start before it has one.
#[must_use]
pub fn search_slips(problem: &Problem, search: &Search, rounds: usize, seed: u64) -> (Vec<Parameters>, u64) {
    let nothing = (Vec::new(), 0);
    let Some(p) = search.best.first().map(|b| b.theta.p).or(search.starts.first().copied()) else { return nothing };
    let plan = search.structure.plan_of(&p);
    let Some(law) = plan.law else { return nothing };
    let mut question = behind_positioner(problem, &plan);
    question.stroke = plan.stroke;
    question.landing = plan.landing();
    if let Some(best) = search.best.first() {
        let Some(added) = PlainPass::new(problem, search.sign).added(&search.structure, best) else { return nothing };
        question.pv.iter_mut().zip(&added).for_each(|(y, a)| *y -= a);
    }
    let mean = stats::mean(&question.pv);
    question.pv.iter_mut().for_each(|y| *y -= mean);
    let class = plan.class();
    let Some(solver) = optim::by_name("contour") else { return nothing };
    let request = Request {
        laws: &[law],
        model: if class == Class::Second { ModelChoice::Sopdt } else { ModelChoice::Fopdt },
        solver,
        fineness_pct: FINENESS_PCT,
        seed,
        rival: f64::INFINITY,
    };
    let mut settings = SearchSettings::usual();
    settings.rounds.truncate(rounds);
    let slip_problem = SlipProblem::new(&question, search.sign);
    let (found, _) = SlipSearch::new(&slip_problem, &request, &settings).run();
    let mut all: Vec<&Candidate> = found.best.iter().chain(&found.seen).filter(|c| c.class == class).collect();
    all.sort_by(|a, b| a.sse().total_cmp(&b.sse()));
    // The best of each law first, whatever part of the record the others were fitted to.
    let mut starts: Vec<Parameters> =
        found.best.iter().filter(|c| c.class == class).map(|c| at(search, &question, c, p)).collect();
    for candidate in all {
        let theta = at(search, &question, candidate, p);
        if starts.len() < TAKEN && !starts.contains(&theta) {
            starts.push(theta);
        }
    }
    (starts, found.evaluations)
}

/// The parameter vector of a candidate.
fn at(
    search: &Search,
    question: &crate::ident::candidate::Question,
    c: &Candidate,
    p: [f64; MAX_PARAMS],
) -> Parameters {
    let taus = c.taus();
    let mut theta = Parameters {
        s: c.s,
        j: c.j,
        first: question.first_slip(c.start),
        fd: c.fit.fd,
        log_tau: if c.class.integrates() { 0.0 } else { libm::log(taus[0]) },
        lag: c.fit.lag().max(question.limits.lag[0]),
        p,
    };
    if c.class == Class::Second {
        search.structure.set_second_lag(&mut theta, libm::log(taus[1]));
    }
    theta
}
