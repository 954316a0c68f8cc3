//! The coarse scan: a valve signal against eight first-order lags and many dead times at once.
//!
//! The same stretch of OP is counted for every dead time, PV's slides past it: so the products of the answers with each
//! other are gathered once, in a walk over the steps, and only those with PV change from one dead time to the next.

// Lanes and halves are places of several arrays at once.
#![allow(clippy::needless_range_loop)]

use super::problem::Problem;
use crate::ident::fit::{Freedom, best_band};
use crate::sim::steps::Step;

/// Time constants side by side.
const LANES: usize = 8;
/// The same in periods; the last one stands for an integrator.
const TAUS: [f64; LANES] = [0.004, 0.02, 0.05, 0.11, 0.25, 0.6, 2.0, f64::INFINITY];
/// Share of its square below which a decay is no column of its own.
const DEPENDENT: f64 = 1e-9;
/// Share of the product of their squares from which two halves of a valve signal are columns apart.
const INDEPENDENT: f64 = 1e-6;
/// Power of a decay below which it counts as nothing.
const NOTHING: f64 = 1e-150;

type Lanes = [f64; LANES];

/// The scan of one stretch of a record behind one filter.
#[derive(Debug, Clone)]
pub struct CoarseScan {
    rho: f64,
    taus: Lanes,
    a: Lanes,
    /// Share of the answer that is still to come at the sample of a step, half a sample being dead time.
    late: Lanes,
    powers: Vec<Lanes>,
    /// Products of PV from each point on with the answer to a step there, and with the decay that starts there.
    with_step: Vec<Lanes>,
    with_decay: Vec<Lanes>,
    /// Sums of filtered PV from each point on, and of its squares.
    sums: Vec<[f64; 2]>,
    delays: Vec<usize>,
    /// First point of OP that counts, and how many do.
    from: usize,
    length: usize,
}

/// The best that the scan makes of one valve signal.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Seen {
    /// Share of PV's squares that is left.
    pub share: f64,
    /// Time constant, points.
    pub tau: f64,
    /// Lag, points.
    pub lag: f64,
}

/// Whole delays from the least to the greatest, ever farther apart.
fn delays([least, most]: [f64; 2]) -> Vec<usize> {
    let [least, most] = [least as usize, most as usize];
    let grow = if most > 40 { 4 } else { 6 };
    let mut out = vec![least];
    while let Some(last) = out.last().copied().filter(|d| *d < most) {
        out.push((last + 1 + last / grow).min(most));
    }
    out
}

impl CoarseScan {
    /// Scans of the first `points` of a record by the error behind `1 - rho q^-1`: the second one for long dead times, where
    /// they would leave little of a record that is counted for all alike.
    #[must_use]
    pub fn of(problem: &Problem<'_>, rho: f64, points: usize) -> Vec<Self> {
        let all = delays(problem.normalised.limits.lag);
        let most = all.last().copied().unwrap_or(0);
        let cut = all.partition_point(|d| *d <= most / 4);
        let halves = if most > 30 { vec![&all[..cut], &all[cut..]] } else { vec![&all[..]] };
        halves.into_iter().filter(|d| !d.is_empty()).map(|d| Self::new(problem, rho, points, d.to_vec())).collect()
    }

