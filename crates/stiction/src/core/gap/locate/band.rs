//! The gap by frequency, around the oscillation's own.

use super::Band;
use super::held::Held;
use crate::core::signal::spectrum;

/// Edges between bands, multiples of the fundamental.
const EDGES: [f64; 6] = [0.3, 0.7, 1.3, 2.5, 6.0, 15.0];

/// Seven bands. The whole free-run residual is split, so that blocks do not blur the frequencies; what falls on the
/// held-out points counts.
pub(super) fn bands(held: &Held<'_>) -> Vec<Band> {
    let fundamental = 1.0 / held.period;
    let edges = EDGES.map(|e| (e * fundamental).min(0.5));
    let parts = spectrum::split(&held.residual[held.from..], &edges);
    let power = |part: &Vec<f64>| {
        let at = held.points.iter().filter_map(|&k| part.get(k - held.from));
        at.map(|v| v * v).sum::<f64>()
    };
    let powers: Vec<f64> = parts.iter().map(power).collect();
    let whole: f64 = powers.iter().sum();
    let lower = core::iter::once(0.0).chain(edges);
    let bounds = lower.zip(edges.into_iter().chain([0.5]));
    let band = |(power, (low, high)): (f64, (f64, f64))| Band {
        from_hz: low / held.point_s,
        to_hz: high / held.point_s,
        share: (high > low && whole.is_finite() && whole > 0.0).then(|| power / whole),
        expected: 2.0 * (high - low),
    };
    powers.into_iter().zip(bounds).map(band).collect()
}
