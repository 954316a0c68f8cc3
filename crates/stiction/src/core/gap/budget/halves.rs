//! What the halves of a record say of an effect that was found in the whole.
//!
//! A drift, a bend, a sinusoid or another loop's load must be in both. A step, a ramp or wild values are local: the half around
//! them must show them by itself, and a noise model fitted to the rest of the record must predict the half better with them
//! than without. A free run that drives the noise model was fitted to all of the record.

use super::search::{Model, Searched};
use super::shapes::Shape;
use crate::core::gap::noise::arx::{Design, Fit, START};

/// Nats that an effect of a given size gains at least where its noise model was fitted elsewhere.
const LEAST_HELD_OUT: f64 = 3.0;
/// Largest angle between a sinusoid's phases in the two halves, as its cosine.
const LEAST_COSINE: f64 = 0.5;
/// Ratio of two sizes of one effect from which they contradict each other.
pub(in crate::core::gap) const MOST_RATIO: f64 = 3.0;

/// A stretch of points, and its complement.
#[derive(Debug, Clone, Copy)]
struct Stretch {
    from: usize,
    to: usize,
}

impl Stretch {
    fn holds(self, k: usize) -> bool {
        (self.from..self.to).contains(&k)
    }
}

/// Whether the halves confirm an effect of the search.
#[must_use]
pub(crate) fn confirm(model: &Model, searched: &Searched, effect: usize) -> bool {
    let n = model.design.y.len();
    let halves = [Stretch { from: 0, to: n / 2 }, Stretch { from: n / 2, to: n }];
    let one = Judged { model, searched, effect };
    match &searched.added[effect].shape {
        Shape::Drift | Shape::Bend | Shape::Sinusoid(_) | Shape::Neighbour(..) => {
            let found = halves.map(|half| one.found(half));
            matches!(found, [Some(first), Some(second)] if agree(&first, &second))
        }
        Shape::Step(at) => one.local(around(*at, n)),
        Shape::Pulse(at, length) => one.local(around(at + length / 2, n)),
        Shape::Ramp(from) => one.local(around((from + n) / 2, n)),
        Shape::Outliers(at) => {
            let most = halves.into_iter().max_by_key(|half| at.iter().filter(|k| half.holds(**k)).count());
            most.is_some_and(|half| one.local(half))
        }
    }
}

/// Half of a record around a point.
fn around(at: usize, n: usize) -> Stretch {
    let from = at.saturating_sub(n / 4).min(n - n / 2);
    Stretch { from, to: from + n / 2 }
}

/// Whether two halves show one effect: same direction, sizes within a factor.
fn agree(first: &[f64], second: &[f64]) -> bool {
    let product = |x: &[f64], y: &[f64]| x.iter().zip(y).map(|(x, y)| x * y).sum::<f64>();
    let [own, other] = [product(first, first), product(second, second)].map(f64::sqrt);
    let cosine = product(first, second) / (own * other);
    let ratio = own.max(other) / own.min(other);
    // Written so that a value that is not a number fails, too.
    cosine >= LEAST_COSINE && ratio <= MOST_RATIO
}

struct Judged<'a> {
    model: &'a Model,
    searched: &'a Searched,
    effect: usize,
}