    fn new(problem: &Problem<'_>, rho: f64, points: usize, delays: Vec<usize>) -> Self {
        let (from, most) = (1, delays.iter().copied().max().unwrap_or(0));
        let length = points.saturating_sub(from + most).max(1);
        let slowest = problem.normalised.limits.tau[1];
        let taus = TAUS.map(|t| (t * problem.normalised.period).clamp(0.3, slowest));
        let a = taus.map(|t| libm::exp(-1.0 / t));
        let late = taus.map(|t| libm::exp(-0.5 / t));
        let mut powers = vec![[0.0; LANES]; points + 1];
        let mut power = [1.0; LANES];
        for slot in &mut powers {
            *slot = power;
            for l in 0..LANES {
                let next = power[l] * a[l];
                power[l] = if next > NOTHING { next } else { 0.0 };
            }
        }
        let (mut with_step, mut with_decay) = (vec![[0.0; LANES]; points + 1], vec![[0.0; LANES]; points + 1]);
        let mut sums = vec![[0.0; 2]; points + 1];
        let later: Lanes = core::array::from_fn(|l| late[l] * (1.0 - rho / a[l]));
        let own: Lanes = core::array::from_fn(|l| late[l] * rho / a[l]);
        let (pv, mut decay) = (problem.pv(), [0.0; LANES]);
        for k in (from..points).rev() {
            let y = pv[k] - rho * pv[k - 1];
            sums[k] = [sums[k + 1][0] + y, sums[k + 1][1] + y * y];
            let level = (1.0 - rho) * sums[k][0] + rho * y;
            for l in 0..LANES {
                decay[l] = y + a[l] * decay[l];
                with_step[k][l] = level - later[l] * decay[l] - own[l] * y;
            }
            with_decay[k] = decay;
        }
        Self { rho, taus, a, late, powers, with_step, with_decay, sums, delays, from, length }
    }

    /// The best time constant and dead time for these steps.
    #[must_use]
    pub fn look(&self, steps: &[Step], freedom: &Freedom) -> Seen {
        pulp::Arch::new().dispatch(Look { scan: self, steps, freedom })
    }

    #[inline(always)]
    fn look_in_lanes(&self, steps: &[Step], freedom: &Freedom) -> Seen {
        let end = self.from + self.length;
        let first = steps.partition_point(|s| (s.point as usize) < self.from);
        let last = steps.partition_point(|s| (s.point as usize) < end);
        let steps = &steps[first..last];
        let own = self.own(steps, end);
        let mut best = Seen { share: f64::INFINITY, tau: self.taus[0], lag: 0.0 };
        let mut at = 0;
        // The error hardly changes from one dead time to the next but one; beside the best both are asked.
        for which in (0..self.delays.len()).step_by(2) {
            if self.look_at(which, steps, end, &own, freedom, &mut best) {
                at = which;
            }
        }
        for which in [at.wrapping_sub(1), at + 1] {
            if which < self.delays.len() {
                self.look_at(which, steps, end, &own, freedom, &mut best);
            }
        }
        best
    }

    /// The best time constant at one dead time; whether it is better than what was seen.
    #[inline(always)]
    fn look_at(&self, which: usize, steps: &[Step], end: usize, own: &Own, freedom: &Freedom, best: &mut Seen) -> bool {
        let delay = self.delays[which];
        let one = 1.0 / self.length as f64;
        let end_power = &self.powers[self.length];
        let before = best.share;
        let (mut level, mut turn) = ([0.0; LANES], [0.0; LANES]);
        for step in steps {
            let with = &self.with_step[step.point as usize + delay];
            for l in 0..LANES {
                level[l] += step.level * with[l];
                turn[l] += step.direction * with[l];
            }
        }
        let (start, stop) = (self.from + delay, end + delay);
        let [sum, squares] = [0, 1].map(|i| self.sums[start][i] - self.sums[stop][i]);
        let beyond = (1.0 - self.rho) * self.sums[stop][0];
        let total = squares - sum * sum * one;
        for l in 0..LANES {
            let memory =
                self.with_decay[start][l] - end_power[l] * self.with_decay[stop][l] - own.one_memory[l] * sum * one;
            let rest = total - memory * memory * own.pivot[l];
            // What the answers do beyond the stretch that counts comes off.
            let with = |tables: f64, half: usize| {
                let tail = own.level[half] * beyond - own.decay[half][l] * self.with_decay[stop][l];
                tables - tail - own.sum[half][l] * sum * one - own.memory[half][l] * memory * own.pivot[l]
            };
            let system = [own.power[0][l], own.power[1][l], own.power[2][l], with(level[l], 0), with(turn[l], 1)];
            if rest - at_most(system) >= best.share * total {
                continue;
            }
            let (_, _, explained) = best_band(system, [own.power[0][l], own.power[2][l]], freedom);
            let share = (rest - explained) / total;
            if share < best.share {
                *best = Seen { share, tau: self.taus[l], lag: delay as f64 + 0.5 };
            }
        }
        best.share < before
    }

