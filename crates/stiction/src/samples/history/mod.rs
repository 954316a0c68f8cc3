//! Bounded history of one loop's points: raw while they fit, bins of 2, 4, 8 ... samples for older data.
//!
//! Each sample is stored once. When the raw store is full, its two oldest points become a bin of two; when that store is full,
//! its two oldest bins become a bin of four, and so on. Sums are added pairwise along the same tree in every case, so a window
//! from here is bit-identical to the window from the recording.
//!
//! Points are stored in growing columns: 21 bytes per raw point, 44 per bin, and 8 (8) more for each of SP and MV if the loop
//! has it. A clone shares the columns of each bin size until newer points change them, so a window can be extracted from a
//! clone later, on another thread, with the same result.

mod columns;

use std::collections::VecDeque;
use std::sync::Arc;

use super::align::Point;
use crate::core::record::{Facts, Record};
use crate::core::signal::held::held_over;
use crate::core::units::s_from_ns;
use columns::{Sparse, Times, bytes, put};

/// Bytes of a raw point and of a bin with all signals and marks.
const RAW_BYTES: usize = 39;
const BOX_BYTES: usize = 70;
/// Fewest bin sizes for a given memory limit: eight times its raw points.
const LEAST_SIZES: usize = 3;
/// Number of bin sizes without a memory limit.
const ALL_SIZES: usize = 48;
/// Fewest raw points for judging a window.
const LEAST_POINTS: usize = 128;
/// Smallest valid memory limit, bytes.
pub const LEAST_BYTES: usize = 24_000;

const fn raw_limit(max_points: usize) -> usize {
    max_points + 2
}

const fn level_limit(max_points: usize) -> usize {
    max_points / 2 + 2
}

/// Bytes of all raw points, and of all bins of one size.
fn bytes_of(max_points: usize) -> [usize; 2] {
    [RAW_BYTES * (raw_limit(max_points) + 1), BOX_BYTES * (level_limit(max_points) + 1) + 2 * size_of::<Level>()]
}

/// The number of raw points, at most `max_points`, and of bin sizes within a memory limit, whatever signals a loop has.
#[must_use]
pub fn fitting(max_points: usize, max_bytes: usize) -> [usize; 2] {
    let fits = |points: &usize| {
        let [raw, boxes] = bytes_of(*points);
        raw + LEAST_SIZES * boxes <= max_bytes
    };
    let points = (LEAST_POINTS..=max_points.max(LEAST_POINTS)).rev().find(fits).unwrap_or(LEAST_POINTS);
    let [raw, boxes] = bytes_of(points);
    [points, (max_bytes.saturating_sub(raw) / boxes).clamp(LEAST_SIZES, ALL_SIZES)]
}

/// A bin of 2^level raw points.
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

    /// First value, extremes in the order of least travel, last value.
    fn op_path(&self) -> [f64; 4] {
        let [first, min, max, last] = self.op;
        if last >= first { [first, min, max, last] } else { [first, max, min, last] }
    }
}

/// Flags of a raw point, as bits.
const MANUAL: u8 = 1;
const FILLED: u8 = 2;
const PV_REPEAT: u8 = 4;
const OP_REPEAT: u8 = 8;

/// Raw points, oldest first; absent signals are NaN inside and `None` outside.
#[derive(Debug, Clone)]
struct Raw {
    /// Index of the oldest.
    first: u64,
    times: Times,
    op: VecDeque<f64>,
    pv: VecDeque<f64>,
    marks: VecDeque<u8>,
    bad: Sparse<u16>,
    sp: Sparse<f64>,
    mv: Sparse<f64>,
}

impl Raw {
    fn starting(first: u64) -> Self {
        Self {
            first,
            times: Times::default(),
            op: VecDeque::new(),
            pv: VecDeque::new(),
            marks: VecDeque::new(),
            bad: Sparse::new(0),
            sp: Sparse::new(f64::NAN),
            mv: Sparse::new(f64::NAN),
        }
    }

    fn push(&mut self, p: &Point, most: usize) {
        let mut marks = if p.manual { MANUAL } else { 0 } | if p.filled { FILLED } else { 0 };
        if self.pv.back() == Some(&p.pv) {
            marks |= PV_REPEAT;
        }
        if self.op.back() == Some(&p.op) {
            marks |= OP_REPEAT;
        }
        let before = self.op.len();
        self.times.push(p.t_ns, most);
        put(&mut self.op, p.op, most);
        put(&mut self.pv, p.pv, most);
        put(&mut self.marks, marks, most);
        self.bad.push((p.bad > 0).then_some(p.bad), before, most);
        self.sp.push(p.sp, before, most);
        self.mv.push(p.mv, before, most);
    }