impl Judged<'_> {
    /// Columns of the other effects, and of this one where a stretch holds any of it.
    fn columns(&self, stretch: Stretch) -> [Vec<Vec<f64>>; 2] {
        let places = self.searched.places(self.effect);
        let seen = |x: &Vec<f64>| {
            let part = &x[stretch.from.max(START)..stretch.to];
            part.iter().any(|v| *v != part[0])
        };
        let mut out = [Vec::new(), Vec::new()];
        for (place, column) in self.searched.columns.iter().enumerate() {
            if seen(column) {
                out[usize::from(places.contains(&place))].push(column.clone());
            }
        }
        out
    }

    /// The effect's coefficients in a stretch by itself, where it gains more there than it costs.
    fn found(&self, stretch: Stretch) -> Option<Vec<f64>> {
        let design = self.model.design.where_used(|k| stretch.holds(k));
        let [others, own] = self.columns(stretch);
        if own.is_empty() {
            return None;
        }
        let order = self.model.base.order();
        // A noise model that was fitted without another loop's load predicts much of its cycle.
        let from = match self.searched.added[self.effect].shape {
            Shape::Neighbour(..) => &self.searched.fit,
            _ => &self.model.base,
        };
        let without = design.fit(order, &others, Some(from))?;
        let all: Vec<Vec<f64>> = others.iter().chain(&own).cloned().collect();
        let with = design.fit(order, &all, Some(from))?;
        let gain = with.log_likelihood() - without.log_likelihood();
        let shape = match &self.searched.added[self.effect].shape {
            Shape::Outliers(at) => Shape::Outliers(at.iter().copied().filter(|k| stretch.holds(*k)).collect()),
            shape => shape.clone(),
        };
        (gain > shape.cost(design.count(), 1)).then(|| with.beta[others.len()..].to_vec())
    }

    /// Whether a stretch shows the effect by itself, with the sign that the whole has, and a noise model of the rest predicts
    /// it better with the effect.
    fn local(&self, stretch: Stretch) -> bool {
        let places = self.searched.places(self.effect);
        let whole = self.searched.fit.beta[places.start];
        let Some(own) = self.found(stretch) else { return false };
        let same =
            !matches!(self.searched.added[self.effect].shape, Shape::Step(_) | Shape::Pulse(..) | Shape::Ramp(_))
                || own.first().is_some_and(|own| own * whole > 0.0);
        same && self.held_out(stretch) > LEAST_HELD_OUT
    }

    /// Nats that the effect, as large as the whole record has it, gains in a stretch by a noise model of the rest.
    fn held_out(&self, stretch: Stretch) -> f64 {
        let beta = &self.searched.fit.beta;
        let columns = &self.searched.columns;
        let with = self.model.design.less(columns, beta);
        let places = self.searched.places(self.effect);
        let others: Vec<f64> =
            beta.iter().enumerate().map(|(k, b)| if places.contains(&k) { 0.0 } else { *b }).collect();
        let without = self.model.design.less(columns, &others);
        let order = self.model.base.order();
        // Lags of the rest must not reach into the stretch.
        let rest = |k: usize| !(stretch.from..stretch.to + order).contains(&k);
        let design = self.model.design.with_y(with.clone()).where_used(rest);
        let Some(fit) = design.fit(order, &[], None) else { return 0.0 };
        let lost = |y: &[f64]| loss(&design, &fit, y, stretch);
        let count = places.len() as f64;
        lost(&without) - lost(&with) - 0.5 * count * libm::log(stretch.to as f64 - stretch.from as f64)
    }
}

/// What PV `y` costs in a stretch by a fit, nats.
fn loss(design: &Design, fit: &Fit, y: &[f64], stretch: Stretch) -> f64 {
    let e = design.innovations(fit, y);
    fit.student.loss(e[stretch.from.saturating_sub(START)..stretch.to - START].iter().copied())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::gap::budget::search::search;
    use crate::core::gap::budget::tests::Loop;

    fn confirmed(of: Loop) -> Vec<(&'static str, bool)> {
        let series = of.series(2);
        let model = Model::of(&series).unwrap();
        let found = search(&series, &model);
        (0..found.added.len()).map(|k| (found.added[k].shape.id(), confirm(&model, &found, k))).collect()
    }

    #[test]
    fn what_is_there_is_confirmed_and_what_is_in_one_half_only_is_not() {
        let plain = Loop::default();
        assert_eq!(confirmed(Loop { step: 1.5, ..plain }), [("step_load", true)]);
        assert_eq!(confirmed(Loop { wave: 0.6, ..plain }), [("sinusoid", true)]);
        assert_eq!(confirmed(Loop { wild: 3.0, ..plain }), [("outliers", true)]);
        let burst = confirmed(Loop { wave: 0.9, burst: true, ..plain });
        assert!(burst.iter().all(|(id, sure)| *id != "sinusoid" || !sure), "{burst:?}");
    }

    #[test]
    fn two_halves_agree_by_direction_and_size() {
        assert!(agree(&[1.0, 0.2], &[0.8, -0.1]) && !agree(&[1.0], &[-1.0]) && !agree(&[1.0], &[5.0]));
        assert!(!agree(&[0.0], &[1.0]));
    }
}