    /// Products of the answers with each other, the same for every dead time.
    #[inline(always)]
    fn own(&self, steps: &[Step], end: usize) -> Own {
        let rho = self.rho;
        let share = 1.0 - rho;
        let (a, late) = (&self.a, &self.late);
        let later: Lanes = core::array::from_fn(|l| late[l] * (a[l] - rho));
        let back: Lanes = core::array::from_fn(|l| rho / a[l]);
        let inverse: Lanes = core::array::from_fn(|l| 1.0 / (1.0 - a[l]));
        let squared: Lanes = core::array::from_fn(|l| 1.0 / (1.0 - a[l] * a[l]));
        let mut out = Own::default();
        for (m, step) in steps.iter().enumerate() {
            let i = step.point as usize;
            let next = steps.get(m + 1).map_or(end, |s| s.point as usize);
            let by = [step.level, step.direction];
            let before = out.level.map(|v| share * v);
            let first = [before[0] + by[0], before[1] + by[1]];
            out.level = [out.level[0] + by[0], out.level[1] + by[1]];
            let (c, d, count) = (share * out.level[0], share * out.level[1], (next - i - 1) as f64);
            let (rest, memory) = (&self.powers[next - i - 1], &self.powers[i - self.from]);
            for l in 0..LANES {
                let (u, v) = (out.decay[0][l] + by[0], out.decay[1][l] + by[1]);
                let x = first[0] - late[l] * (u - back[l] * out.decay[0][l]);
                let z = first[1] - late[l] * (v - back[l] * out.decay[1][l]);
                let (sum, squares) = ((1.0 - rest[l]) * inverse[l], (1.0 - rest[l] * rest[l]) * squared[l]);
                let (p, q) = (later[l] * u, later[l] * v);
                out.power[0][l] += x * x + c * (c * count - 2.0 * p * sum) + p * p * squares;
                out.power[1][l] += x * z + c * d * count - (c * q + d * p) * sum + p * q * squares;
                out.power[2][l] += z * z + d * (d * count - 2.0 * q * sum) + q * q * squares;
                out.sum[0][l] += x + c * count - p * sum;
                out.sum[1][l] += z + d * count - q * sum;
                let after = memory[l] * a[l];
                out.memory[0][l] += x * memory[l] + after * (c * sum - p * squares);
                out.memory[1][l] += z * memory[l] + after * (d * sum - q * squares);
                let left = rest[l] * a[l];
                out.decay[0][l] = u * left;
                out.decay[1][l] = v * left;
            }
        }
        let one = 1.0 / self.length as f64;
        let end_power = &self.powers[self.length];
        for l in 0..LANES {
            out.one_memory[l] = (1.0 - end_power[l]) * inverse[l];
            let square = (1.0 - end_power[l] * end_power[l]) * squared[l];
            let centred = square - out.one_memory[l] * out.one_memory[l] * one;
            out.pivot[l] = if centred > DEPENDENT * square { 1.0 / centred } else { 0.0 };
            let (sum, pivot) = ([out.sum[0][l], out.sum[1][l]], out.pivot[l]);
            for h in 0..2 {
                out.memory[h][l] -= out.one_memory[l] * sum[h] * one;
                out.decay[h][l] *= late[l] * (1.0 - back[l]);
            }
            let m = [out.memory[0][l], out.memory[1][l]];
            out.power[0][l] -= sum[0] * sum[0] * one + m[0] * m[0] * pivot;
            out.power[1][l] -= sum[0] * sum[1] * one + m[0] * m[1] * pivot;
            out.power[2][l] -= sum[1] * sum[1] * one + m[1] * m[1] * pivot;
        }
        out
    }
}

