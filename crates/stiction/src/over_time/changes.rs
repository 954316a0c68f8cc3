//! Changes between windows: the partition into stretches with the least cost.
//!
//! A stretch costs twice the negative log likelihood of its windows with a constant share of windows that find stiction and a
//! constant ln s; each change adds a penalty. The optimal partition is found exactly by dynamic programming with pruning
//! (PELT; Killick, Fearnhead and Eckley 2012).

use super::level::Seen;
use super::window::History;
use crate::core::signal::stats;

/// Fewest windows on each side of a change.
pub(super) const LEAST_SIDE: usize = 3;
/// The penalty is `PENALTY[0] + PENALTY[1] ln(windows without overlap)`. If few pairs of windows give the variance between
/// them, sizes are down-weighted by 1 + `FEW_PAIRS` / pairs. Chosen by simulation, see [`FALSE_ALARMS`].
const PENALTY: [f64; 2] = [4.0, 3.0];
const FEW_PAIRS: f64 = 6.0;
/// Largest share of histories of 500 windows without a change in which one is found.
const FALSE_ALARMS: f64 = 0.01;
/// Bounds of the share of windows in a stretch that find stiction.
const SHARES: [f64; 2] = [0.02, 0.98];
/// Most places for a change examined at once; in longer histories every second, third, … window is one.
const MOST_PLACES: usize = 1_500;
/// Neighbours on each side used to find a stray window, and the deviation allowed, in standard deviations.
const STRAY_SIDE: usize = 2;
const STRAY: f64 = 3.0;
/// Coverage of a date's interval.
const DATE_LEVEL: f64 = 0.9;

/// Cumulative sums, from which the cost of any stretch follows.
pub(super) struct Costs {
    /// Per window: share, share times p, weight, weight times x, weight times x squared.
    sums: Vec<[f64; 5]>,
    /// Penalty of a change.
    pub penalty: f64,
    /// Variance of ln s between windows.
    pub between: f64,
}

impl Costs {
    pub fn of(history: &History<'_>) -> Self {
        let between = history.scatter.between;
        let doubt = history.scatter.pairs.map_or(1.0, |pairs| 1.0 + FEW_PAIRS / pairs);
        let mut sizes = without_strays(history).into_iter();
        let mut sums = vec![[0.0; 5]];
        let mut sum = [0.0; 5];
        for point in &history.points {
            let size = point.seen.and_then(|s| Some((s.share / (s.variance + between) / doubt, sizes.next()?)));
            let (weight, x) = size.unwrap_or((0.0, 0.0));
            let more = [point.share, point.share * point.weighed, weight, weight * x, weight * x * x];
            sum.iter_mut().zip(more).for_each(|(s, m)| *s += m);
            sums.push(sum);
        }
        let penalty = PENALTY[0] + PENALTY[1] * libm::log(sum[0].max(1.0));
        Self { sums, penalty, between }
    }

    /// Cost of the windows `a` to `b`, excluding `b`.
    fn of_stretch(&self, a: usize, b: usize) -> f64 {
        let [n, p, w, wx, wxx] = core::array::from_fn(|i| self.sums[b][i] - self.sums[a][i]);
        let sized = if w > 0.0 { (wxx - wx * wx / w).max(0.0) } else { 0.0 };
        if n <= 0.0 {
            return sized;
        }
        let q = (p / n).clamp(SHARES[0], SHARES[1]);
        sized - 2.0 * (p * libm::log(q) + (n - p) * libm::log(1.0 - q))
    }

    /// Share of these windows that find stiction.
    pub fn found(&self, a: usize, b: usize) -> f64 {
        let [n, p] = [0, 1].map(|i| self.sums[b][i] - self.sums[a][i]);
        if n > 0.0 { p / n } else { 0.0 }
    }

    /// Gain in log likelihood by a change at `k` in the windows `a` to `b`, times two.
    fn gain(&self, a: usize, k: usize, b: usize) -> f64 {
        self.of_stretch(a, b) - self.of_stretch(a, k) - self.of_stretch(k, b)
    }

    /// Cost of the same windows with the partition `ends`, penalties included.
    pub fn of_partition(&self, ends: &[usize]) -> f64 {
        let stretches: f64 = ends.windows(2).map(|w| self.of_stretch(w[0], w[1])).sum();
        stretches + self.penalty * ends.len().saturating_sub(2) as f64
    }

    /// Share of histories without a change that have no step of this gain.
    fn sureness(&self, gain: f64) -> f64 {
        1.0 - FALSE_ALARMS * libm::exp(-0.5 * (gain - self.penalty)).min(1.0)
    }
}

