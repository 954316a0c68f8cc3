//! Whether other bands explain the record nearly as well, once their process and slips are looked for in the answer's own view.

use super::candidate::{Candidate, apart};
use super::evaluator::Evaluator;
use super::local_search::{Nearness, neighbours};
use crate::ident::evaluator::View;

/// Candidates refitted, and rounds through the neighbours of each.
const REFITTED: usize = 40;
const ROUNDS: usize = 3;
/// Logarithm of s, and j over s, by which other bands differ from the answer's.
const OTHER_S: f64 = 0.03;
const OTHER_J: f64 = 0.06;
/// Error over the answer's that other bands must leave to be ruled out.
const RULED_OUT: f64 = 1.5;

/// Whether all bands that the search held, unlike those of `answer`, leave far more of `view`: `seen` under the answer's law,
/// and the `best` of each law under its own.
pub fn are_ruled_out(
    evaluator: &mut Evaluator<'_>,
    view: &mut View,
    answer: &Candidate,
    seen: &[Candidate],
    best: &[Candidate],
) -> bool {
    let of_law = apart(seen, REFITTED, 0).into_iter().map(|c| Candidate { law: answer.law, ..c });
    let of_other = best.iter().copied().filter(|c| c.law != answer.law);
    let comes_near = of_other.chain(of_law).any(|rival| {
        let refitted = evaluator.in_class(view, &rival, answer.class).filter(|c| c.fit.gain != 0.0);
        refitted.is_some_and(|c| {
            let c = neighbours(evaluator, view, c, ROUNDS, Nearness::USUAL);
            c.sse() < RULED_OUT * answer.sse() && are_other(&c, answer)
        })
    });
    (evaluator.law, evaluator.class) = (answer.law, answer.class);
    !comes_near
}

fn are_other(a: &Candidate, b: &Candidate) -> bool {
    libm::log(a.s / b.s).abs() > OTHER_S || (a.j - b.j).abs() > OTHER_J * b.s
}
