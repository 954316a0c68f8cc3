//! A model that is known, met again on its record: bands and law are given, the stem's first slip and the process are
//! looked for anew.

use super::candidate::{Candidate, CandidateFitter, Effort};
use super::class::Shape;

/// Gauss-Newton steps for each first position of the stem.
const STEPS: usize = 6;
/// First positions of the stem that are tried.
const STARTS: usize = 9;

/// The best candidate with the bands (s, j), spans of OP, its process fitted from the best of `shapes`.
pub fn again(fits: &mut CandidateFitter<'_>, [s, j]: [f64; 2], shapes: &[Shape]) -> Option<Candidate> {
    let effort = Effort::of(STEPS);
    let mut best: Option<Candidate> = None;
    for start in fits.normalised.starts(0.5 * (s + j), STARTS) {
        let fitted = fits.fit(s, j, start, shapes, effort);
        if let Some(fitted) = fitted.filter(|f| best.is_none_or(|b| f.fit.sse < b.fit.sse)) {
            best = Some(fitted);
        }
    }
    fits.settle(&best?)
}
