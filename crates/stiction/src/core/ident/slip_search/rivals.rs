//! What other bands leave of the record, once their process and slips are looked for in the answer's own view.

use super::candidate::{Candidate, apart};
use super::evaluator::Evaluator;
use super::local_search::{Nearness, neighbours};
use crate::core::ident::class::Class;
use crate::core::ident::evaluator::View;

/// Candidates refitted, and rounds through the neighbours of each.
const REFITTED: usize = 40;
const ROUNDS: usize = 3;
/// Logarithm of s, and j over s, by which other bands differ from the answer's.
const OTHER_S: f64 = 0.03;
const OTHER_J: f64 = 0.06;
/// Error over the answer's that other bands must leave to be ruled out.
const RULED_OUT: f64 = 1.5;

/// All bands that the search held, `seen` under the answer's law and the `best` of each other law under its own, refitted to
/// `view` with a process of the answer's class; best first.
pub(crate) fn refitted(
    evaluator: &mut Evaluator<'_>,
    view: &mut View,
    answer: &Candidate,
    class: Class,
    seen: &[Candidate],
    best: &[Candidate],
) -> Vec<Candidate> {
    let of_law = apart(seen, REFITTED, 0).into_iter().map(|c| Candidate { law: answer.law, ..c });
    let of_other = best.iter().copied().filter(|c| c.law != answer.law);
    let mut found: Vec<Candidate> = of_other
        .chain(of_law)
        .filter_map(|rival| {
            let rival = evaluator.in_class(view, &rival, class).filter(|c| c.fit.gain != 0.0)?;
            Some(neighbours(evaluator, view, rival, ROUNDS, Nearness::USUAL))
        })
        .collect();
    found.sort_by(|a, b| a.sse().total_cmp(&b.sse()));
    found
}

/// Whether all of the `rivals` that have other bands than the `answer` leave far more than it; not without rivals.
#[must_use]
pub(crate) fn are_ruled_out(answer: &Candidate, rivals: &[Candidate]) -> bool {
    !rivals.is_empty()
        && !rivals.iter().any(|rival| rival.sse() < RULED_OUT * answer.sse() && has_other_bands(rival, answer))
}

fn has_other_bands(a: &Candidate, b: &Candidate) -> bool {
    libm::log(a.s / b.s).abs() > OTHER_S || (a.j - b.j).abs() > OTHER_J * b.s
}
