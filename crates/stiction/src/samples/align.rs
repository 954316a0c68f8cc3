//! Joins the signals of one loop by source time into points at the loop's own sampling times.
//!
//! Nothing is resampled: there is a point at each timestamp of the *driver* (PV, or OP if OP arrives clearly more often), with
//! the other signals held. Only lost samples are filled in, and only in gaps of at most `max_gap_s`: PV is interpolated
//! linearly, and so is OP if it is sampled; otherwise OP is held. The loop's clock is the latest timestamp minus the allowed
//! lateness, so late and unordered samples are sorted in, independently of other loops and the system clock.

use std::collections::VecDeque;

use serde::{Deserialize, Serialize};

use super::op_trail::OpTrail;
use crate::core::record::{Mode, Sample, Signal, Value};
use crate::core::units::{ns_from_s, s_from_ns};

/// Number of the driver's intervals used to learn the sampling time.
const LEARN_INTERVALS: usize = 16;
/// Most samples waiting before the oldest is taken in any case.
const PENDING_LIMIT: usize = 4096;
/// Samples between checks of the waiting buffer's capacity: memory used for learning the sampling time is returned, but a loop
/// with batches does not reallocate for each of them.
const SHRINK_FIRST: u64 = 64;
const SHRINK_EVERY: u64 = 4096;
/// Half of the minimum capacity of the waiting buffer.
const SMALL: usize = 8;
/// Most samples waiting while the sampling time is learned from only one of OP and PV.
const LEARN_LIMIT: usize = 2048;
/// Consecutive late samples after which the plant's clock counts as set back.
const CLOCK_RESET_AFTER: usize = 256;
/// Consecutive intervals that contradict the sampling time before it is learned again.
const RELEARN_AFTER: u8 = 16;
/// Fewest sampling times for which one of OP and PV waits for the other, because gateways send them in batches, one after the
/// other. Twice the longest lead seen is used if longer, up to [`MAX_PATIENCE`], which also applies while one of them has never
/// arrived.
const MIN_PATIENCE: f64 = 128.0;
/// Most sampling times of waiting.
const MAX_PATIENCE: f64 = 2000.0;

/// Convention of quality codes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Quality {
    /// OPC UA status codes: the two upper bits are 0 for good. Codes of classic OPC all look good by this convention.
    #[default]
    Ua,
    /// Classic OPC: 192 to 255 are good.
    Classic,
}

impl Quality {
    /// Whether a code means good quality.
    #[must_use]
    pub const fn is_good(self, code: u32) -> bool {
        match self {
            Self::Ua => code >> 30 == 0,
            Self::Classic => code & 0xC0 == 0xC0,
        }
    }
}

/// Settings of the aligner.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct AlignParams {
    /// Allowed lateness of a sample, ns.
    pub lateness_ns: i64,
    /// Longest gap that is filled, and longest time for which a value is held, s; 0 means five sampling times.
    pub max_gap_s: f64,
    /// Convention of quality codes.
    pub quality: Quality,
    /// Numeric codes of modes.
    pub modes: Vec<(i64, Mode)>,
}

/// One point of a loop: its signals at one timestamp.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Point {
    /// Source time, ns.
    pub t_ns: i64,
    /// Controller output.
    pub op: f64,
    /// Process variable.
    pub pv: f64,
    /// Set point, if one is known.
    pub sp: Option<f64>,
    /// Valve position, if one is known.
    pub mv: Option<f64>,
    /// Controller in manual.
    pub manual: bool,
    /// Filled in for a lost sample.
    pub filled: bool,
    /// Bad or missing values since the previous point.
    pub bad: u16,
}

/// Output of the aligner.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Aligned {
    /// The next point of the stretch.
    Point(Point),
    /// The stretch ends: a gap too long to fill, another sampling time, or a clock that was set back.
    Break,
}

/// Numbers of dropped and filled-in samples since the start.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[allow(missing_docs)] // the names say it
pub struct AlignCounts {
    pub taken: u64,
    pub duplicates: u64,
    pub late: u64,
    pub bad: u64,
    pub gaps: u64,
    pub filled: u64,
    pub clock_resets: u64,
    pub stamp_outliers: u64,
    pub overflow: u64,
}

impl AlignCounts {
    /// Adds another loop's counts.
    pub const fn add(&mut self, other: &Self) {
        self.taken += other.taken;
        self.duplicates += other.duplicates;
        self.late += other.late;
        self.bad += other.bad;
        self.gaps += other.gaps;
        self.filled += other.filled;
        self.clock_resets += other.clock_resets;
        self.stamp_outliers += other.stamp_outliers;
        self.overflow += other.overflow;
    }
}

