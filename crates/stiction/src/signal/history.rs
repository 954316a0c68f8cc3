//! Bounded memory of one loop's points: raw while they fit, boxes of 2, 4, 8 ... samples further back.
//!
//! Each sample is stored once. When the raw store is full its two oldest points become one box of two, when that store
//! is full its two oldest boxes one of four, and so on. Sums are added pairwise along the same tree whichever way a
//! box came about, so a window cut from here equals, to the last bit, the window cut from the recording.

use std::collections::VecDeque;

use super::align::Point;
use crate::record::{Facts, Record};
use crate::units::s_from_ns;

/// A raw point as stored; absent signals are NaN here and `None` outside.
#[derive(Debug, Clone, Copy)]
struct Raw {
    t_ns: i64,
    op: f64,
    pv: f64,
    sp: f64,
    mv: f64,
    bad: u16,
    manual: bool,
    filled: bool,
    pv_repeat: bool,
    op_repeat: bool,
}

/// A box of 2^level raw points.
#[derive(Debug, Clone, Copy)]
struct Bin {
    t_ns: i64,
    pv_sum: f64,
    sp_sum: f64,
    mv_sum: f64,
    op: [f64; 4],
    facts: [u16; 5],
}

impl Bin {
    const FIRST: usize = 0;
    const MIN: usize = 1;
    const MAX: usize = 2;
    const LAST: usize = 3;

    fn of(p: &Raw) -> Self {
        let facts = [p.manual.into(), p.filled.into(), p.bad, p.pv_repeat.into(), p.op_repeat.into()];
        Self { t_ns: p.t_ns, pv_sum: p.pv, sp_sum: p.sp, mv_sum: p.mv, op: [p.op; 4], facts }
    }

    fn join(a: &Self, b: &Self) -> Self {
        let mut facts = a.facts;
        for (sum, more) in facts.iter_mut().zip(b.facts) {
            *sum = sum.saturating_add(more);
        }
        Self {
            t_ns: a.t_ns,
            pv_sum: a.pv_sum + b.pv_sum,
            sp_sum: a.sp_sum + b.sp_sum,
            mv_sum: a.mv_sum + b.mv_sum,
            op: [
                a.op[Self::FIRST],
                a.op[Self::MIN].min(b.op[Self::MIN]),
                a.op[Self::MAX].max(b.op[Self::MAX]),
                b.op[Self::LAST],
            ],
            facts,
        }
    }

    /// First, extremes in the order that travels least, last.
    fn op_path(&self) -> [f64; 4] {
        let [first, min, max, last] = self.op;
        if last >= first { [first, min, max, last] } else { [first, max, min, last] }
    }
}

/// One loop's points since the last break.
#[derive(Debug, Clone)]
pub struct History {
    max_points: usize,
    raw: VecDeque<Raw>,
    /// `bins[l]` holds boxes of `2^(l+1)` points, older than anything finer.
    bins: Vec<VecDeque<Bin>>,
    /// Points pushed since the last break; the newest has index `total - 1`.
    total: u64,
}

impl History {
    /// An empty memory of `max_points` raw points (and half as many boxes of each size).
    #[must_use]
    pub fn new(max_points: usize) -> Self {
        Self { max_points: max_points.max(16) & !1, raw: VecDeque::new(), bins: Vec::new(), total: 0 }
    }

    /// A memory that goes on after `total` points, none of which it holds.
    #[must_use]
    pub fn resumed(max_points: usize, total: u64) -> Self {
        Self { total, ..Self::new(max_points) }
    }

    /// Forgets everything: the stretch has ended.
    pub fn clear(&mut self) {
        self.raw.clear();
        self.bins.clear();
        self.total = 0;
    }