    fn get(&self, place: usize) -> Option<Bin> {
        let (op, marks) = (*self.op.get(place)?, *self.marks.get(place)?);
        let mark = |bit: u8| u16::from(marks & bit != 0);
        Some(Bin {
            t_ns: self.times.get(place)?,
            pv_sum: *self.pv.get(place)?,
            sp_sum: self.sp.get(place),
            mv_sum: self.mv.get(place),
            op: [op; 4],
            facts: [mark(MANUAL), mark(FILLED), self.bad.get(place), mark(PV_REPEAT), mark(OP_REPEAT)],
        })
    }

    fn pop_front(&mut self) -> Option<Bin> {
        let oldest = self.get(0);
        self.first += u64::from(oldest.is_some());
        self.times.pop_front();
        self.op.pop_front();
        self.pv.pop_front();
        self.marks.pop_front();
        self.bad.pop_front();
        self.sp.pop_front();
        self.mv.pop_front();
        oldest
    }

    fn bytes(&self) -> usize {
        let columns = self.times.bytes() + bytes(&self.op) + bytes(&self.pv) + bytes(&self.marks);
        columns + self.bad.bytes() + self.sp.bytes() + self.mv.bytes()
    }
}

/// Bins of one size, oldest first.
#[derive(Debug, Clone)]
struct Level {
    /// Index of the oldest, in bins.
    first: u64,
    times: Times,
    pv: VecDeque<f64>,
    op: VecDeque<[f64; 4]>,
    sp: Sparse<f64>,
    mv: Sparse<f64>,
    facts: Sparse<[u16; 5]>,
}

impl Level {
    fn starting(first: u64) -> Self {
        Self {
            first,
            times: Times::default(),
            pv: VecDeque::new(),
            op: VecDeque::new(),
            sp: Sparse::new(f64::NAN),
            mv: Sparse::new(f64::NAN),
            facts: Sparse::new([0; 5]),
        }
    }

    fn push(&mut self, bin: &Bin, most: usize) {
        let before = self.pv.len();
        self.times.push(bin.t_ns, most);
        put(&mut self.pv, bin.pv_sum, most);
        put(&mut self.op, bin.op, most);
        self.sp.push((!bin.sp_sum.is_nan()).then_some(bin.sp_sum), before, most);
        self.mv.push((!bin.mv_sum.is_nan()).then_some(bin.mv_sum), before, most);
        self.facts.push((bin.facts != [0; 5]).then_some(bin.facts), before, most);
    }

    fn get(&self, place: usize) -> Option<Bin> {
        Some(Bin {
            t_ns: self.times.get(place)?,
            pv_sum: *self.pv.get(place)?,
            sp_sum: self.sp.get(place),
            mv_sum: self.mv.get(place),
            op: *self.op.get(place)?,
            facts: self.facts.get(place),
        })
    }

    fn pop_front(&mut self) -> Option<Bin> {
        let oldest = self.get(0);
        self.first += u64::from(oldest.is_some());
        self.times.pop_front();
        self.pv.pop_front();
        self.op.pop_front();
        self.sp.pop_front();
        self.mv.pop_front();
        self.facts.pop_front();
        oldest
    }

    fn bytes(&self) -> usize {
        let columns = self.times.bytes() + bytes(&self.pv) + bytes(&self.op);
        size_of::<Self>() + columns + self.sp.bytes() + self.mv.bytes() + self.facts.bytes()
    }
}

/// One loop's points since the last break.
#[derive(Debug, Clone)]
pub struct History {
    max_points: usize,
    /// Number of bin sizes; older data are dropped.
    sizes: usize,
    raw: Arc<Raw>,
    /// `levels[l]` has bins of `2^(l+1)` points, older than all finer data.
    levels: Vec<Arc<Level>>,
    /// Points added since the last break; the newest has index `total - 1`.
    total: u64,
}

/// The history as it was after a number of points, for a window that was due then.
#[derive(Debug, Clone, Copy)]
pub struct View<'h> {
    history: &'h History,
    total: u64,
}

/// The next even number.
const fn even(n: u64) -> u64 {
    n.next_multiple_of(2)
}

impl History {
    /// An empty history of `max_points` raw points (and half as many bins of each size).
    #[must_use]
    pub fn new(max_points: usize) -> Self {
        Self::resumed(max_points, 0)
    }

    /// A history that continues after `total` points, without their data.
    #[must_use]
    pub fn resumed(max_points: usize, total: u64) -> Self {
        Self {
            max_points: max_points.max(16) & !1,
            sizes: ALL_SIZES,
            raw: Arc::new(Raw::starting(total)),
            levels: Vec::new(),
            total,
        }
    }

    /// The same history limited to this many bin sizes.
    #[must_use]
    pub fn with_sizes(self, sizes: usize) -> Self {
        Self { sizes, ..self }
    }