/// Aligns one loop's samples.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Aligner {
    /// Sorted by timestamp, then by signal.
    pending: VecDeque<Sample>,
    /// Samples far ahead of the rest, until another timestamp confirms them.
    suspects: Vec<Sample>,
    /// Consecutive late samples, kept in case the clock was set back.
    late_run: Vec<Sample>,
    greatest_ns: Option<i64>,
    /// Latest timestamps of OP and of PV.
    partners_ns: [Option<i64>; 2],
    /// Longest lead of one of them over the other, ns.
    lead_ns: i64,
    /// A break to report before the next sample.
    broken: bool,
    processed_ns: Option<i64>,
    /// Sampling time and driver, once learned.
    learnt: Option<(f64, Signal)>,
    off_beat: u8,
    #[serde(flatten)]
    op: OpTrail,
    pv: Option<(i64, f64)>,
    sp: Option<f64>,
    mv: Option<f64>,
    mode: Option<Mode>,
    last_point: Option<(i64, f64)>,
    bad_since: u16,
    counts: AlignCounts,
}

impl Default for Aligner {
    fn default() -> Self {
        Self::new()
    }
}

impl Aligner {
    /// An aligner before its first sample.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            pending: VecDeque::new(),
            suspects: Vec::new(),
            late_run: Vec::new(),
            greatest_ns: None,
            partners_ns: [None; 2],
            lead_ns: 0,
            broken: false,
            processed_ns: None,
            learnt: None,
            off_beat: 0,
            op: OpTrail::new(),
            pv: None,
            sp: None,
            mv: None,
            mode: None,
            last_point: None,
            bad_since: 0,
            counts: AlignCounts {
                taken: 0,
                duplicates: 0,
                late: 0,
                bad: 0,
                gaps: 0,
                filled: 0,
                clock_resets: 0,
                stamp_outliers: 0,
                overflow: 0,
            },
        }
    }

    /// Timestamp of the oldest waiting sample.
    #[must_use]
    pub fn waiting_ns(&self) -> Option<i64> {
        self.pending.front().map(|s| s.t_ns)
    }

    /// The latest accepted timestamp.
    #[must_use]
    pub const fn greatest_ns(&self) -> Option<i64> {
        self.greatest_ns
    }

    /// Counters since the start.
    #[must_use]
    pub const fn counts(&self) -> &AlignCounts {
        &self.counts
    }

    /// Bytes of waiting and remembered samples, in addition to the aligner itself.
    #[must_use]
    pub fn bytes(&self) -> usize {
        let samples = self.pending.capacity() + self.suspects.capacity() + self.late_run.capacity();
        samples * size_of::<Sample>() + self.op.bytes()
    }

    /// The loop's clock: the latest timestamp minus the lateness, ns.
    #[must_use]
    pub fn event_time_ns(&self, params: &AlignParams) -> Option<i64> {
        self.greatest_ns.map(|t| t.saturating_sub(params.lateness_ns))
    }

    /// The learned sampling time, s.
    #[must_use]
    pub fn sampling_time_s(&self) -> Option<f64> {
        self.learnt.map(|(ts_s, _)| ts_s)
    }

    /// Number of bad values since the last point.
    #[must_use]
    pub const fn bad_since_last_point(&self) -> u16 {
        self.bad_since
    }

    fn max_gap_s(&self, params: &AlignParams) -> f64 {
        if params.max_gap_s > 0.0 { params.max_gap_s } else { 5.0 * self.learnt.map_or(60.0, |(ts_s, _)| ts_s) }
    }

    /// A longer step forward must be confirmed by a second timestamp.
    fn jump_limit_ns(&self, params: &AlignParams) -> i64 {
        ns_from_s((10.0 * self.max_gap_s(params)).max(3600.0)).saturating_add(params.lateness_ns)
    }

    /// Takes one sample.
    pub fn push(&mut self, sample: Sample, params: &AlignParams) {
        // Half the range of the clock, 1824 to 2116, so that the difference of any two timestamps fits.
        if sample.t_ns.unsigned_abs() > i64::MAX.unsigned_abs() / 2 {
            self.counts.stamp_outliers += 1;
            return;
        }
        if self.processed_ns.is_some_and(|p| sample.t_ns <= p) {
            self.take_late(sample, params);
            return;
        }
        self.late_run.clear();
        let ahead = self.greatest_ns.is_some_and(|g| sample.t_ns.saturating_sub(g) > self.jump_limit_ns(params));
        if ahead {
            self.suspect(sample, params);
        } else {
            self.counts.stamp_outliers += self.suspects.len() as u64;
            self.suspects.clear();
            self.insert(sample);
        }
    }

    fn suspect(&mut self, sample: Sample, params: &AlignParams) {
        let Some(first) = self.suspects.first().map(|s| s.t_ns) else {
            self.suspects.push(sample);
            return;
        };
        let near = sample.t_ns.abs_diff(first) <= self.jump_limit_ns(params).unsigned_abs();
        if near && sample.t_ns != first {
            for suspect in std::mem::take(&mut self.suspects) {
                self.insert(suspect);
            }
            self.insert(sample);
        } else if near && self.suspects.len() < Signal::ALL.len() {
            self.suspects.push(sample);
        } else {
            self.counts.stamp_outliers += self.suspects.len() as u64;
            self.suspects.clear();
            self.suspects.push(sample);
        }
    }

    fn take_late(&mut self, sample: Sample, params: &AlignParams) {
        let duplicate = self.processed_ns == Some(sample.t_ns);
        if duplicate {
            self.counts.duplicates += 1;
            return;
        }
        self.counts.late += 1;
        self.note_lead(&sample);
        // A signal that merely lags the others has not gone back itself.
        if self.own_greatest(sample.signal).is_none_or(|own| sample.t_ns >= own) {
            return;
        }
        self.late_run.push(sample);
        if self.late_run.len() < CLOCK_RESET_AFTER {
            return;
        }
        // A gateway that resends a long backlog looks the same; then the newer stretch is lost, but the daemon keeps working.
        let run = std::mem::take(&mut self.late_run);
        let counts = AlignCounts { clock_resets: self.counts.clock_resets + 1, ..self.counts };
        let (sp, mv, mode, lead_ns) = (self.sp, self.mv, self.mode, self.lead_ns);
        *self = Self { counts, broken: true, sp, mv, mode, lead_ns, ..Self::new() };
        for sample in run {
            self.push(sample, params);
        }
    }

    fn insert(&mut self, sample: Sample) {
        self.greatest_ns = Some(self.greatest_ns.map_or(sample.t_ns, |g| g.max(sample.t_ns)));
        self.note_lead(&sample);
        let key = (sample.t_ns, sample.signal);
        let place = self.pending.partition_point(|s| (s.t_ns, s.signal) < key);
        if self.pending.get(place).is_some_and(|s| (s.t_ns, s.signal) == key) {
            self.counts.duplicates += 1;
            return;
        }
        self.pending.insert(place, sample);
    }

    /// The latest timestamp of OP or PV; for other signals, the latest of all.
    fn own_greatest(&self, signal: Signal) -> Option<i64> {
        match signal {
            Signal::Op => self.partners_ns[0],
            Signal::Pv => self.partners_ns[1],
            _ => self.greatest_ns,
        }
    }

    /// Records the progress of OP and PV, and the lead of one over the other.
    fn note_lead(&mut self, sample: &Sample) {
        let Some(own) = [Signal::Op, Signal::Pv].iter().position(|s| *s == sample.signal) else { return };
        if self.partners_ns[own].is_none_or(|own| sample.t_ns > own) {
            if let Some(other) = self.partners_ns[1 - own] {
                self.lead_ns = self.lead_ns.max(other.saturating_sub(sample.t_ns));
            }
            self.partners_ns[own] = Some(sample.t_ns);
        }
    }

    /// How long one of OP and PV waits for the other, ns.
    fn patience_ns(&self) -> i64 {
        let beats = |n: f64| ns_from_s(n * self.learnt.map_or(0.0, |(ts_s, _)| ts_s));
        if self.partners_ns.contains(&None) {
            return beats(MAX_PATIENCE);
        }
        self.lead_ns.saturating_mul(2).clamp(beats(MIN_PATIENCE), beats(MAX_PATIENCE))
    }

    /// Ends the input: all waiting samples may be taken.
    pub fn finish(&mut self) {
        for suspect in std::mem::take(&mut self.suspects) {
            self.insert(suspect);
        }
        self.greatest_ns = Some(i64::MAX);
        if self.learnt.is_none() {
            self.learn();
        }
    }

    /// Timestamp of the next sample that may be taken, if any.
    pub fn next_ready_ns(&mut self, params: &AlignParams) -> Option<i64> {
        let overflow = self.pending.len() >= PENDING_LIMIT;
        if self.learnt.is_none() {
            let of = |signal| self.pending.iter().filter(|s| s.signal == signal).count();
            let (pv, op) = (of(Signal::Pv), of(Signal::Op));
            if pv.min(op) <= LEARN_INTERVALS && (pv.max(op) <= LEARN_INTERVALS || self.pending.len() < LEARN_LIMIT) {
                return None;
            }
            self.learn();
        }
        let t_ns = self.pending.front()?.t_ns;
        let event_time = self.event_time_ns(params)?;
        let partner = self.partners_ns[0].min(self.partners_ns[1]);
        let joined = partner.is_some_and(|p| t_ns <= p) || t_ns <= event_time.saturating_sub(self.patience_ns());
        if t_ns <= event_time && joined {
            return Some(t_ns);
        }
        if overflow {
            self.counts.overflow += 1;
        }
        overflow.then_some(t_ns)
    }

    /// Learns sampling time and driver from the waiting samples: PV drives unless OP arrives clearly more often.
    fn learn(&mut self) {
        let interval = |signal| {
            let stamps: Vec<i64> = self.pending.iter().filter(|s| s.signal == signal).map(|s| s.t_ns).collect();
            let mut steps: Vec<i64> = stamps.windows(2).map(|w| w[1] - w[0]).collect();
            steps.sort_unstable();
            steps.get(steps.len() / 2).copied()
        };
        let choice = match (interval(Signal::Pv), interval(Signal::Op)) {
            (Some(pv), Some(op)) if pv as f64 > 1.5 * op as f64 => Some((op, Signal::Op)),
            (Some(pv), _) => Some((pv, Signal::Pv)),
            (None, Some(op)) => Some((op, Signal::Pv)),
            (None, None) => None,
        };
        if let Some((step_ns, driver)) = choice {
            self.learnt = Some((s_from_ns(step_ns.max(1)), driver));
        } else if !self.pending.is_empty() {
            self.learnt = Some((1.0, Signal::Pv));
        }
    }

    /// Takes the next sample, if [`Self::next_ready_ns`] returned one, and outputs what it completes.
    pub fn take_next(&mut self, params: &AlignParams, out: &mut impl FnMut(Aligned)) {
        let Some(sample) = self.pending.pop_front() else { return };
        let looks = self.counts.taken == SHRINK_FIRST || self.counts.taken.is_multiple_of(SHRINK_EVERY);
        let wanted = 2 * self.pending.len().max(SMALL);
        if looks && self.pending.capacity() > 2 * wanted {
            self.pending.shrink_to(wanted);
        }
        if std::mem::take(&mut self.broken) {
            out(Aligned::Break);
        }
        self.counts.taken += 1;
        let closes_stamp = self.pending.front().is_none_or(|next| next.t_ns > sample.t_ns);
        self.hold(&sample, params);
        if closes_stamp {
            self.processed_ns = Some(sample.t_ns);
            self.point_at(sample.t_ns, params, out);
        }
    }

    /// Stores one sample's value.
    fn hold(&mut self, sample: &Sample, params: &AlignParams) {
        if sample.quality.is_some_and(|code| !params.quality.is_good(code)) {
            return self.count_bad(sample);
        }
        match (sample.signal, sample.value) {
            (Signal::Mode, Value::Mode(mode)) => self.mode = Some(mode),
            (Signal::Mode, Value::Number(n)) => {
                let mapped = params.modes.iter().find(|(number, _)| *number as f64 == n);
                self.mode = Some(mapped.map_or(Mode::Unknown, |(_, mode)| *mode));
            }
            (Signal::Op, Value::Number(v)) => self.op.push(sample.t_ns, v),
            (Signal::Pv, Value::Number(v)) => self.pv = Some((sample.t_ns, v)),
            (Signal::Sp, Value::Number(v)) => self.sp = Some(v),
            (Signal::Mv, Value::Number(v)) => self.mv = Some(v),
            _ => self.count_bad(sample),
        }
    }

    fn count_bad(&mut self, sample: &Sample) {
        self.counts.bad += 1;
        if matches!(sample.signal, Signal::Op | Signal::Pv) {
            self.bad_since = self.bad_since.saturating_add(1);
        }
        if sample.signal == Signal::Op {
            self.op.note_lost(sample.t_ns);
        }
    }

    /// Whether signals are sampled, not sent on change: true unless `max_gap_s` is set.
    fn is_sampled(params: &AlignParams) -> bool {
        params.max_gap_s == 0.0
    }

    /// Outputs the point at a timestamp if the driver has a value there and the other signal is recent enough.
    fn point_at(&mut self, t_ns: i64, params: &AlignParams, out: &mut impl FnMut(Aligned)) {
        let (Some((ts_s, driver)), Some((t_op, op)), Some((t_pv, pv))) = (self.learnt, self.op.latest(), self.pv)
        else {
            return;
        };
        let (driver_ns, other_ns) = if driver == Signal::Pv { (t_pv, t_op) } else { (t_op, t_pv) };
        if driver_ns != t_ns || s_from_ns(t_ns - other_ns) > self.max_gap_s(params) {
            return;
        }
        if self.op.check_point(t_ns) && Self::is_sampled(params) {
            // This point is filled in once the next OP is known, and counted then.
            self.bad_since -= u16::from(self.op.is_empty_at(t_ns) && self.bad_since > 0);
            return;
        }
        if let Some((last_ns, last_pv)) = self.last_point {
            let step_s = s_from_ns(t_ns - last_ns);
            let on_beat = (0.6..1.6).contains(&(step_s / ts_s));
            self.off_beat = if on_beat { 0 } else { self.off_beat + 1 };
            if self.off_beat >= RELEARN_AFTER {
                self.relearn(step_s, out);
            } else if step_s > self.max_gap_s(params) {
                self.counts.gaps += 1;
                out(Aligned::Break);
            } else {
                self.fill([(last_ns, last_pv), (t_ns, pv)], ts_s, params, out);
            }
        }
        let bad = std::mem::take(&mut self.bad_since);
        out(Aligned::Point(self.point(t_ns, op, pv, false, bad)));
        self.last_point = Some((t_ns, pv));
        self.op.restart();
    }

    /// Handles a change of the sampling time: the stretch ends and the new one starts with the last interval.
    fn relearn(&mut self, step_s: f64, out: &mut impl FnMut(Aligned)) {
        if let Some((ts_s, _)) = &mut self.learnt {
            *ts_s = step_s.max(1e-9);
        }
        self.off_beat = 0;
        self.counts.gaps += 1;
        out(Aligned::Break);
    }

    /// Fills in samples lost between two points.
    fn fill(
        &mut self,
        [(t0, pv0), (t1, pv1)]: [(i64, f64); 2],
        ts_s: f64,
        params: &AlignParams,
        out: &mut impl FnMut(Aligned),
    ) {
        let steps = (s_from_ns(t1 - t0) / ts_s).round();
        let (sampled, since_ns) = (Self::is_sampled(params), t0.saturating_sub(ns_from_s(ts_s)));
        // A gap that is filled has a few hundred lost samples at most, unless max_gap_s is extreme.
        let lost = (steps.max(1.0) as usize - 1).min(10_000);
        for k in 1..=lost {
            let share = k as f64 / (lost + 1) as f64;
            let t_ns = t0 + ((t1 - t0) as f64 * share) as i64;
            let op = if sampled { self.op.interpolated_at(t_ns, since_ns) } else { self.op.held_at(t_ns) };
            let Some(op) = op else { return };
            self.counts.filled += 1;
            out(Aligned::Point(self.point(t_ns, op, pv0 + share * (pv1 - pv0), true, 0)));
        }
    }

    fn point(&self, t_ns: i64, op: f64, pv: f64, filled: bool, bad: u16) -> Point {
        let manual = self.mode == Some(Mode::Manual);
        Point { t_ns, op, pv, sp: self.sp, mv: self.mv, manual, filled, bad }
    }
}

/// Aligns a whole recording of one loop to its stretches of points, oldest first. Pass the samples of all signals
/// together, roughly in the order of their timestamps: a sample older than the latest by more than the lateness is dropped
/// and counted as late.
#[must_use]
pub fn align_all(samples: &[Sample], params: &AlignParams) -> (Vec<Vec<Point>>, AlignCounts) {
    let mut aligner = Aligner::new();
    let mut stretches = vec![Vec::new()];
    let mut take = |aligner: &mut Aligner| {
        while aligner.next_ready_ns(params).is_some() {
            aligner.take_next(params, &mut |aligned| match aligned {
                Aligned::Point(point) => {
                    if let Some(stretch) = stretches.last_mut() {
                        stretch.push(point);
                    }
                }
                Aligned::Break => stretches.push(Vec::new()),
            });
        }
    };
    for sample in samples {
        aligner.push(*sample, params);
        take(&mut aligner);
    }
    aligner.finish();
    take(&mut aligner);
    stretches.retain(|s: &Vec<Point>| !s.is_empty());
    (stretches, *aligner.counts())
}