    /// Whether nothing is stored.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.raw.is_empty()
    }

    /// Points since the last break, stored or not.
    #[must_use]
    pub const fn total(&self) -> u64 {
        self.total
    }

    /// Stamp of the newest point.
    #[must_use]
    pub fn newest_ns(&self) -> Option<i64> {
        self.raw.back().map(|p| p.t_ns)
    }

    /// Adds a point; forgets boxes that end before `keep_from_ns`.
    pub fn push(&mut self, p: &Point, keep_from_ns: i64) {
        let last = self.raw.back();
        let point = Raw {
            t_ns: p.t_ns,
            op: p.op,
            pv: p.pv,
            sp: p.sp.unwrap_or(f64::NAN),
            mv: p.mv.unwrap_or(f64::NAN),
            bad: p.bad,
            manual: p.manual,
            filled: p.filled,
            pv_repeat: last.is_some_and(|l| l.pv == p.pv),
            op_repeat: last.is_some_and(|l| l.op == p.op),
        };
        self.raw.push_back(point);
        self.total += 1;
        if self.raw.len() > self.max_points + 2 {
            // After a resumption the first point may be half of a box whose other half is not held: it goes.
            let odd = self.first_at(0) % 2 == 1;
            if let (Some(a), false) = (self.raw.pop_front(), odd)
                && let Some(b) = self.raw.pop_front()
            {
                self.sink(0, Bin::join(&Bin::of(&a), &Bin::of(&b)));
            }
        }
        if let Some(coarsest) = self.bins.last_mut()
            && coarsest.get(1).is_some_and(|second| second.t_ns < keep_from_ns)
        {
            coarsest.pop_front();
            if coarsest.is_empty() {
                self.bins.pop();
            }
        }
    }

    fn sink(&mut self, level: usize, bin: Bin) {
        if self.bins.len() == level {
            self.bins.push(VecDeque::new());
        }
        let limit = self.max_points / 2 + 2;
        self.bins[level].push_back(bin);
        if self.bins[level].len() <= limit {
            return;
        }
        let odd = self.first_at(level + 1) % 2 == 1;
        let bins = &mut self.bins[level];
        if let (Some(a), false) = (bins.pop_front(), odd)
            && let Some(b) = bins.pop_front()
        {
            self.sink(level + 1, Bin::join(&a, &b));
        }
    }

    /// Index of the oldest item held at a level (0: raw), in units of that level's size.
    fn first_at(&self, level: usize) -> u64 {
        let mut end = self.total - self.raw.len() as u64;
        if level == 0 {
            return end;
        }
        for (l, bins) in self.bins.iter().enumerate().take(level) {
            end = (end >> (l + 1)) - bins.len() as u64;
            if l + 1 < level {
                end <<= l + 1;
            }
        }
        end
    }

    /// Index of the first point at or after a time, as far back as anything is held.
    fn index_at(&self, t_ns: i64) -> u64 {
        for level in (1..=self.bins.len()).rev() {
            let bins = &self.bins[level - 1];
            if bins.back().is_some_and(|b| b.t_ns >= t_ns) {
                let place = bins.partition_point(|b| b.t_ns < t_ns) as u64;
                return (self.first_at(level) + place) << level;
            }
        }
        self.total - self.raw.len() as u64 + self.raw.partition_point(|p| p.t_ns < t_ns) as u64
    }

    /// The box of `2^level` points with the given index, put together from finer ones where need be.
    fn bin(&self, level: usize, index: u64) -> Option<Bin> {
        if level == 0 {
            let place = index.checked_sub(self.first_at(0))? as usize;
            return self.raw.get(place).map(Bin::of);
        }
        if let Some(bins) = self.bins.get(level - 1) {
            let first = self.first_at(level);
            if index < first {
                return None;
            }
            if let Some(bin) = bins.get((index - first) as usize) {
                return Some(*bin);
            }
        }
        Some(Bin::join(&self.bin(level - 1, 2 * index)?, &self.bin(level - 1, 2 * index + 1)?))
    }

    /// The record from `from_ns` to the newest point: raw if it fits into `max_points`, else in the smallest boxes that
    /// do. `end_ns` names it. `None` where nothing is held.
    #[must_use]
    pub fn record(&self, from_ns: i64, end_ns: i64) -> Option<Record> {
        let level_for = |from: u64| {
            let n = self.total - from;
            (0..48).find(|l| (n >> l) <= self.max_points as u64).unwrap_or(48)
        };
        let mut from = self.index_at(from_ns);
        let coarse = level_for(from);
        from = from.next_multiple_of(1 << coarse);
        if from >= self.total {
            return None;
        }
        self.cut(from, level_for(from), end_ns)
    }

    /// The latest points in boxes of `2^level`, as many as `max_points` at most, none older than `from_ns`.
    #[must_use]
    pub fn latest(&self, level: usize, from_ns: i64, end_ns: i64) -> Option<Record> {
        let reach = (self.max_points as u64) << level;
        let from = self.index_at(from_ns).max(self.total.saturating_sub(reach)).next_multiple_of(1 << level);
        (from < self.total).then(|| self.cut(from, level, end_ns)).flatten()
    }

    fn cut(&self, from: u64, level: usize, end_ns: i64) -> Option<Record> {
        let (first_bin, end_bin) = (from >> level, self.total >> level);
        let bins: Vec<Bin> = (first_bin..end_bin).filter_map(|i| self.bin(level, i)).collect();
        let (first, newest) = (bins.first()?, self.newest_ns()?);
        let raw_samples = (self.total - from) as usize;
        let size = (1_u64 << level) as f64;
        let mean = |of: fn(&Bin) -> f64| -> Option<Vec<f64>> {
            let values: Vec<f64> = bins.iter().map(|b| of(b) / size).collect();
            values.iter().all(|v| v.is_finite()).then_some(values)
        };
        let mut facts = Facts::default();
        for bin in &bins {
            let [manual, filled, bad, pv_repeats, op_repeats] = bin.facts.map(u32::from);
            facts.manual += manual;
            facts.filled += filled;
            facts.bad += bad;
            facts.pv_repeats += pv_repeats;
            facts.op_repeats += op_repeats;
        }
        let ts_s = s_from_ns(newest - first.t_ns) / (raw_samples.max(2) - 1) as f64;
        Some(Record {
            start_ns: first.t_ns,
            end_ns,
            ts_s,
            recorded_ts_s: ts_s,
            raw_samples,
            box_samples: 1 << level,
            op_path: if level == 0 {
                bins.iter().map(|b| b.op[Bin::FIRST]).collect()
            } else {
                bins.iter().flat_map(Bin::op_path).collect()
            },
            pv: bins.iter().map(|b| b.pv_sum / size).collect(),
            sp: mean(|b| b.sp_sum),
            mv: mean(|b| b.mv_sum),
            irregularity: irregularity(&bins),
            facts,
        })
    }
}

