//! Where the windows' story changes: the partition into stretches that costs least.
//!
//! A stretch costs twice the negative log likelihood of its windows, under a constant share of windows that find stiction
//! and a constant ln s; every change costs a penalty on top. The optimal partition is found exactly by dynamic programming
//! with pruning (PELT; Killick, Fearnhead and Eckley 2012).

use super::window::History;

/// Fewest windows on either side of a change.
pub(super) const LEAST_SIDE: usize = 3;
/// The penalty is `PENALTY + 2 ln(windows without overlap)`; and more where few pairs of windows told the variance between
/// them: times 1 + `FEW_PAIRS` / pairs. Chosen by simulation, see [`FALSE_ALARMS`].
const PENALTY: f64 = 13.0;
const FEW_PAIRS: f64 = 6.0;
/// Share of histories of 500 windows without a change in which one is found at most.
const FALSE_ALARMS: f64 = 0.01;
/// Bounds of a stretch's share of windows that find stiction.
const SHARES: [f64; 2] = [0.02, 0.98];
/// Places for a change that are looked at in one go; of longer histories every second, third, … window is one.
const MOST_PLACES: usize = 1_500;
/// What the interval of a date covers.
const DATE_LEVEL: f64 = 0.9;

/// Sums up to each window, from which the cost of any stretch follows.
pub(super) struct Costs {
    /// Per window: share, share times p, weight, weight times x, weight times x squared.
    sums: Vec<[f64; 5]>,
    /// What a change costs.
    pub penalty: f64,
    /// Variance of ln s between windows.
    pub between: f64,
}

impl Costs {
    pub fn of(history: &History<'_>) -> Self {
        let between = history.scatter.between;
        let mut sums = vec![[0.0; 5]];
        let mut sum = [0.0; 5];
        for point in &history.points {
            let (weight, x) = point.seen.map_or((0.0, 0.0), |s| (s.share / (s.variance + between), s.x));
            let more = [point.share, point.share * point.p, weight, weight * x, weight * x * x];
            sum.iter_mut().zip(more).for_each(|(s, m)| *s += m);
            sums.push(sum);
        }
        let windows = sum[0].max(1.0);
        let few = history.scatter.pairs.map_or(1.0, |pairs| 1.0 + FEW_PAIRS / pairs);
        Self { sums, penalty: (PENALTY + 2.0 * libm::log(windows)) * few, between }
    }

    /// Cost of the windows from `a` up to `b`.
    fn of_stretch(&self, a: usize, b: usize) -> f64 {
        let [n, p, w, wx, wxx] = core::array::from_fn(|i| self.sums[b][i] - self.sums[a][i]);
        let sized = if w > 0.0 { (wxx - wx * wx / w).max(0.0) } else { 0.0 };
        if n <= 0.0 {
            return sized;
        }
        let q = (p / n).clamp(SHARES[0], SHARES[1]);
        sized - 2.0 * (p * libm::log(q) + (n - p) * libm::log(1.0 - q))
    }

    /// Share of the windows from `a` up to `b` that find stiction.
    pub fn found(&self, a: usize, b: usize) -> f64 {
        let [n, p] = [0, 1].map(|i| self.sums[b][i] - self.sums[a][i]);
        if n > 0.0 { p / n } else { 0.0 }
    }

    /// By how much a change at `k` makes the windows from `a` up to `b` likelier, twice the logarithm.
    fn gain(&self, a: usize, k: usize, b: usize) -> f64 {
        self.of_stretch(a, b) - self.of_stretch(a, k) - self.of_stretch(k, b)
    }

    /// Cost of the same windows as a partition at `ends`, changes included.
    pub fn of_partition(&self, ends: &[usize]) -> f64 {
        let stretches: f64 = ends.windows(2).map(|w| self.of_stretch(w[0], w[1])).sum();
        stretches + self.penalty * ends.len().saturating_sub(2) as f64
    }

    /// Share of histories without a change that show no step of this gain.
    fn sureness(&self, gain: f64) -> f64 {
        1.0 - FALSE_ALARMS * libm::exp(-0.5 * (gain - self.penalty)).min(1.0)
    }
}

/// Where stretches begin and end: 0, the first windows after changes, the number of windows.
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
        // Places from which the last stretch would now be long enough come in.
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

/// Each change moved to its best place between its neighbours.
fn refined(costs: &Costs, mut ends: Vec<usize>) -> Vec<usize> {
    for i in 1..ends.len().saturating_sub(1) {
        let (a, b) = (ends[i - 1], ends[i + 1]);
        let places = (a + LEAST_SIDE)..=(b - LEAST_SIDE).max(a + LEAST_SIDE);
        let best = places.max_by(|x, y| costs.gain(a, *x, b).total_cmp(&costs.gain(a, *y, b)));
        ends[i] = best.unwrap_or(ends[i]);
    }
    ends
}

/// A change between two stretches: most likely date, its interval, and how sure it is.
#[derive(Debug, Clone, Copy)]
pub(super) struct Dated {
    pub at_ns: i64,
    pub from_ns: i64,
    pub to_ns: i64,
    pub p: f64,
}

/// Dates the change at `k` between the stretches from `a` and up to `b`.
///
/// Each place is as probable as it makes the windows likely; the interval holds the most probable ones up to its level, and
/// reaches from the start of the window before to the end of the window after, since a window may be taken for what it was
/// for a part of its time.
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
