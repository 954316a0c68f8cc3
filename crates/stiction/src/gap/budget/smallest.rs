//! From which size on an effect would have been named in this record.

use super::arx::{Fit, ORDERS, START, whitened};
use super::scan::Scan;
use super::search::{LEAST_GAIN, LOW, Model, Searched, refit};
use super::series::Series;
use super::shapes::Shape;

/// Highest order of A.
const HIGHEST: usize = ORDERS[ORDERS.len() - 1];
/// Onsets at which a step is put in, and the part of them at which it must be seen.
const ONSETS: usize = 20;
const SEEN: f64 = 0.9;
/// Sizes between which the least step is looked for, standard deviations of PV, and halvings of that range's ratio.
const SIZES: [f64; 2] = [1e-3, 20.0];
const HALVINGS: usize = 12;
/// Parts of the record at which a step is put into PV and fitted, and the factor by which it grows until it is named there.
const PLACES: [f64; 3] = [0.2, 0.5, 0.8];
const GROWTH: f64 = 1.25;
/// The same for a sinusoid; each size takes fits.
const WAVE_SIZES: [f64; 2] = [0.05, 5.0];
const WAVE_HALVINGS: usize = 5;
/// Cycles in the record of the sinusoid.
const CYCLES: f64 = 4.5;

/// The least size for which a rule holds, by halving; `None` where it does not hold at the largest.
fn least(range: [f64; 2], halvings: usize, holds: impl Fn(f64) -> bool) -> Option<f64> {
    let [mut low, mut high] = range.map(libm::log);
    if !holds(range[1]) {
        return None;
    }
    for _ in 0..halvings {
        let middle = 0.5 * (low + high);
        if holds(libm::exp(middle)) {
            high = middle;
        } else {
            low = middle;
        }
    }
    Some(libm::exp(high))
}

/// PV less the effects that were found, into which others are put.
struct Rest<'m> {
    model: &'m Model,
    pv: Vec<f64>,
    order: usize,
}

impl<'m> Rest<'m> {
    fn of(model: &'m Model, searched: &Searched) -> Self {
        let pv = model.design.less(&searched.columns, &searched.fit.beta);
        Self { model, pv, order: searched.fit.order() }
    }

    /// Log likelihood that a shape gains where `size` times a column was put in, nats: the noise model is fitted anew to both, and
    /// may take an effect for the disturbance's own.
    fn gain(&self, shape: &Shape, column: &[f64], size: f64) -> Option<f64> {
        let y = self.pv.iter().zip(column).map(|(y, x)| y + size * x).collect();
        let design = self.model.design.with_pv(y);
        let price = 0.5 * libm::log(self.pv.len() as f64);
        let bases = [self.order, HIGHEST].into_iter().filter_map(|order| design.fit(order, &[], None));
        let worth = |fit: &Fit| fit.log_likelihood() - price * fit.order() as f64;
        let base = bases.max_by(|x, y| worth(x).total_cmp(&worth(y)))?;
        let before = base.log_likelihood();
        let low = if matches!(shape, Shape::Sinusoid(_)) { design.fit(LOW, &[], None) } else { None };
        let model = Model { design, base, ..self.model.clone() };
        let with = refit(&model, &model.columns(shape), low.as_ref())?;
        Some(with.log_likelihood() - before)
    }
}

/// The least step that would have been named at nine of ten onsets, standard deviations of PV.
#[must_use]
pub fn step(model: &Model, searched: &Searched) -> Option<f64> {
    let n = model.design.y.len();
    let scan = Scan::new(&searched.fit, n)?;
    let cost = Shape::Step(0).cost(n, scan.onsets().len()) + LEAST_GAIN;
    let mut size = by_innovations(&scan, searched, cost)?;
    let rest = Rest::of(model, searched);
    for place in PLACES {
        let shape = Shape::Step((place * n as f64) as usize);
        let column = model.columns(&shape).remove(0);
        while rest.gain(&shape, &column, size).is_none_or(|gain| gain < cost) {
            size *= GROWTH;
            if size > SIZES[1] {
                return None;
            }
        }
    }
    Some(size)
}

/// The least step whose innovations would have cost enough at nine of ten onsets, the noise model left as it is.
fn by_innovations(scan: &Scan<'_>, searched: &Searched, cost: f64) -> Option<f64> {
    let fit = &searched.fit;
    let n = START + fit.e.len();
    let onsets = scan.onsets();
    let before = fit.student.loss(fit.e.iter().copied());
    let needed = |i: usize| {
        let at = onsets.start + (onsets.len() - 1) * (2 * i + 1) / (2 * ONSETS);
        let column = Shape::Step(at).columns(n, &[]).remove(0);
        let seen = scan.new_part(&whitened(&fit.a, &column)[START..]);
        let gain = |size: f64| fit.student.loss(fit.e.iter().zip(&seen).map(|(e, x)| e + size * x)) - before;
        least(SIZES, HALVINGS, |size| gain(size) >= cost).unwrap_or(f64::INFINITY)
    };
    let mut sizes: Vec<f64> = (0..ONSETS).map(needed).collect();
    sizes.sort_by(f64::total_cmp);
    Some(sizes[(SEEN * ONSETS as f64) as usize - 1]).filter(|size| size.is_finite())
}

/// The least amplitude of a slow sinusoid that would have been named, standard deviations of PV, and its frequency, cycles a
/// point.
#[must_use]
pub fn sinusoid(series: &Series, model: &Model, searched: &Searched) -> Option<(f64, f64)> {
    let n = series.n();
    let scan = Scan::new(&searched.fit, n)?;
    let frequencies = scan.frequencies(series);
    let by = |f: &&f64| (**f * n as f64 - CYCLES).abs();
    let frequency = *frequencies.iter().min_by(|x, y| by(x).total_cmp(&by(y)))?;
    let shape = Shape::Sinusoid(frequency);
    let waves = model.columns(&shape);
    let cost = shape.cost(n, frequencies.len()) + LEAST_GAIN;
    let rest = Rest::of(model, searched);
    let named = |size: f64| waves.iter().all(|wave| rest.gain(&shape, wave, size).is_some_and(|gain| gain >= cost));
    least(WAVE_SIZES, WAVE_HALVINGS, named).map(|size| (size, frequency))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gap::budget::search::search;
    use crate::gap::budget::tests::Loop;

    #[test]
    fn a_step_of_that_size_is_named_and_one_of_half_of_it_is_not() {
        let plain = Loop::default();
        let series = plain.series(4);
        let model = Model::of(&series).unwrap();
        let size = step(&model, &search(&series, &model)).unwrap();
        let put = |share: f64| {
            let record =
                series.pv.iter().enumerate().map(|(k, y)| y + if k >= 450 { share * size } else { 0.0 }).collect();
            let series = Series { pv: record, ..series.clone() };
            let model = Model::of(&series).unwrap();
            search(&series, &model).added.iter().any(|a| matches!(a.shape, Shape::Step(at) if at.abs_diff(450) <= 3))
        };
        assert!(put(1.2) && !put(0.3), "{size}");
        let (amplitude, frequency) = sinusoid(&series, &model, &search(&series, &model)).unwrap();
        assert!(amplitude > 0.05 && amplitude < 5.0 && (frequency * series.n() as f64 - 4.5).abs() < 1.5);
    }
}