    /// Clears everything: the stretch has ended.
    pub fn clear(&mut self) {
        *self = Self::new(self.max_points).with_sizes(self.sizes);
    }

    /// Whether nothing is stored.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.raw.op.is_empty()
    }

    /// Points since the last break, stored or not.
    #[must_use]
    pub const fn total(&self) -> u64 {
        self.total
    }

    /// Timestamp of the newest point.
    #[must_use]
    pub fn newest_ns(&self) -> Option<i64> {
        self.raw.times.back()
    }

    /// Memory of the columns, bytes.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.raw.bytes() + self.levels.iter().map(|level| level.bytes()).sum::<usize>()
    }

    /// Adds a point; drops bins that end before `keep_from_ns`.
    pub fn push(&mut self, p: &Point, keep_from_ns: i64) {
        let limit = raw_limit(self.max_points);
        let raw = Arc::make_mut(&mut self.raw);
        raw.push(p, limit + 1);
        self.total += 1;
        if raw.op.len() > limit {
            // After a resumption the first point may be half of a bin whose other half is not stored: it is dropped.
            let odd = raw.first % 2 == 1;
            if let (Some(a), false) = (raw.pop_front(), odd)
                && let Some(b) = raw.pop_front()
            {
                self.sink(0, &Bin::join(&a, &b));
            }
        }
        if let Some(coarsest) = self.levels.last_mut()
            && coarsest.times.get(1).is_some_and(|second_ns| second_ns < keep_from_ns)
        {
            let coarsest = Arc::make_mut(coarsest);
            coarsest.pop_front();
            if coarsest.pv.is_empty() {
                self.levels.pop();
            }
        }
    }

    fn sink(&mut self, level: usize, bin: &Bin) {
        let limit = level_limit(self.max_points);
        if level >= self.sizes {
            return;
        }
        if self.levels.len() == level {
            let end = if level == 0 { self.raw.first } else { self.levels[level - 1].first };
            self.levels.push(Arc::new(Level::starting(end / 2 - 1)));
        }
        let of = Arc::make_mut(&mut self.levels[level]);
        of.push(bin, limit + 1);
        if of.pv.len() <= limit {
            return;
        }
        let odd = of.first % 2 == 1;
        if let (Some(a), false) = (of.pop_front(), odd)
            && let Some(b) = of.pop_front()
        {
            self.sink(level + 1, &Bin::join(&a, &b));
        }
    }

    /// The history as it was after `total` points, as far as the data are still stored.
    #[must_use]
    pub const fn at(&self, total: u64) -> View<'_> {
        View { history: self, total }
    }

    /// The current history.
    #[must_use]
    pub const fn now(&self) -> View<'_> {
        self.at(self.total)
    }

    /// The history as it was before the first point later than `end_ns`.
    #[must_use]
    pub fn up_to(&self, end_ns: i64) -> View<'_> {
        self.at(self.now().finest_index_at(end_ns.saturating_add(1)))
    }

    /// The bin of `2^level` points with this index, combined from finer ones if necessary.
    fn bin(&self, level: usize, index: u64) -> Option<Bin> {
        if level == 0 {
            return self.raw.get(index.checked_sub(self.raw.first)? as usize);
        }
        if let Some(of) = self.levels.get(level - 1) {
            let place = index.checked_sub(of.first)?;
            if let Some(bin) = of.get(place as usize) {
                return Some(bin);
            }
        }
        Some(Bin::join(&self.bin(level - 1, 2 * index)?, &self.bin(level - 1, 2 * index + 1)?))
    }
}

