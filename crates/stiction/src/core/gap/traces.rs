//! What transmitter and recorder did to PV, as its traces show it, and the same done to a prediction.

use super::types::Signature;
use crate::core::signal::stats;

/// What a record's PV shows.
#[derive(Debug, Clone)]
pub struct Traces {
    /// Every test, met or not.
    pub signatures: Vec<Signature>,
    /// Points left out of every fit and every figure.
    pub masked: Vec<bool>,
    /// Points at which PV is what the sensor measured, and not what a recorder put between two stored values, the end of
    /// a range or the last value of a sensor that stands still: models are fitted to these.
    pub measured: Vec<bool>,
    /// Whether a recorder thinned PV, so that its noise shows in the stored values only.
    pub thinned: bool,
    /// Whether the stored values are enough to read the noise from what a model leaves there.
    pub noise_shows: bool,
    /// Whether a recorder thinned PV so far, or the record is so long, that no model can be fitted to its stored values.
    pub beyond_reach: bool,
    /// First and last point of the longest stretch that stands still.
    pub(super) still: [usize; 2],
    /// Lowest and highest value of PV.
    pub(super) ends: [f64; 2],
    /// PV as recorded.
    pub(super) pv: Vec<f64>,
}

impl Traces {
    /// The same where no model can be fitted to the stored values: all that was recorded counts.
    #[must_use]
    pub(crate) fn all_measured(&self) -> Self {
        let measured = vec![true; self.measured.len()];
        Self { measured, thinned: false, noise_shows: false, beyond_reach: true, ..self.clone() }
    }

    /// Holds a prediction where PV is held.
    pub(crate) fn hold(&self, prediction: &mut [f64]) {
        for k in 1..prediction.len() {
            if self.pv[k] == self.pv[k - 1] {
                prediction[k] = prediction[k - 1];
            }
        }
    }

    /// Holds it where PV stands still.
    pub(crate) fn freeze(&self, prediction: &mut [f64]) {
        let [from, to] = self.still;
        let held = prediction[from];
        prediction[from..=to].fill(held);
    }

    /// Cuts it off at the end of PV's range that holds more samples.
    pub(crate) fn clip(&self, prediction: &mut [f64]) {
        let end = |at: usize| self.pv.iter().filter(|v| **v == self.ends[at]).count();
        let low = end(0) > end(1);
        for p in prediction {
            *p = if low { p.max(self.ends[0]) } else { p.min(self.ends[1]) };
        }
    }

    /// Draws it straight between the knots of PV.
    pub(crate) fn straighten(&self, prediction: &mut [f64]) {
        between(&knots(&self.pv), prediction);
    }
}

/// Points at which PV turns from one straight line to the next, its ends included.
pub(super) fn knots(pv: &[f64]) -> Vec<bool> {
    let scale = 1e-6 * stats::std_dev(pv);
    let turns = |k: usize| (pv[k + 1] - 2.0 * pv[k] + pv[k - 1]).abs() >= scale;
    (0..pv.len()).map(|k| k == 0 || k + 1 == pv.len() || turns(k)).collect()
}

/// Draws a signal straight between the points that are `kept`; before the first and behind the last it is held.
pub(crate) fn between(kept: &[bool], x: &mut [f64]) {
    let places: Vec<usize> = (0..x.len().min(kept.len())).filter(|k| kept[*k]).collect();
    let (Some(first), Some(last)) = (places.first().copied(), places.last().copied()) else { return };
    for pair in places.windows(2) {
        let (a, b) = (x[pair[0]], x[pair[1]]);
        let length = (pair[1] - pair[0]) as f64;
        for (i, value) in x[pair[0]..pair[1]].iter_mut().enumerate().skip(1) {
            *value = a + (b - a) * i as f64 / length;
        }
    }
    let (held, after) = (x[first], x[last]);
    x[..first].fill(held);
    x[last + 1..].fill(after);
}
