//! Single events in a window, such as a trip, a shutdown or the end of a start-up, that are not part of its cycles.

use crate::core::record::Record;
use crate::core::signal::stats;

/// Distance from the median beyond which a value is an outlier, interquartile ranges. A square wave stays within 1, a sinusoid
/// within 0.8, Gaussian noise within 3.
const OUTSIDE: f64 = 4.0;
/// Largest share of the record that can be an excursion; more is another operating state.
const SHARE: f64 = 0.15;
/// Fewest points: shorter ones are spikes, which fits tolerate.
const LEAST: usize = 3;
/// Smallest share of the record that must remain on one side of it.
const LEFT: f64 = 0.5;
/// Points removed on each side of it, shares of the record.
const MARGIN: f64 = 0.01;
/// Spread of the set point relative to PV's above which PV follows the set point.
const FOLLOWS: f64 = 0.2;

/// The points of the longest part of a record without an excursion of PV or OP; `None` if there is no excursion, or it cannot
/// be removed.
#[must_use]
pub(crate) fn without(record: &Record) -> Option<[usize; 2]> {
    let n = record.len();
    let moved = record.sp.as_deref().map_or(0.0, stats::std_dev);
    if moved > FOLLOWS * stats::std_dev(&record.pv) {
        return None;
    }
    let op = record.op();
    let mut outside: Vec<usize> = [&record.pv, &op].into_iter().flat_map(|x| places(x)).collect();
    outside.sort_unstable();
    outside.dedup();
    if outside.len() < LEAST || outside.len() as f64 > SHARE * n as f64 {
        return None;
    }
    let margin = (MARGIN * n as f64) as usize + 1;
    let edges = core::iter::once(None)
        .chain(outside.iter().map(|k| Some(*k)))
        .zip(outside.iter().map(|k| Some(*k)).chain([None]));
    let part = |(before, after): (Option<usize>, Option<usize>)| {
        let from = before.map_or(0, |k| k + 1 + margin);
        let to = after.map_or(n, |k| k.saturating_sub(margin));
        [from, to.max(from)]
    };
    let longest = edges.map(part).max_by_key(|[from, to]| to - from)?;
    ((longest[1] - longest[0]) as f64 >= LEFT * n as f64).then_some(longest)
}

/// Indices of the outliers.
fn places(x: &[f64]) -> Vec<usize> {
    let sorted = stats::sorted(x);
    let [low, middle, high] = [0.25, 0.5, 0.75].map(|q| stats::quantile_sorted(&sorted, q));
    let width = high - low;
    // A signal that is mostly constant has no spread to compare a move with.
    if width <= 0.02 * stats::std_dev(x) {
        return Vec::new();
    }
    x.iter().enumerate().filter(|(_, v)| (*v - middle).abs() > OUTSIDE * width).map(|(k, _)| k).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(at: core::ops::Range<usize>) -> Record {
        let wave = |k: usize| libm::sin(k as f64 * 0.1);
        let pv = (0..1000).map(|k| if at.contains(&k) { wave(k) - 30.0 } else { wave(k) }).collect();
        Record::uniform(1.0, (0..1000).map(wave).collect(), pv)
    }

    #[test]
    fn a_trip_is_cut_off_and_a_cycle_is_not() {
        assert_eq!(without(&record(900..1000)), Some([0, 889]));
        assert_eq!(without(&record(0..50)), Some([61, 1000]));
        assert_eq!(without(&record(300..330)), Some([341, 1000]));
        assert_eq!(without(&record(450..560)), None);
        assert_eq!(without(&record(0..0)), None);
        let square = (0..1000).map(|k| if k % 100 < 50 { 1.0 } else { -1.0 }).collect();
        assert_eq!(without(&Record::uniform(1.0, square, record(0..0).pv)), None);
    }

    #[test]
    fn a_part_keeps_what_belongs_together() {
        let part = record(0..0).part(100, 300);
        assert_eq!((part.len(), part.raw_samples, part.op_path.len()), (200, 200, 200));
        assert_eq!((part.start_ns, part.end_ns), (100_000_000_000, 299_000_000_000));
    }
}
