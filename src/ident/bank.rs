//! The coarse look: one valve signal against a bank of first-order lags and all dead times at once.
//!
//! Boxes of samples (the valve law still runs on every OP value) keep a period at a few dozen points. Eight time
//! constants are filtered side by side; a whole number of boxes of dead time only shifts their responses, so the
//! products for every dead time follow from sums along the record. The cost of each pair is that of the best gain,
//! friction band, bias and initial state, for the error itself and for its filtered differences.

use super::candidate::Question;
use super::fit::{Freedom, best_band};
use crate::signal::detrend::box_means;
use crate::signal::stats;

/// Time constants in a bank.
const LANES: usize = 8;
/// Time constants of the bank, periods.
const TAUS: [f64; LANES] = [0.004, 0.02, 0.045, 0.09, 0.18, 0.4, 1.0, 4.0];

type Lane = [f64; LANES];

/// Filter of the second view, `1 - RHO q^-1` for boxes of one point.
const RHO: f64 = 0.98;

/// One view of PV: filtered, and how much of it there is.
#[derive(Debug, Clone)]
struct View {
    rho: f64,
    /// Products with itself, the constant and each lane's memory.
    yy: f64,
    one: f64,
    memory: Lane,
}

/// The best that one view makes of one valve signal.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Glance {
    /// Squared error over that of no process at all.
    pub share: f64,
    /// Time constant, points of the question.
    pub tau: f64,
    /// Lag, points of the question.
    pub lag: f64,
}

/// Ranges of dead time that are also judged apart.
pub const BINS: usize = 6;

/// Where range `k` begins between the least lag and the greatest, as a share: dead times are short more often than long.
#[must_use]
pub fn bin_edge(k: usize) -> f64 {
    let share = k as f64 / BINS as f64;
    share * share
}

/// The best that each view makes of one valve signal: the error itself and its differences, by range of dead time.
pub type Glances = [[Glance; BINS]; 2];

/// A bank for one question; it keeps its buffers.
#[derive(Debug)]
pub struct Bank {
    /// Points in a box.
    pub points: usize,
    n: usize,
    from: usize,
    lags: [usize; 2],
    poles: Lane,
    /// Products of the constant and the lanes' memories: 1·m and m·m.
    one_memory: Lane,
    memory_memory: Lane,
    pv: Vec<f64>,
    views: [View; 2],
    at: Vec<Lane>,
    direction: Vec<Lane>,
    /// Products of their halves with PV at every lag, from the least to one past the greatest.
    with_pv: Vec<[Lane; 2]>,
}

/// Sums over the record for one lag.
#[derive(Clone, Copy, Default)]
struct Sums {
    /// Squares and product: at·at, at·direction, direction·direction.
    power: [Lane; 3],
    /// The same with the value before: at·at', at·direction' + direction·at', direction·direction'.
    next: [Lane; 3],
    /// Sums of at and direction, and products with the memory.
    total: [Lane; 2],
    memory: [Lane; 2],
    /// Products with PV in both views.
    with: [[Lane; 2]; 2],
}

