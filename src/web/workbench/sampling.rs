//! Sampling time of a record.

use stiction::core::signal::stats;
use stiction::core::units::s_from_ns;
use stiction::samples::align::Point;

/// Median interval between samples, s.
#[must_use]
pub fn sampling_time_s(points: &[Point]) -> Option<f64> {
    // A subset is enough, and avoids a copy of a long record.
    let step = (points.len() / 10_000).max(1);
    let intervals: Vec<f64> =
        points.windows(2).step_by(step).map(|pair| s_from_ns(pair[1].t_ns - pair[0].t_ns)).collect();
    (!intervals.is_empty()).then(|| stats::median(&intervals))
}
