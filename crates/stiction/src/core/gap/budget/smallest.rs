//! From which size on an effect would have been named in this record: put into PV and looked for as any other, so that what
//! another effect or the disturbance takes of it counts, too.

use super::scan::Scan;
use super::search::{LEAST_GAIN, Model, Searched, is_same, search};
use super::series::Series;
use super::shapes::{APART, Shape};
use crate::core::signal::stats;

/// Onsets at which the innovations of a step are asked, and the part of them at which it must show.
const ONSETS: usize = 20;
const SEEN: f64 = 0.9;
/// Parts of the record at which a step is put into PV.
const PLACES: [f64; 3] = [0.2, 0.5, 0.8];
/// Factor by which an effect grows until the search names it, and how often it grows at most.
const GROWTH: f64 = 1.25;
const MOST_GROWN: usize = 15;
/// Factor on what these trials find. They keep the base as it is, and a new diagnosis lets it take part of the effect. Chosen on
/// every second real recording.
const MARGIN: f64 = 1.3;
/// Largest size that is given, standard deviations of PV: what is larger than all else changes the base and what drives the noise
/// model.
const LARGEST: f64 = 1.0;
/// Points by which the onset of a step may be missed.
const ONSET_MISSED: usize = 10;
/// Cycles in the record of the sinusoid.
const CYCLES: f64 = 4.5;

/// A record into which effects are put.
struct Trial<'r> {
    series: &'r Series,
    searched: &'r Searched,
    scan: Scan<'r>,
}

impl<'r> Trial<'r> {
    fn new(series: &'r Series, searched: &'r Searched) -> Self {
        Self { series, searched, scan: Scan::new(&searched.fit, series.n()) }
    }

    /// Whether the search names a shape of which `size` times a column is put into PV; also where it names that as it is.
    fn is_named(&self, shape: &Shape, column: &[f64], size: f64) -> bool {
        let pv = self.series.pv.iter().zip(column).map(|(y, x)| y + size * x).collect();
        let series = Series { pv, ..self.series.clone() };
        let found = Model::of(&series).map(|model| search(&series, &model).added).unwrap_or_default();
        let is_it = |own: &Shape| match (own, shape) {
            (Shape::Step(own), Shape::Step(put)) => own.abs_diff(*put) <= ONSET_MISSED,
            _ => is_same(own, shape, series.n()),
        };
        self.searched.added.iter().chain(&found).any(|added| is_it(&added.shape))
    }

    /// The least size, grown from one, at which the search names each of these shapes, times [`MARGIN`]; `None` where it does
    /// not come to that below [`LARGEST`].
    fn named(&self, shapes: &[(Shape, Vec<f64>)], from: f64) -> Option<f64> {
        let grown = core::iter::successors(Some(from), |size| Some(size * GROWTH)).take(MOST_GROWN + 1);
        let mut sizes = grown.take_while(|size| MARGIN * size <= LARGEST);
        let mut size = sizes.next()?;
        for (shape, column) in shapes {
            while !self.is_named(shape, column, size) {
                size = sizes.next()?;
            }
        }
        Some(MARGIN * size)
    }
}

/// The least step that would have been named, standard deviations of PV.
#[must_use]
pub(crate) fn step(series: &Series, model: &Model, searched: &Searched) -> Option<f64> {
    let trial = Trial::new(series, searched);
    let n = series.n();
    let onsets = trial.scan.onsets();
    let cost = Shape::Step(0).cost(n, onsets.len()) + LEAST_GAIN;
    let column = |at: usize| model.columns(&Shape::Step(at)).remove(0);
    let shown = |i: usize| {
        let at = onsets.start + (onsets.len() - 1) * (2 * i + 1) / (2 * ONSETS);
        trial.scan.shown(&column(at), cost)
    };
    let from = stats::quantile(&(0..ONSETS).map(shown).collect::<Vec<f64>>(), SEEN);
    let at = |place: &f64| (place * n as f64) as usize;
    let shapes: Vec<_> = PLACES.iter().map(|place| (Shape::Step(at(place)), column(at(place)))).collect();
    trial.named(&shapes, from)
}

/// The least amplitude of a slow sinusoid that would have been named, standard deviations of PV, and its frequency, cycles a
/// point.
#[must_use]
pub(crate) fn sinusoid(series: &Series, model: &Model, searched: &Searched) -> Option<(f64, f64)> {
    let trial = Trial::new(series, searched);
    let n = series.n();
    let frequencies = trial.scan.frequencies(series);
    let by = |f: &&f64| (**f * n as f64 - CYCLES).abs();
    let is_apart = |f: &f64| (f - 1.0 / series.period).abs() * n as f64 >= APART;
    let is_new = |f: &f64| searched.added.iter().all(|added| !is_same(&Shape::Sinusoid(*f), &added.shape, n));
    let is_free = |f: &&f64| is_apart(f) && is_new(f);
    let frequency = *frequencies.iter().filter(is_free).min_by(|x, y| by(x).total_cmp(&by(y)))?;
    let shape = Shape::Sinusoid(frequency);
    let cost = shape.cost(n, frequencies.len()) + LEAST_GAIN;
    // Sine and cosine: the phase must not matter.
    let shapes: Vec<_> = model.columns(&shape).into_iter().map(|wave| (shape.clone(), wave)).collect();
    let from = shapes.iter().map(|(_, wave)| trial.scan.shown(wave, cost)).fold(0.0, f64::max);
    trial.named(&shapes, from).map(|size| (size, frequency))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::gap::budget::search::search;
    use crate::core::gap::budget::tests::Loop;

    #[test]
    fn a_step_of_that_size_is_named_and_one_of_half_of_it_is_not() {
        // What begins while PV answers the set point is no load.
        let series = Series { sp_moves: Vec::new(), ..Loop::default().series(4) };
        let model = Model::of(&series).unwrap();
        let size = step(&series, &model, &search(&series, &model)).unwrap();
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