impl Bank {
    /// A bank for a question, its boxes `per_period` of a period.
    #[must_use]
    pub fn new(question: &Question, per_period: f64) -> Self {
        let points = ((question.period / per_period) as usize).max(1);
        let mut pv = box_means(&question.pv, points);
        let n = question.mean.len() / points;
        pv.truncate(n);
        let size = points as f64;
        let shift = 0.5 * (size - 1.0);
        let lags = question.limits.lag.map(|lag| ((lag + shift) / size).round() as usize);
        let lags = [lags[0], lags[1].max(lags[0])];
        let from = (question.from.div_ceil(points)).max(lags[1] + 2).min(n);
        let poles = TAUS.map(|tau| libm::exp(-size / (tau * question.period).max(0.3)));
        let count = n - from;
        let memory = |pole: f64, values: &mut dyn FnMut(usize, f64)| {
            let mut m = 1.0;
            for k in 0..count {
                values(k, m);
                m *= pole;
                if m < 1e-9 {
                    break;
                }
            }
        };
        let (mut one_memory, mut memory_memory) = ([0.0; LANES], [0.0; LANES]);
        for lane in 0..LANES {
            memory(poles[lane], &mut |_, m| {
                one_memory[lane] += m;
                memory_memory[lane] += m * m;
            });
        }
        let views = [0.0, libm::pow(RHO, size)].map(|rho| {
            let y: Vec<f64> = (from..n).map(|k| pv[k] - rho * pv[k - 1]).collect();
            let mut with = [0.0; LANES];
            for lane in 0..LANES {
                memory(poles[lane], &mut |k, m| with[lane] += m * y[k]);
            }
            View { rho, yy: stats::dot(&y, &y), one: y.iter().sum(), memory: with }
        });
        let (at, direction) = (vec![[0.0; LANES]; n], vec![[0.0; LANES]; n]);
        let with_pv = vec![[[0.0; LANES]; 2]; lags[1] - lags[0] + 2];
        Self { points, n, from, lags, poles, one_memory, memory_memory, pv, views, at, direction, with_pv }
    }

    /// The best time constant and dead time for a valve signal averaged over the bank's boxes, `at - fd * direction`,
    /// for each sign of `signs`, by view and range of dead time.
    pub fn look(&mut self, at: &[f64], direction: &[f64], freedom: &Freedom, signs: &[f64]) -> Vec<Glances> {
        self.respond(at, direction);
        self.correlate(at, direction);
        let none = Glance { share: 1.0, tau: 1.0, lag: self.lags[0] as f64 };
        let mut best = vec![[[none; BINS]; 2]; signs.len()];
        let lags = self.lags[1] - self.lags[0] + 1;
        let mut here = self.sums(self.lags[0]);
        for lag in self.lags[0]..=self.lags[1] {
            let next = self.sums_after(&here, lag + 1);
            let share = ((lag - self.lags[0]) as f64 + 0.5) / lags as f64;
            let bin = (1..BINS).take_while(|k| share >= bin_edge(*k)).count();
            for view in 0..2 {
                for lane in 0..LANES {
                    let (rest, system, whole) = self.reduced(&here, &next, view, lane);
                    for (sign, best) in signs.iter().zip(&mut best) {
                        let freedom = Freedom { sign: *sign, ..*freedom };
                        let (_, _, explained) = best_band(system, whole, &freedom);
                        let share = (rest - explained) / self.views[view].yy;
                        if share < best[view][bin].share {
                            best[view][bin] = Glance { share, tau: self.tau(lane), lag: self.lag(lag) };
                        }
                    }
                }
            }
            here = next;
        }
        best
    }

    fn tau(&self, lane: usize) -> f64 {
        -(self.points as f64) / libm::log(self.poles[lane])
    }

    /// A response averaged over boxes comes half a box sooner than one taken at their ends.
    fn lag(&self, boxes: usize) -> f64 {
        (boxes * self.points) as f64 - 0.5 * (self.points as f64 - 1.0)
    }

    fn respond(&mut self, at: &[f64], direction: &[f64]) {
        let gain = self.poles.map(|a| 1.0 - a);
        for (out, v) in [(&mut self.at, at), (&mut self.direction, direction)] {
            let mut x = [v.first().copied().unwrap_or(0.0); LANES];
            for (slot, v) in out.iter_mut().zip(v) {
                for lane in 0..LANES {
                    x[lane] = self.poles[lane] * x[lane] + gain[lane] * v;
                }
                *slot = x;
            }
        }
    }

