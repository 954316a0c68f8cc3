//! Stretches between changes: what changed, the state since then, and windows that disagree.

use super::changes::{Costs, Dated, dated, partition};
use super::level::{HALF_WIDTH, Level, Seen, squares};
use super::window::{History, Point};
use super::{Change, ChangeKind, Contradicting, Pooled, Trend, words};

/// Share of a stretch's windows with stiction above which the stretch counts as sticking.
const STICKS: f64 = 0.5;
/// A month and a week, s.
const MONTH_S: f64 = 30.44 * 86_400.0;
const WEEK_S: f64 = 7.0 * 86_400.0;
/// Fewest windows without overlap for a trend.
const LEAST_TREND: f64 = 6.0;
/// Normal quantile for a significant slope: 99 %, two-sided.
const CLEAR_SLOPE: f64 = 2.576;
/// A window contradicts its stretch if fewer than this many windows are expected so far off by chance.
const BY_CHANCE: f64 = 0.05;
/// Least confidence of a window with the opposite verdict that contradicts.
const SURE: f64 = 0.9;
/// Cost of a line relative to a change: one parameter more instead of three.
const LINE_COST: f64 = 1.0 / 3.0;

/// Windows with a common state.
#[derive(Debug, Clone)]
pub(super) struct Stretch {
    from: usize,
    to: usize,
    sticks: bool,
    /// Level or line of ln s.
    level: Option<Level>,
}

impl Stretch {
    fn of(history: &History<'_>, costs: &Costs, from: usize, to: usize) -> Self {
        let sticks = costs.found(from, to) >= STICKS;
        let seen = seen(&history.points[from..to]);
        let level = if sticks { Level::flat(&seen) } else { None };
        Self { from, to, sticks, level }
    }

    fn points<'h, 'a>(&self, history: &'h History<'a>) -> &'h [Point<'a>] {
        &history.points[self.from..self.to]
    }

    /// s at the middle of its time.
    fn s(&self, history: &History<'_>) -> Option<f64> {
        let times: Vec<f64> = seen(self.points(history)).iter().map(|s| s.t_s).collect();
        let middle = crate::core::signal::stats::mean(&times);
        self.level.map(|level| libm::exp(level.at(middle)))
    }
}

