//! Straight looks along one parameter of an effect, far beyond where steps lead: what else the model trades for it goes
//! along, so that the look stays in the valley.

use rand_chacha::ChaCha8Rng;

use super::effects::Unit;
use super::kernel::{Kernel, Scored};
use super::moves::clamped;
use super::plan::{Gene, Recipe};
use super::scene::View;
use crate::ident::search::normal;

/// Looks along one parameter.
const LOOKS: usize = 120;
/// By how much the bands are shaken at every other look, as a share: slips are right within less than a hundredth only.
const SHAKEN: f64 = 0.01;
/// Looks that are kept of each measure.
const KEPT: usize = 2;

/// Places beside `from` where one parameter is quite another, the best of each parameter by PV and by its differences.
pub fn scan(kernel: &mut Kernel<'_>, recipe: &Recipe, from: &Scored, rng: &mut ChaCha8Rng) -> Vec<Gene> {
    let mut out = Vec::new();
    for (i, param) in recipe.params().enumerate() {
        if param.unit == Unit::Choice {
            continue;
        }
        let [low, high] = param.bounds(kernel.scene);
        let mut seen: [Vec<Scored>; 2] = [Vec::new(), Vec::new()];
        for k in 0..LOOKS {
            let value = low + (high - low) * (k as f64 + 0.5) / LOOKS as f64;
            let mut gene = from.gene;
            let by = value - gene.p[i];
            gene.p[i] = value;
            recipe.trade(&mut gene, i, by, kernel.scene.question.rate);
            if k % 2 == 1 {
                gene.s *= 1.0 + SHAKEN * normal(rng);
            }
            let gene = clamped(recipe, gene, kernel.scene);
            for (seen, view) in seen.iter_mut().zip([View::Plain, View::Moves]) {
                seen.extend(kernel.evaluate(recipe, &gene, view));
            }
        }
        for mut seen in seen {
            seen.sort_by(|a, b| a.sse.total_cmp(&b.sse));
            let far = |s: &Scored| (s.gene.p[i] - from.gene.p[i]).abs() > 0.02 * (high - low);
            out.extend(seen.iter().filter(|s| far(s)).take(KEPT).map(|s| s.gene));
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gap::effects;
    use crate::gap::kernel::tests::made_by;
    use crate::ident::search::generator;
    use crate::sim::slips::Law;

    #[test]
    fn play_far_from_where_the_search_stands_is_seen() {
        let recipe = Recipe::with(Some(Law::He), effects::by_id("backlash").unwrap());
        let (scene, truth) = made_by(&recipe, [0.15, 0.0, 0.0, 0.0, 0.0, 0.0]);
        let mut kernel = Kernel::new(&scene, 1.0);
        // Most of the play taken for dead band.
        let mut gene = truth;
        gene.p[0] = 0.02;
        let by = gene.p[0] - truth.p[0];
        recipe.trade(&mut gene, 0, by, scene.question.rate);
        let from = kernel.evaluate(&recipe, &gene, View::Plain).unwrap();
        let found = scan(&mut kernel, &recipe, &from, &mut generator(1, 1));
        let best = found.iter().filter_map(|g| kernel.evaluate(&recipe, g, View::Plain));
        let best = best.min_by(|a, b| a.sse.total_cmp(&b.sse)).unwrap();
        assert!((best.gene.p[0] - 0.15).abs() < 0.02 && best.sse < 0.2 * from.sse, "{best:?} {from:?}");
    }
}
