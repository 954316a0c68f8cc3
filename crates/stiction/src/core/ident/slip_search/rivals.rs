//! Errors of rival bands, after refitting their process and slips in the answer's view.

use super::candidate::{Candidate, apart};
use super::evaluator::Evaluator;
use super::local_search::{Nearness, neighbours};
use crate::core::ident::class::Class;
use crate::core::ident::evaluator::View;

/// Candidates refitted, and rounds through the neighbours of each.
const REFITTED: usize = 40;
const ROUNDS: usize = 3;
/// Distance in ln s, and in j over s, from which bands differ from the answer's.
const OTHER_S: f64 = 0.03;
const OTHER_J: f64 = 0.06;
/// Error relative to the answer's from which other bands are ruled out.
const RULED_OUT: f64 = 1.5;

/// All bands that the search kept, refitted to `view` with a process of the answer's class: `seen` under the answer's law, and
/// the `best` of each other law under its own. Best first.
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

/// Whether all `rivals` with bands other than the `answer`'s leave a far larger error; `false` without rivals.
#[must_use]
pub(crate) fn are_ruled_out(answer: &Candidate, rivals: &[Candidate]) -> bool {
    !rivals.is_empty()
        && !rivals.iter().any(|rival| rival.sse() < RULED_OUT * answer.sse() && has_other_bands(rival, answer))
}

fn has_other_bands(a: &Candidate, b: &Candidate) -> bool {
    libm::log(a.s / b.s).abs() > OTHER_S || (a.j - b.j).abs() > OTHER_J * b.s
}
