//! Straight looks along one parameter of an effect, far beyond where steps lead: what else the model trades for it goes
//! along, so that the look stays in the valley.

use rand_chacha::ChaCha8Rng;

use super::effects::Unit;
use super::evaluator::{Candidate, Evaluator};
use super::moves::clamped;
use super::problem::View;
use super::structure::{Parameters, Structure};
use crate::ident::search::normal;

/// Looks along one parameter.
const LOOKS: usize = 120;
/// By how much the bands are shaken at every other look, as a share: slips are right within less than a hundredth only.
const SHAKEN: f64 = 0.01;
/// Looks that are kept of each measure.
const KEPT: usize = 2;

/// Places beside `from` where one parameter is quite another, the best of each parameter by PV and by its differences.
pub fn scan(
    evaluator: &mut Evaluator<'_>,
    structure: &Structure,
    from: &Candidate,
    rng: &mut ChaCha8Rng,
) -> Vec<Parameters> {
    let mut out = Vec::new();
    for (i, param) in structure.params().enumerate() {
        if param.unit == Unit::Choice {
            continue;
        }
        let [low, high] = param.bounds(evaluator.problem);
        let mut seen: [Vec<Candidate>; 2] = [Vec::new(), Vec::new()];
        for k in 0..LOOKS {
            let value = low + (high - low) * (k as f64 + 0.5) / LOOKS as f64;
            let mut theta = from.theta;
            let by = value - theta.p[i];
            theta.p[i] = value;
            structure.trade(&mut theta, i, by, evaluator.problem.question.rate);
            if k % 2 == 1 {
                theta.s *= 1.0 + SHAKEN * normal(rng);
            }
            let theta = clamped(structure, theta, evaluator.problem);
            for (seen, view) in seen.iter_mut().zip([View::Plain, View::Moves]) {
                seen.extend(evaluator.evaluate(structure, &theta, view));
            }
        }
        for mut seen in seen {
            seen.sort_by(|a, b| a.sse.total_cmp(&b.sse));
            let far = |s: &Candidate| (s.theta.p[i] - from.theta.p[i]).abs() > 0.02 * (high - low);
            out.extend(seen.iter().filter(|s| far(s)).take(KEPT).map(|s| s.theta));
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gap::effects;
    use crate::gap::evaluator::tests::made_by;
    use crate::ident::search::generator;
    use crate::sim::slips::Law;

    #[test]
    fn play_far_from_where_the_search_stands_is_seen() {
        let structure = Structure::with(Some(Law::He), effects::by_id("backlash").unwrap());
        let (problem, truth) = made_by(&structure, [0.15, 0.0, 0.0, 0.0, 0.0, 0.0]);
        let mut evaluator = Evaluator::new(&problem, 1.0);
        // Most of the play taken for dead band.
        let mut theta = truth;
        theta.p[0] = 0.02;
        let by = theta.p[0] - truth.p[0];
        structure.trade(&mut theta, 0, by, problem.question.rate);
        let from = evaluator.evaluate(&structure, &theta, View::Plain).unwrap();
        let found = scan(&mut evaluator, &structure, &from, &mut generator(1, 1));
        let best = found.iter().filter_map(|g| evaluator.evaluate(&structure, g, View::Plain));
        let best = best.min_by(|a, b| a.sse.total_cmp(&b.sse)).unwrap();
        assert!((best.theta.p[0] - 0.15).abs() < 0.02 && best.sse < 0.2 * from.sse, "{best:?} {from:?}");
    }
}