/// A look by the widest lanes that the processor has: the same figures to the last bit.
struct Look<'l> {
    scan: &'l CoarseScan,
    steps: &'l [Step],
    freedom: &'l Freedom,
}

impl pulp::NullaryFnOnce for Look<'_> {
    type Output = Seen;

    #[inline(always)]
    fn call(self) -> Seen {
        self.scan.look_in_lanes(self.steps, self.freedom)
    }
}

/// Most that gain and kinetic band can explain, both free of any bound.
fn at_most([uu, ud, dd, uy, dy]: [f64; 5]) -> f64 {
    let determinant = uu * dd - ud * ud;
    if determinant > INDEPENDENT * uu * dd {
        (dd * uy * uy - 2.0 * ud * uy * dy + uu * dy * dy) / determinant
    } else {
        f64::INFINITY
    }
}

/// Sums over the answers of both halves of a valve signal, constant and memory taken out, and where they end.
#[derive(Default)]
struct Own {
    power: [Lanes; 3],
    sum: [Lanes; 2],
    memory: [Lanes; 2],
    decay: [Lanes; 2],
    level: [f64; 2],
    one_memory: Lanes,
    pivot: Lanes,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ident::Options;
    use crate::ident::class::{Class, Scratch};
    use crate::ident::least_squares::Gram;
    use crate::ident::normalise::normalise;
    use crate::record::Record;
    use crate::sim::slips::{FirstSlip, Law, Stroke};
    use crate::sim::steps::Steps;

    #[test]
    fn every_share_is_that_of_columns_of_samples() {
        let op: Vec<f64> =
            (0..500).map(|k| libm::sin(f64::from(k) * 0.07) + 0.3 * libm::sin(f64::from(k) * 0.023)).collect();
        let pv: Vec<f64> =
            op.iter().enumerate().map(|(k, x)| 0.4 * x * x + x + 0.1 * f64::from(k as u32 % 7)).collect();
        let record = Record::uniform(1.0, op, pv);
        let normalised = normalise(&record, &Options { period_points: Some(90.0), ..Options::default() }, 2.0, 1.0);
        let problem = Problem::new(&normalised, 1.0);
        let fd = 0.04;
        let mut steps = Steps::default();
        let first = FirstSlip { direction: 1.0, threshold: normalised.path[0] + 0.05 };
        steps.run(&problem.path, 500, Stroke::FREE, Law::He, [0.2, 0.1], first);
        let freedom = Freedom { fd: [fd; 2], fd_default: fd, sign: 1.0, limits: normalised.limits };
        for rho in [0.0, 0.9] {
            let scan = CoarseScan::new(&problem, rho, 500, vec![3, 9, 20]);
            let seen = scan.look(&steps.list, &freedom);
            let mut valve = vec![0.0; 500];
            for step in &steps.list {
                valve[step.point as usize..].iter_mut().for_each(|v| *v += step.level - fd * step.direction);
            }
            let (mut x, mut other, mut work) = (Vec::new(), Vec::new(), Scratch::default());
            let shape = [libm::log(seen.tau), seen.lag, 0.0];
            Class::First.respond_pair(&shape, [&valve, &valve], &mut work, [&mut x, &mut other]);
            let start = scan.from + seen.lag as usize;
            let counted = start..start + scan.length;
            let filtered = |x: &[f64]| -> Vec<f64> { counted.clone().map(|k| x[k] - rho * x[k - 1]).collect() };
            let memory = counted.clone().map(|k| libm::exp(-((k - start) as f64) / seen.tau)).collect();
            let columns = [vec![1.0; scan.length], memory, filtered(&x), filtered(&normalised.pv)];
            let slices: Vec<&[f64]> = columns.iter().map(Vec::as_slice).collect();
            let mut gram = Gram::of(&slices);
            gram.eliminate(1);
            let total = gram.at(3, 3);
            let mut gram = Gram::of(&slices);
            gram.eliminate(3);
            assert!((gram.at(3, 3) / total - seen.share).abs() < 1e-9, "{rho}: {seen:?} {}", gram.at(3, 3) / total);
        }
    }
}