    /// Products of the responses with PV at every lag: as a response goes on by its pole from one box to the next, so do
    /// its products from a lag to the one before, with those of the valve signal itself.
    fn correlate(&mut self, at: &[f64], direction: &[f64]) {
        let greatest = self.lags[1] + 1;
        let y = &self.pv[self.from..];
        let mut last = self.products_with(greatest, y);
        let mut made = core::mem::take(&mut self.with_pv);
        for (slot, lag) in made.iter_mut().zip(self.lags[0]..greatest + 1).rev() {
            if lag < greatest {
                let own = [at, direction].map(|v| stats::dot(&v[self.from - lag..self.n - lag], y));
                for (sums, own) in last.iter_mut().zip(own) {
                    for (sum, pole) in sums.iter_mut().zip(self.poles) {
                        *sum = pole * *sum + (1.0 - pole) * own;
                    }
                }
            }
            *slot = last;
        }
        self.with_pv = made;
    }

    /// All sums for the first lag.
    fn sums(&self, lag: usize) -> Sums {
        let mut sums = Sums::default();
        for k in self.from - lag..self.n - lag {
            self.edge(&mut sums, k, 1.0);
        }
        for k in (0..self.n - self.from).rev() {
            let (a, d) = (&self.at[self.from - lag + k], &self.direction[self.from - lag + k]);
            for lane in 0..LANES {
                sums.memory[0][lane] = self.poles[lane] * sums.memory[0][lane] + a[lane];
                sums.memory[1][lane] = self.poles[lane] * sums.memory[1][lane] + d[lane];
            }
        }
        self.products(&mut sums, lag, self.earlier(lag));
        sums
    }

    /// The sums one lag further on: the record slides by one box.
    fn sums_after(&self, before: &Sums, lag: usize) -> Sums {
        let mut sums = *before;
        let (first, last) = (self.from - lag, self.n - lag);
        self.edge(&mut sums, first, 1.0);
        self.edge(&mut sums, last, -1.0);
        let count = (self.n - self.from) as i32;
        for lane in 0..LANES {
            let pole = self.poles[lane];
            let leaving = if pole > 0.97 { libm::pow(pole, f64::from(count)) } else { 0.0 };
            for (memory, x) in sums.memory.iter_mut().zip([&self.at, &self.direction]) {
                memory[lane] = x[first][lane] + pole * memory[lane] - leaving * x[last][lane];
            }
        }
        self.products(&mut sums, lag, self.earlier_after(&before.with[0], lag));
        sums
    }

    #[inline]
    fn edge(&self, sums: &mut Sums, k: usize, weight: f64) {
        let (a, d) = (&self.at[k], &self.direction[k]);
        let (b, e) = (&self.at[k.saturating_sub(1)], &self.direction[k.saturating_sub(1)]);
        for lane in 0..LANES {
            sums.power[0][lane] += weight * a[lane] * a[lane];
            sums.power[1][lane] += weight * a[lane] * d[lane];
            sums.power[2][lane] += weight * d[lane] * d[lane];
            sums.next[0][lane] += weight * a[lane] * b[lane];
            sums.next[1][lane] += weight * (a[lane] * e[lane] + d[lane] * b[lane]);
            sums.next[2][lane] += weight * d[lane] * e[lane];
            sums.total[0][lane] += weight * a[lane];
            sums.total[1][lane] += weight * d[lane];
        }
    }

    /// Products with PV at one lag; the filtered view's follow from those with PV one box earlier.
    fn products(&self, sums: &mut Sums, lag: usize, earlier: [Lane; 2]) {
        let plain = self.with_pv[lag - self.lags[0]];
        sums.with[0] = plain;
        for (half, with) in sums.with[1].iter_mut().enumerate() {
            *with = core::array::from_fn(|lane| plain[half][lane] - self.views[1].rho * earlier[half][lane]);
        }
    }

    /// Products of both halves at one lag with values that begin at the first box that counts.
    fn products_with(&self, lag: usize, pv: &[f64]) -> [Lane; 2] {
        let (mut a, mut d) = ([0.0; LANES], [0.0; LANES]);
        let (at, direction) = (&self.at[self.from - lag..], &self.direction[self.from - lag..]);
        for ((x, z), y) in at.iter().zip(direction).zip(pv) {
            for lane in 0..LANES {
                a[lane] += x[lane] * y;
                d[lane] += z[lane] * y;
            }
        }
        [a, d]
    }