fn seen(points: &[Point<'_>]) -> Vec<Seen> {
    points.iter().filter_map(|p| p.seen).collect()
}

/// The stretches and the changes between them.
pub(super) struct Told {
    stretches: Vec<Stretch>,
    pub changes: Vec<Change>,
    /// Variance of ln s between windows, robust to changes and stray windows.
    between: f64,
}

impl Told {
    pub fn of(history: &History<'_>) -> Self {
        let costs = Costs::of(history);
        let ends = without_drift(history, &costs, &joined(&costs, partition(&costs)));
        let mut stretches: Vec<Stretch> =
            ends.windows(2).filter(|w| w[0] < w[1]).map(|w| Stretch::of(history, &costs, w[0], w[1])).collect();
        let changes = stretches.windows(2).filter_map(|w| change(history, &costs, &w[0], &w[1])).collect();
        if let Some(last) = stretches.last_mut().filter(|last| last.sticks) {
            last.level = drifting(&seen(last.points(history))).or(last.level);
        }
        Self { stretches, changes, between: costs.between }
    }

    /// Size since the last change.
    pub fn pooled(&self, history: &History<'_>) -> Option<Pooled> {
        let last = self.stretches.last().filter(|last| last.sticks)?;
        let level = last.level?;
        let points = last.points(history);
        let sized = seen(points);
        let now_s = sized.last()?.t_s;
        // A level has the same value at any time.
        let (x, half) = (level.at(now_s), level.half_width(now_s));
        let [s, low, high] = [x, x - half, x + half].map(libm::exp);
        let told: Vec<&Point<'_>> = points.iter().filter(|p| p.sticks).collect();
        let identified = jump_where_identified(&told);
        let j_identifiable = identified.is_some();
        let jump = identified.or_else(|| jump_allowed(&told));
        Some(Pooled {
            s,
            s_interval: [low, high],
            j: jump.map(|(j, _)| j.min(high)),
            j_interval: jump.map(|(_, [l, h])| [l.min(high), h.min(high)]),
            j_identifiable,
            windows: sized.len(),
            independent_windows: level.independent,
            between_windows_pct: 100.0 * libm::expm1(level.between.sqrt()),
        })
    }

    /// Growth of s since the last change, if significant.
    pub fn trend(&self, history: &History<'_>) -> Option<Trend> {
        let last = self.stretches.last()?;
        let level = last.level.filter(|level| level.slope != 0.0)?;
        let sized = seen(last.points(history));
        let now_s = sized.last()?.t_s;
        let (x, half) = (level.at(now_s), level.half_width(now_s));
        let month = |slope: f64| libm::expm1(slope * MONTH_S);
        let slopes = [-1.0, 1.0].map(|side| month(level.slope + side * level.slope_half_width(HALF_WIDTH)));
        // Both s and its growth are uncertain: the interval contains all their products.
        let products = slopes.map(|m| [libm::exp(x - half) * m, libm::exp(x + half) * m]);
        let ends =
            products.iter().flatten().fold([f64::INFINITY, f64::NEG_INFINITY], |[l, h], v| [l.min(*v), h.max(*v)]);
        Some(Trend {
            s_per_month: libm::exp(x) * month(level.slope),
            s_per_month_interval: ends,
            pct_per_month: 100.0 * month(level.slope),
            since_ns: history.points[last.from].result.start_ns,
        })
    }

    /// Windows that disagree with their stretch by more than chance allows, except those that span a change.
    pub fn contradicting(&self, history: &History<'_>) -> Vec<Contradicting> {
        let excused =
            |p: &Point<'_>| self.changes.iter().any(|c| p.result.start_ns < c.to_ns && c.from_ns < p.result.end_ns);
        let mut out = Vec::new();
        for stretch in &self.stretches {
            let points = stretch.points(history);
            let agree = points.iter().filter(|p| p.sticks == stretch.sticks).count();
            for point in points.iter().filter(|p| !excused(p)) {
                let why = if point.sticks != stretch.sticks {
                    let sure = if point.sticks { point.p } else { 1.0 - point.p };
                    (sure >= SURE).then(|| words::opposite(point.sticks, point.p, agree, points.len()))
                } else {
                    self.off(stretch, point, points.len())
                };
                let Some(why) = why else { continue };
                let w = point.result;
                let why = words::with_gates(why, &w.gates);
                out.push(Contradicting { end_ns: w.end_ns, s: w.s, s_interval: w.s_interval, why });
            }
        }
        out
    }

    /// Why a window's size contradicts its stretch, if it does.
    fn off(&self, stretch: &Stretch, point: &Point<'_>, windows: usize) -> Option<String> {
        let (level, seen) = (stretch.level?, point.seen?);
        let expected = level.at(seen.t_s);
        let spread = (seen.variance + self.between).sqrt();
        let z = (seen.x - expected).abs() / spread;
        let by_chance = libm::erfc(z / core::f64::consts::SQRT_2) * windows as f64;
        let excludes = z * spread > HALF_WIDTH * seen.variance.sqrt();
        (by_chance < BY_CHANCE && excludes).then(|| words::off(point.result, libm::exp(expected), windows))
    }
}

/// The partition without changes between two stretches without stiction.
fn joined(costs: &Costs, ends: Vec<usize>) -> Vec<usize> {
    let last = ends.len().saturating_sub(1);
    let sticks = |i: usize| costs.found(ends[i], ends[i + 1]) >= STICKS;
    let keep = |i: usize| i == 0 || i == last || sticks(i - 1) || sticks(i);
    (0..ends.len()).filter(|&i| keep(i)).map(|i| ends[i]).collect()
}

/// The partition without steps between sticking stretches that a straight line explains at less cost.
fn without_drift(history: &History<'_>, costs: &Costs, ends: &[usize]) -> Vec<usize> {
    let sticks = |i: usize| costs.found(ends[i], ends[i + 1]) >= STICKS;
    let stretches = ends.len().saturating_sub(1);
    let mut out = vec![0];
    let mut i = 0;
    while i < stretches {
        let mut j = i + 1;
        while j < stretches && sticks(i) && sticks(j) {
            j += 1;
        }
        let inner = &ends[i..=j];
        if j > i + 1 && !drifts(history, costs, inner) {
            out.extend_from_slice(&inner[1..]);
        } else {
            out.push(ends[j]);
        }
        i = j;
    }
    out
}

/// Whether a line costs less than the steps at `ends`.
fn drifts(history: &History<'_>, costs: &Costs, ends: &[usize]) -> bool {
    let (Some(from), Some(to)) = (ends.first(), ends.last()) else { return false };
    let sized = seen(&history.points[*from..*to]);
    if drifting(&sized).is_none() {
        return false;
    }
    let saved = squares(&sized, false, costs.between) - squares(&sized, true, costs.between);
    costs.of_partition(&[*from, *to]) - saved + LINE_COST * costs.penalty < costs.of_partition(ends)
}

/// The line through sizes that clearly rise or fall over at least a week.
fn drifting(sized: &[Seen]) -> Option<Level> {
    let lasts = sized.last()?.t_s - sized.first()?.t_s;
    let line = Level::line(sized)?;
    let enough = lasts >= WEEK_S && line.independent >= LEAST_TREND;
    (enough && line.slope.abs() > line.slope_half_width(CLEAR_SLOPE)).then_some(line)
}

/// The change from one stretch to the next; `None` if neither sticks.
fn change(history: &History<'_>, costs: &Costs, before: &Stretch, after: &Stretch) -> Option<Change> {
    let Dated { at_ns, from_ns, to_ns, p } = dated(history, costs, before.from, after.from, after.to);
    let kind = match (before.sticks, after.sticks) {
        (false, false) => return None,
        (true, false) => ChangeKind::Repaired,
        (false, true) => ChangeKind::Worse,
        (true, true) => both_stick(costs, before, after),
    };
    Some(Change { at_ns, from_ns, to_ns, kind, s_before: before.s(history), s_after: after.s(history), p })
}

/// Better or worse, by s if it differs clearly, else by the share of windows with stiction.
fn both_stick(costs: &Costs, before: &Stretch, after: &Stretch) -> ChangeKind {
    let found = |s: &Stretch| costs.found(s.from, s.to);
    let by_share = found(after) - found(before);
    let by_size = before.level.zip(after.level).map(|(b, a)| {
        let half = |l: &Level| l.half_width(0.0);
        let (difference, both) = (a.at(0.0) - b.at(0.0), (half(&a) * half(&a) + half(&b) * half(&b)).sqrt());
        if difference.abs() > both { difference } else { 0.0 }
    });
    let worse = by_size.filter(|d| *d != 0.0).unwrap_or(by_share) > 0.0;
    if worse { ChangeKind::Worse } else { ChangeKind::Better }
}

/// The slip jump from the windows that identify it.
fn jump_where_identified(told: &[&Point<'_>]) -> Option<(f64, [f64; 2])> {
    let jump = |p: &&&Point<'_>| -> Option<Seen> {
        let w = p.result;
        let ([low, high], j) = (w.j_interval.filter(|_| w.j_identifiable == Some(true))?, w.j?);
        let least = 0.01 * w.s.unwrap_or(0.0).abs();
        let sd = ((high - low) / (2.0 * HALF_WIDTH)).max(least).max(f64::MIN_POSITIVE.sqrt());
        let usable = j.is_finite() && sd.is_finite();
        usable.then_some(Seen { x: j, variance: sd * sd, share: p.share, t_s: 0.0 })
    };
    let all: Vec<Seen> = told.iter().filter_map(|p| jump(&p)).collect();
    let level = Level::flat(&all)?;
    let (j, half) = (level.at(0.0).max(0.0), level.half_width(0.0));
    Some((j, [(j - half).max(0.0), j + half]))
}

/// The slip jumps compatible with most windows: where the feasible sets overlap most. The estimate is the mean of their
/// values, limited to that range.
fn jump_allowed(told: &[&Point<'_>]) -> Option<(f64, [f64; 2])> {
    let sets: Vec<[f64; 2]> = told.iter().filter_map(|p| p.result.j_interval).filter(|[l, h]| l <= h).collect();
    let holding = |x: f64| sets.iter().filter(|[l, h]| *l <= x && x <= *h).count();
    let most = sets.iter().map(|[low, _]| holding(*low)).max()?;
    let low = sets.iter().map(|s| s[0]).filter(|low| holding(*low) == most).fold(f64::INFINITY, f64::min);
    let high = sets.iter().map(|s| s[1]).filter(|h| *h >= low && holding(*h) == most).fold(low, f64::max);
    let best: Vec<f64> = told.iter().filter_map(|p| p.result.j).filter(|j| j.is_finite()).collect();
    let j = if best.is_empty() { 0.5 * (low + high) } else { crate::core::signal::stats::mean(&best).clamp(low, high) };
    Some((j, [low, high]))
}
