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
            let mut gene = from.gene;
            gene.p[i] = 1.0 - gene.p[i].round();
            out.push(gene);
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