/// Bounds of the stretches: 0, the first window after each change, the number of windows.
pub(super) fn partition(costs: &Costs) -> Vec<usize> {
    let n = costs.sums.len() - 1;
    if n < 2 * LEAST_SIDE {
        return vec![0, n];
    }
    let step = n.div_ceil(MOST_PLACES);
    let mut places: Vec<usize> = (0..n).step_by(step).collect();
    places.push(n);
    let mut best = vec![f64::INFINITY; places.len()];
    let mut before = vec![0; places.len()];
    best[0] = -costs.penalty;
    let mut open: Vec<usize> = Vec::new();
    for at in 1..places.len() {
        // Add the places from which the last stretch is now long enough.
        let entering = (0..at).rev().take_while(|&k| places[at] - places[k] <= LEAST_SIDE + step);
        let entering: Vec<usize> = entering.filter(|&k| places[at] - places[k] >= LEAST_SIDE).collect();
        entering.into_iter().for_each(|k| {
            if !open.contains(&k) {
                open.push(k)
            }
        });
        let upto: Vec<f64> = open.iter().map(|&k| best[k] + costs.of_stretch(places[k], places[at])).collect();
        for (&k, cost) in open.iter().zip(&upto) {
            if cost + costs.penalty < best[at] {
                (best[at], before[at]) = (cost + costs.penalty, k);
            }
        }
        let keep: Vec<bool> = upto.iter().map(|cost| *cost <= best[at]).collect();
        let mut kept = keep.iter();
        open.retain(|_| kept.next().copied().unwrap_or(true));
    }
    let mut ends = vec![n];
    let mut at = places.len() - 1;
    while at > 0 {
        at = before[at];
        ends.push(places[at]);
    }
    ends.reverse();
    refined(costs, ends)
}

/// Moves each change to its best place between its neighbours.
fn refined(costs: &Costs, mut ends: Vec<usize>) -> Vec<usize> {
    for i in 1..ends.len().saturating_sub(1) {
        let (a, b) = (ends[i - 1], ends[i + 1]);
        let places = (a + LEAST_SIDE)..=(b - LEAST_SIDE).max(a + LEAST_SIDE);
        let best = places.max_by(|x, y| costs.gain(a, *x, b).total_cmp(&costs.gain(a, *y, b)));
        ends[i] = best.unwrap_or(ends[i]);
    }
    ends
}

/// A change between two stretches: most likely date, its interval, its confidence.
#[derive(Debug, Clone, Copy)]
pub(super) struct Dated {
    pub at_ns: i64,
    pub from_ns: i64,
    pub to_ns: i64,
    pub p: f64,
}

/// Dates the change at `k` between the stretch from `a` and the one up to `b`.
///
/// Each place is weighted by its likelihood. The interval covers the most probable places up to its level, from the start of
/// the window before to the end of the window after, since a window may keep its old result for part of its time.
pub(super) fn dated(history: &History<'_>, costs: &Costs, a: usize, k: usize, b: usize) -> Dated {
    let best = costs.gain(a, k, b);
    let places = (a + 1)..b;
    let mut weighed: Vec<(usize, f64)> =
        places.map(|at| (at, libm::exp(0.5 * (costs.gain(a, at, b) - best)))).collect();
    let all: f64 = weighed.iter().map(|w| w.1).sum();
    weighed.sort_by(|x, y| y.1.total_cmp(&x.1));
    let (mut sum, mut low, mut high) = (0.0, k, k);
    for (at, weight) in weighed {
        if sum >= DATE_LEVEL * all {
            break;
        }
        sum += weight;
        (low, high) = (low.min(at), high.max(at));
    }
    let point = |k: usize| &history.points[k];
    let (before, after) = (point(k - 1).middle_ns(), point(k).middle_ns());
    Dated {
        at_ns: before + (after - before) / 2,
        from_ns: point(low - 1).result.start_ns,
        to_ns: point(high).result.end_ns,
        p: costs.sureness(best),
    }
}

/// ln s of the windows that give one; stray values are pulled towards the median of five neighbours, because one window is
/// not a change.
fn without_strays(history: &History<'_>) -> Vec<f64> {
    let seen: Vec<Seen> = history.points.iter().filter_map(|p| p.seen).collect();
    let near = |k: usize| {
        let from = k.saturating_sub(STRAY_SIDE).min(seen.len().saturating_sub(2 * STRAY_SIDE + 1));
        let to = (from + 2 * STRAY_SIDE + 1).min(seen.len());
        stats::median(&seen[from..to].iter().map(|s| s.x).collect::<Vec<f64>>())
    };
    let kept = |(k, s): (usize, &Seen)| {
        let (middle, room) = (near(k), STRAY * (s.variance + history.scatter.between).sqrt());
        s.x.clamp(middle - room, middle + room)
    };
    seen.iter().enumerate().map(kept).collect()
}