/// Robust standard deviation over mean of the time between boxes.
fn irregularity(bins: &[Bin]) -> f64 {
    let mut steps: Vec<i64> = bins.windows(2).map(|w| w[1].t_ns - w[0].t_ns).collect();
    if steps.len() < 4 {
        return 0.0;
    }
    steps.sort_unstable();
    let median = steps[steps.len() / 2];
    let mut off: Vec<i64> = steps.iter().map(|s| (s - median).abs()).collect();
    off.sort_unstable();
    // The 90th percentile, scaled as for a normal spread: a jitter on a third of the steps must show.
    off[off.len() * 9 / 10] as f64 / 1.645 / median.max(1) as f64
}

/// The record of a whole stretch of points, boxed as the daemon would box it.
#[must_use]
pub fn record_of(points: &[Point], max_points: usize) -> Option<Record> {
    let mut history = History::new(points.len().max(16));
    for point in points {
        history.push(point, i64::MIN);
    }
    history.max_points = max_points.max(16) & !1;
    history.record(i64::MIN, points.last()?.t_ns)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::units::NS_PER_S;
    use proptest::prelude::*;

    fn point(k: usize) -> Point {
        let x = k as f64;
        Point {
            t_ns: k as i64 * NS_PER_S,
            op: 50.0 + (x * 0.7).sin() + 0.1 * (x * 12.9).sin(),
            pv: (x * 0.07).cos() / 3.0,
            sp: Some(1.0),
            mv: None,
            manual: false,
            filled: false,
            bad: 0,
        }
    }

    #[test]
    fn a_box_keeps_means_and_extremes() {
        let points: Vec<Point> = (0..64).map(point).collect();
        let record = record_of(&points, 16).unwrap();
        assert_eq!((record.box_samples, record.len(), record.op_path.len()), (4, 16, 64));
        let mean = points[..4].iter().map(|p| p.pv).sum::<f64>() / 4.0;
        assert!((record.pv[0] - mean).abs() < 1e-12);
        let max = points[..4].iter().map(|p| p.op).fold(f64::MIN, f64::max);
        assert!(record.op_path[..4].contains(&max));
        assert_eq!((record.op_path[0], record.op_path[3]), (points[0].op, points[3].op));
        assert!(record.sp.is_some() && record.mv.is_none());
    }

    proptest! {
        #[test]
        fn a_window_from_memory_equals_the_window_from_the_recording(
            n in 1_usize..6000, max_points in 8_usize..100, from in 0_usize..6000
        ) {
            let mut history = History::new(2 * max_points);
            let points: Vec<Point> = (0..n).map(point).collect();
            for p in &points {
                history.push(p, i64::MIN);
            }
            let from = from.min(n - 1);
            let end_ns = points[n - 1].t_ns;
            if let Some(live) = history.record(points[from].t_ns, end_ns) {
                prop_assert!(live.len() <= 2 * max_points.max(8));
                let first = (live.start_ns / NS_PER_S) as usize;
                prop_assert!(first >= from && first < from + live.box_samples.max(2) * 2);
                let mut again = record_of(&points[first..], 2 * max_points).unwrap();
                // Repeats look one point back, which a cut recording does not have.
                again.facts = live.facts;
                prop_assert_eq!(live, again);
            }
        }

        #[test]
        fn a_resumed_memory_gives_the_same_windows(start in 0_usize..2000, tail in 2000_usize..3000) {
            let (mut whole, mut resumed) = (History::new(64), History::resumed(64, start as u64));
            let n = start + tail;
            for k in 0..n {
                let keep = (k as i64 - 900) * NS_PER_S;
                whole.push(&point(k), keep);
                if k >= start {
                    resumed.push(&point(k), keep);
                }
            }
            for back in [10, 63, 64, 65, 130, 500, 899] {
                let from = point(n - 1 - back).t_ns;
                prop_assert_eq!(whole.record(from, 0), resumed.record(from, 0));
            }
        }

        #[test]
        fn memory_stays_bounded(n in 100_usize..20_000) {
            let mut history = History::new(64);
            for k in 0..n {
                history.push(&point(k), (k as i64 - 3000) * NS_PER_S);
            }
            prop_assert!(history.raw.len() <= 67);
            prop_assert!(history.bins.len() <= 7);
            prop_assert!(history.bins.iter().all(|b| b.len() <= 36));
        }
    }
}
