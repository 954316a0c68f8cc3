//! Which stretch of a loop's past a due window takes.

use crate::config::WindowParams;
use crate::detect::oscillation;
use crate::record::Record;
use crate::signal::align::Point;
use crate::signal::history::{History, record_of};
use crate::units::ns_from_s;

/// Doublings between two looks: what oscillates too slowly for one is well within the next.
const LEVEL_STEP: usize = 2;
/// Most doublings of the box size that are tried when looking for slow oscillations.
const MAX_LEVELS: usize = 24;

/// The record of the window that ends now: the latest `max_periods` periods of the fastest regular oscillation that
/// shows, looked for in raw samples first and then in ever larger boxes; without one, the latest raw samples that fit.
pub(super) fn choose_record(history: &History, params: &WindowParams, end_ns: i64) -> Option<Record> {
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

/// The record of a section that a person chose: the longest stretch without a gap between two stamps (ends included),
/// named by `end_ns`, boxed as the daemon would box it. Also says how many points of the section stand outside it.
#[must_use]
pub fn section(
    stretches: &[Vec<Point>],
    from_ns: i64,
    to_ns: i64,
    end_ns: Option<i64>,
    max_points: usize,
) -> (Option<Record>, usize) {
    let inside = |stretch: &'_ [Point]| {
        let from = stretch.partition_point(|p| p.t_ns < from_ns);
        let to = stretch.partition_point(|p| p.t_ns <= to_ns);
        (from, to.max(from))
    };
    let spans: Vec<(&[Point], (usize, usize))> = stretches.iter().map(|s| (s.as_slice(), inside(s))).collect();
    let total: usize = spans.iter().map(|(_, (from, to))| to - from).sum();
    let Some((stretch, (from, to))) = spans.into_iter().max_by_key(|(_, (from, to))| to - from) else {
        return (None, 0);
    };
    let record = record_of(&stretch[from..to], max_points).map(|mut record| {
        record.end_ns = end_ns.unwrap_or(record.end_ns);
        record
    });
    (record, total - (to - from))
}
