//! Chooses the part of a loop's past for a due window.

use super::settings::WindowParams;
use stiction::core::detect::oscillation;
use stiction::core::record::Record;
use stiction::core::units::ns_from_s;
use stiction::samples::align::Point;
use stiction::samples::history::{View, record_of};

/// Doublings of the box size between two searches: an oscillation too slow for one is found in the next.
const LEVEL_STEP: usize = 2;
/// Most doublings of the box size in the search for slow oscillations.
const MAX_LEVELS: usize = 24;

/// The record of the window that ends now: the latest `max_periods` periods of the fastest regular oscillation, looked for
/// first in raw samples and then in ever larger boxes; without one, the latest raw samples that fit.
pub(super) fn choose_record(history: View<'_>, params: &WindowParams, end_ns: i64) -> Option<Record> {
    let oldest_ns = end_ns.saturating_sub(ns_from_s(params.max_window_s));
    let mut finest = None;
    for level in (0..MAX_LEVELS).step_by(LEVEL_STEP) {
        let record = history.latest(level, oldest_ns, end_ns)?;
        let whole = record.raw_samples as u64 >= history.total() || record.start_ns <= oldest_ns;
        let exhausted = whole || record.len() < params.max_points / 2;
        if let Some(found) = oscillation::detect(&record.op(), &record.pv)
            && found.oscillating
            && found.periods >= params.min_periods
        {
            let period_s = found.period_points * record.point_s();
            let from_ns = end_ns.saturating_sub(ns_from_s(params.max_periods * period_s)).max(oldest_ns);
            return history.record(from_ns, end_ns);
        }
        finest.get_or_insert(record);
        if exhausted {
            break;
        }
    }
    let from_ns = finest.as_ref()?.start_ns;
    history.record(from_ns, end_ns)
}

/// Numbers of windows in which a long record is judged, and the length from which it counts as long, in windows.
const WINDOWS: [usize; 2] = [3, 5];
const LONG: f64 = 1.6;

/// The windows in which a stretch is judged if it is longer than 1.6 windows (32 periods if a window has 20). Each has
/// `max_periods` periods of the fastest regular oscillation in the middle of the stretch. There are five if they fit side by
/// side, else three, evenly spaced. Empty for a shorter stretch and if nothing oscillates.
#[must_use]
pub fn windows(stretch: &[Point], params: &WindowParams) -> Vec<Record> {
    let Some(period) = fastest_period(stretch, params) else { return Vec::new() };
    let length = params.max_periods * period;
    if (stretch.len() as f64) < LONG * length {
        return Vec::new();
    }
    let (length, [few, many]) = (length as usize, WINDOWS);
    let count = if stretch.len() >= many * length { many } else { few };
    let place = |k: usize| k * (stretch.len() - length) / (count - 1);
    (0..count).filter_map(|k| record_of(&stretch[place(k)..place(k) + length], params.max_points)).collect()
}

/// Period, samples, of the fastest regular oscillation in the middle of a stretch, looked for first in raw samples and then in
/// ever larger boxes.
fn fastest_period(stretch: &[Point], params: &WindowParams) -> Option<f64> {
    for level in (0..MAX_LEVELS).step_by(LEVEL_STEP) {
        let length = stretch.len().min(params.max_points << level);
        let from = (stretch.len() - length) / 2;
        let record = record_of(&stretch[from..from + length], params.max_points)?;
        if let Some(found) = oscillation::detect(&record.op(), &record.pv)
            && found.oscillating
            && found.periods >= params.min_periods
        {
            return Some(found.period_points * record.box_samples as f64);
        }
        if length == stretch.len() {
            break;
        }
    }
    None
}

/// The record of a section that a person chose: the longest stretch without a gap between two stamps (ends included),
/// identified by `end_ns`, averaged in boxes as in the daemon. Also returns the number of the section's points outside it.
#[must_use]
pub fn section(
    stretches: &[Vec<Point>],
    from_ns: i64,
    to_ns: i64,
    end_ns: Option<i64>,
    max_points: usize,
) -> (Option<Record>, usize) {
    let (longest, total) = longest(stretches, from_ns, to_ns);
    let record = record_of(longest, max_points).map(|mut record| {
        record.end_ns = end_ns.unwrap_or(record.end_ns);
        record
    });
    (record, total - longest.len())
}

/// The longest stretch without a gap between two stamps (ends included), and the number of points between them.
#[must_use]
pub fn longest(stretches: &[Vec<Point>], from_ns: i64, to_ns: i64) -> (&[Point], usize) {
    let inside = |stretch: &'_ Vec<Point>| {
        let from = stretch.partition_point(|p| p.t_ns < from_ns);
        let to = stretch.partition_point(|p| p.t_ns <= to_ns);
        from..to.max(from)
    };
    let parts: Vec<&[Point]> = stretches.iter().map(|s| &s[inside(s)]).collect();
    let total = parts.iter().map(|part| part.len()).sum();
    (parts.into_iter().max_by_key(|part| part.len()).unwrap_or(&[]), total)
}

#[cfg(test)]
mod tests {
    use super::*;
    use stiction::core::units::ns_from_s;

    fn stretch(n: usize, period: f64) -> Vec<Point> {
        let wave = |k: usize, phase: f64| libm::sin(2.0 * core::f64::consts::PI * (k as f64 / period + phase));
        let point = |k: usize| Point {
            t_ns: ns_from_s(k as f64),
            op: wave(k, 0.0),
            pv: wave(k, 0.2),
            sp: None,
            mv: None,
            manual: false,
            filled: false,
            bad: 0,
        };
        (0..n).map(point).collect()
    }

    #[test]
    fn long_stretches_are_cut_into_an_odd_number_of_windows() {
        let params = WindowParams::default();
        for (n, period, count, length) in
            [(1000, 40.0, 0, 0), (1300, 40.0, 3, 800), (9000, 40.0, 5, 800), (60_000, 400.0, 5, 8000)]
        {
            let found = windows(&stretch(n, period), &params);
            assert_eq!(found.len(), count, "{n} {period}");
            assert!(found.iter().all(|r| r.raw_samples.abs_diff(length) * 50 <= length.max(1)), "{n} {period}");
            if let (Some(first), Some(last)) = (found.first(), found.last()) {
                assert_eq!(first.start_ns, 0);
                assert!(last.end_ns >= ns_from_s(n as f64 - 10.0));
            }
        }
    }
}