impl View<'_> {
    /// Points since the last break, stored or not.
    #[must_use]
    pub const fn total(&self) -> u64 {
        self.total
    }

    /// Timestamp of the newest point.
    #[must_use]
    pub fn newest_ns(&self) -> Option<i64> {
        let raw = &self.history.raw;
        raw.times.get(self.total.checked_sub(raw.first + 1)? as usize)
    }

    /// Timestamp of the oldest of the latest raw points that form a window, and their number.
    #[must_use]
    pub fn latest_raw(&self) -> Option<(i64, usize)> {
        let (raw, max_points) = (&self.history.raw, self.history.max_points as u64);
        let from = raw.first.max(self.total.saturating_sub(max_points));
        Some((raw.times.get((from - raw.first) as usize)?, (self.total - from) as usize))
    }

    /// Index of the first point at or after a time, as far back as there are data, at the start of a bin if it was in a bin
    /// then.
    fn index_at(&self, t_ns: i64) -> u64 {
        let index = self.finest_index_at(t_ns);
        // The positions of the bins follow from the number of points alone: the oldest of each size has an even index.
        let (limit, mut size) = (level_limit(self.history.max_points) as u64, 0);
        let mut first = even(self.total.saturating_sub(raw_limit(self.history.max_points) as u64));
        let mut found = index;
        while first > 0 && size < self.history.sizes {
            // The last bin of the next size begins two bins of this size before the first of this one.
            if (first - 2) << size < index {
                break;
            }
            size += 1;
            found = index.next_multiple_of(1 << size);
            first = even((first / 2).saturating_sub(limit));
        }
        found
    }

    fn finest_index_at(&self, t_ns: i64) -> u64 {
        let History { raw, levels, .. } = self.history;
        for (above, of) in levels.iter().enumerate().rev() {
            if of.times.back().is_some_and(|back_ns| back_ns >= t_ns) {
                return (of.first + of.times.place_at(t_ns) as u64) << (above + 1);
            }
        }
        (raw.first + raw.times.place_at(t_ns) as u64).min(self.total)
    }

    /// The record from `from_ns` to the newest point: raw if it fits into `max_points`, else in the smallest bins that do.
    /// `end_ns` becomes its name. `None` without data.
    #[must_use]
    pub fn record(&self, from_ns: i64, end_ns: i64) -> Option<Record> {
        let level_for = |from: u64| {
            let n = self.total.saturating_sub(from);
            (0..48).find(|l| (n >> l) <= self.history.max_points as u64).unwrap_or(48)
        };
        let mut from = self.index_at(from_ns);
        let coarse = level_for(from);
        from = from.next_multiple_of(1 << coarse);
        if from >= self.total {
            return None;
        }
        self.cut(from, level_for(from), end_ns)
    }

    /// The latest points in bins of `2^level`, at most `max_points`, none older than `from_ns`.
    #[must_use]
    pub fn latest(&self, level: usize, from_ns: i64, end_ns: i64) -> Option<Record> {
        let reach = (self.history.max_points as u64) << level;
        let from = self.index_at(from_ns).max(self.total.saturating_sub(reach)).next_multiple_of(1 << level);
        (from < self.total).then(|| self.cut(from, level, end_ns)).flatten()
    }

    /// How many samples each PV is held, by the latest that are kept as they came.
    fn held(&self, from: u64) -> usize {
        let kept = self.total.saturating_sub(self.history.max_points as u64).max(from);
        held_over(
            &(kept..self.total).filter_map(|at| self.history.bin(0, at)).map(|bin| bin.pv_sum).collect::<Vec<_>>(),
        )
    }

    fn cut(&self, from: u64, level: usize, end_ns: i64) -> Option<Record> {
        let (first_bin, end_bin) = (from >> level, self.total >> level);
        let bins: Vec<Bin> = (first_bin..end_bin).filter_map(|i| self.history.bin(level, i)).collect();
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
        let pv: Vec<f64> = bins.iter().map(|b| b.pv_sum / size).collect();
        let ts_s = s_from_ns(newest - first.t_ns) / (raw_samples.max(2) - 1) as f64;
        Some(Record {
            start_ns: first.t_ns,
            end_ns,
            ts_s,
            recorded_ts_s: ts_s,
            held: self.held(from),
            raw_samples,
            box_samples: 1 << level,
            op_path: if level == 0 {
                bins.iter().map(|b| b.op[Bin::FIRST]).collect()
            } else {
                bins.iter().flat_map(Bin::op_path).collect()
            },
            pv,
            sp: mean(|b| b.sp_sum),
            mv: mean(|b| b.mv_sum),
            irregularity: irregularity(&bins),
            facts,
        })
    }
}

/// Robust standard deviation over mean of the time between bins.
fn irregularity(bins: &[Bin]) -> f64 {
    let mut steps: Vec<i64> = bins.windows(2).map(|w| w[1].t_ns - w[0].t_ns).collect();
    if steps.len() < 4 {
        return 0.0;
    }
    steps.sort_unstable();
    let median = steps[steps.len() / 2];
    let mut off: Vec<i64> = steps.iter().map(|s| (s - median).abs()).collect();
    off.sort_unstable();
    // The 90th percentile, scaled as for a normal distribution: a jitter on a third of the steps must show.
    off[off.len() * 9 / 10] as f64 / 1.645 / median.max(1) as f64
}

/// The record of a stretch of points; above `max_points` the older ones are averaged in bins. `None` without points.
#[must_use]
pub fn record_of(points: &[Point], max_points: usize) -> Option<Record> {
    let mut history = History::new(points.len().max(16));
    for point in points {
        history.push(point, i64::MIN);
    }
    history.max_points = max_points.max(16) & !1;
    history.now().record(i64::MIN, points.last()?.t_ns)
}

#[cfg(test)]
mod tests;