    /// Products with PV one box earlier at one lag.
    fn earlier(&self, lag: usize) -> [Lane; 2] {
        self.products_with(lag, &self.pv[self.from - 1..self.n - 1])
    }

    /// The same, from the products `with` PV at the lag before.
    fn earlier_after(&self, with: &[Lane; 2], lag: usize) -> [Lane; 2] {
        let (first, last) = (self.pv[self.from - 1], self.pv[self.n - 1]);
        let edges = |x: &[Lane], lane: usize| x[self.from - lag][lane] * first - x[self.n - lag][lane] * last;
        [
            core::array::from_fn(|lane| with[0][lane] + edges(&self.at, lane)),
            core::array::from_fn(|lane| with[1][lane] + edges(&self.direction, lane)),
        ]
    }

    /// What is left of PV once bias and memory are taken out, and of the valve signal's halves: at·at, at·direction,
    /// direction·direction, at·PV, direction·PV.
    #[inline]
    fn reduced(&self, here: &Sums, next: &Sums, view: usize, lane: usize) -> (f64, [f64; 5], [f64; 2]) {
        let v = &self.views[view];
        let rho = v.rho;
        let power = |i: usize| {
            here.power[i][lane] + rho * rho * next.power[i][lane]
                - rho * here.next[i][lane] * if i == 1 { 1.0 } else { 2.0 }
        };
        let total = |i: usize| here.total[i][lane] - rho * next.total[i][lane];
        let memory = |i: usize| here.memory[i][lane] - rho * next.memory[i][lane];
        let with = |i: usize| here.with[view][i][lane] - rho * next.with[view][i][lane];
        let one = 1.0 / (self.n - self.from) as f64;
        let om = self.one_memory[lane];
        let mm = self.memory_memory[lane] - om * om * one;
        let (totals, y) = ([total(0), total(1)], v.one);
        let centred = |i: usize| memory(i) - om * totals[i] * one;
        // A memory as long as the record is no column of its own.
        let pivot = if mm > 1e-9 * self.memory_memory[lane] { 1.0 / mm } else { 0.0 };
        let (ma, md, my) = (centred(0), centred(1), v.memory[lane] - om * y * one);
        let rest = v.yy - y * y * one - my * my * pivot;
        let system = [
            power(0) - totals[0] * totals[0] * one - ma * ma * pivot,
            power(1) - totals[0] * totals[1] * one - ma * md * pivot,
            power(2) - totals[1] * totals[1] * one - md * md * pivot,
            with(0) - totals[0] * y * one - ma * my * pivot,
            with(1) - totals[1] * y * one - md * my * pivot,
        ];
        (rest, system, [power(0), power(2)])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ident::quantify::Options;
    use crate::record::Record;

    #[test]
    fn products_with_pv_follow_from_lag_to_lag() {
        let op: Vec<f64> =
            (0..700).map(|k| libm::sin(f64::from(k) * 0.07) + 0.3 * libm::sin(f64::from(k) * 0.023)).collect();
        let pv: Vec<f64> = op.iter().map(|x| 0.4 * x * x + x).collect();
        let record = Record::uniform(1.0, op, pv);
        let question = crate::ident::normalise::normalise(&record, &Options::default(), 2.0, 1.0);
        for per_period in [20.0, 40.0] {
            let mut bank = Bank::new(&question, per_period);
            let at = box_means(&question.mean, bank.points);
            let direction: Vec<f64> = at.iter().map(|x| x.signum()).collect();
            bank.respond(&at, &direction);
            bank.correlate(&at, &direction);
            for (lag, found) in (bank.lags[0]..=bank.lags[1] + 1).zip(&bank.with_pv) {
                let direct = bank.products_with(lag, &bank.pv[bank.from..]);
                for (a, b) in direct.iter().flatten().zip(found.iter().flatten()) {
                    assert!((a - b).abs() < 1e-9 * (1.0 + a.abs()), "{lag}: {a} {b}");
                }
            }
        }
    }
}
