//! The coarse scan: fits a valve signal with eight first-order lags and many dead times at once.
//!
//! All dead times use the same stretch of OP, and PV slides past it. So the products of the responses with each other are
//! computed once, in one pass over the steps; only the products with PV change with the dead time.

// Lane and half indices address several arrays at once.
#![allow(clippy::needless_range_loop)]

use super::problem::Problem;
use crate::core::ident::kinetic_band::{Freedom, best_band};
use crate::core::sim::steps::Step;

/// Time constants evaluated in parallel.
const LANES: usize = 8;
/// Time constants in periods; the last one represents an integrator.
const TAUS: [f64; LANES] = [0.004, 0.02, 0.05, 0.11, 0.25, 0.6, 2.0, f64::INFINITY];
/// Dead time, points, above which dead times are scanned separately.
const LONG_DEAD_TIME: usize = 30;
/// Share of its square below which a decay is no independent column.
const DEPENDENT: f64 = 1e-9;
/// Share of the product of their squares from which the two halves of a valve signal are independent columns.
const INDEPENDENT: f64 = 1e-6;
/// Power of a decay below which it is negligible.
const NOTHING: f64 = 1e-150;

type Lanes = [f64; LANES];

/// The scan of one stretch of a record with one filter.
#[derive(Debug, Clone)]
pub(crate) struct CoarseScan {
    rho: f64,
    taus: Lanes,
    a: Lanes,
    /// Share of a step's response still to come at the sample of the step; half a sample counts as dead time.
    late: Lanes,
    /// `1 / (1 - a)` and `1 / (1 - a a)`.
    inverse: Lanes,
    squared: Lanes,
    /// Sum of the memory over the counted points, and the reciprocal of its square without the mean; 0 if the memory is
    /// negligible.
    one_memory: Lanes,
    pivot: Lanes,
    powers: Vec<Lanes>,
    /// Products of PV from each point on with the response to a step there, and with a decay that starts there.
    with_step: Vec<Lanes>,
    with_decay: Vec<Lanes>,
    /// Sums of filtered PV from each point on, and of its squares.
    sums: Vec<[f64; 2]>,
    delays: Vec<usize>,
    /// First point of OP that counts, and the number of such points.
    from: usize,
    length: usize,
}

/// The best fit that the scan finds for one valve signal.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Seen {
    /// Share of PV's squares left unexplained.
    pub share: f64,
    /// Time constant, points.
    pub tau: f64,
    /// Lag, points.
    pub lag: f64,
}

/// Whole delays from the least to the greatest, with growing distances.
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
    /// Scans of the first `points` of a record by the error filtered with `1 - rho q^-1`. Long dead times get a second scan:
    /// all delays of one scan use the same number of points, and the longest would leave few.
    #[must_use]
    pub(crate) fn of(problem: &Problem<'_>, rho: f64, points: usize) -> Vec<Self> {
        Self::of_filtered(problem, [rho; 2], points)
    }

    /// The same for a process with an additional lag of `tau` points: undoing that lag in PV, `pv - a pv(-1)` with its decay
    /// `a`, leaves the response of a single lag.
    #[must_use]
    pub(crate) fn behind_lag(problem: &Problem<'_>, tau: f64, points: usize) -> Vec<Self> {
        Self::of_filtered(problem, [libm::exp(-1.0 / tau), 0.0], points)
    }

    fn of_filtered(problem: &Problem<'_>, filters: [f64; 2], points: usize) -> Vec<Self> {
        let all = delays(problem.normalised.limits.lag);
        let most = all.last().copied().unwrap_or(0);
        let cut = all.partition_point(|d| *d <= most / 4);
        let halves = if most > LONG_DEAD_TIME { vec![&all[..cut], &all[cut..]] } else { vec![&all[..]] };
        halves.into_iter().filter(|d| !d.is_empty()).map(|d| Self::new(problem, filters, points, d.to_vec())).collect()
    }

    /// `filters` apply to PV and to the responses.
    fn new(problem: &Problem<'_>, [of_pv, rho]: [f64; 2], points: usize, delays: Vec<usize>) -> Self {
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
        let (inverse, squared) = (a.map(|a| 1.0 / (1.0 - a)), a.map(|a| 1.0 / (1.0 - a * a)));
        let end = powers[length];
        let one_memory: Lanes = core::array::from_fn(|l| (1.0 - end[l]) * inverse[l]);
        let pivot = core::array::from_fn(|l| {
            let square = (1.0 - end[l] * end[l]) * squared[l];
            let centred = square - one_memory[l] * one_memory[l] * (1.0 / length as f64);
            if centred > DEPENDENT * square { 1.0 / centred } else { 0.0 }
        });
        let (mut with_step, mut with_decay) = (vec![[0.0; LANES]; points + 1], vec![[0.0; LANES]; points + 1]);
        let mut sums = vec![[0.0; 2]; points + 1];
        let later: Lanes = core::array::from_fn(|l| late[l] * (1.0 - rho / a[l]));
        let own: Lanes = core::array::from_fn(|l| late[l] * rho / a[l]);
        let (pv, mut decay) = (problem.pv(), [0.0; LANES]);
        for k in (from..points).rev() {
            let y = pv[k] - of_pv * pv[k - 1];
            sums[k] = [sums[k + 1][0] + y, sums[k + 1][1] + y * y];
            let level = (1.0 - rho) * sums[k][0] + rho * y;
            for l in 0..LANES {
                decay[l] = y + a[l] * decay[l];
                with_step[k][l] = level - later[l] * decay[l] - own[l] * y;
            }
            with_decay[k] = decay;
        }
        Self {
            rho,
            taus,
            a,
            late,
            inverse,
            squared,
            one_memory,
            pivot,
            powers,
            with_step,
            with_decay,
            sums,
            delays,
            from,
            length,
        }
    }

    /// The best time constant and dead time for these steps.
    #[must_use]
    pub(crate) fn look(&self, steps: &[Step], freedom: &Freedom) -> Seen {
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
        // The error changes little between neighbouring dead times, so every second one is evaluated, then both neighbours of
        // the best.
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

    /// The best time constant at one dead time; returns whether it improves on `best`.
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
        let mean = sum * one;
        let (decay_start, decay_stop) = (&self.with_decay[start], &self.with_decay[stop]);
        let (mut rest, mut at_most) = ([0.0; LANES], [0.0; LANES]);
        // Branch-free, so that the lanes are vectorised.
        for l in 0..LANES {
            let memory = decay_start[l] - end_power[l] * decay_stop[l] - self.one_memory[l] * mean;
            let taken = memory * self.pivot[l];
            rest[l] = total - memory * taken;
            // Subtract what the responses do beyond the counted stretch.
            level[l] += own.decay[0][l] * decay_stop[l]
                - own.level[0] * beyond
                - own.sum[0][l] * mean
                - own.memory[0][l] * taken;
            turn[l] += own.decay[1][l] * decay_stop[l]
                - own.level[1] * beyond
                - own.sum[1][l] * mean
                - own.memory[1][l] * taken;
            let [uu, ud, dd] = [own.power[0][l], own.power[1][l], own.power[2][l]];
            let explained = dd * level[l] * level[l] - 2.0 * ud * level[l] * turn[l] + uu * turn[l] * turn[l];
            at_most[l] = explained * own.inverse[l];
        }
        let mut worth = best.share * total;
        for l in 0..LANES {
            if rest[l] - at_most[l] >= worth {
                continue;
            }
            let system = [own.power[0][l], own.power[1][l], own.power[2][l], level[l], turn[l]];
            let (_, _, explained) = best_band(system, [own.power[0][l], own.power[2][l]], freedom);
            let share = (rest[l] - explained) / total;
            if share < best.share {
                *best = Seen { share, tau: self.taus[l], lag: delay as f64 + 0.5 };
                worth = share * total;
            }
        }
        best.share < before
    }

    /// Products of the responses with each other, the same for every dead time.
    ///
    /// Level `l` and decay `c` (states before a sample) update as `l + step` and `a c + step`, so sums of their products follow
    /// from sums over the steps alone: `(1 - a a) sum(c c) = 2 a sum(c step) + sum(step step) - c c` at the end, and so on. The
    /// filtered response is `(1 - rho) l - late (a - rho) c + (1 - late) step`.
    #[inline(always)]
    fn own(&self, steps: &[Step], end: usize) -> Own {
        let walk = self.walk(steps, end);
        let one = 1.0 / self.length as f64;
        let end_power = &self.powers[self.length];
        let share = 1.0 - self.rho;
        let Walked { level, steps: own_steps, total, level_steps, level_level, level_one, .. } = walk;
        let mut out = Own { level, ..Own::default() };
        for l in 0..LANES {
            let (a, late) = (self.a[l], self.late[l]);
            let (of_decay, of_step) = (-late * (a - self.rho), 1.0 - late);
            let (inverse, squared, pivot) = (self.inverse[l], self.squared[l], self.pivot[l]);
            let decay = [walk.decay[0][l], walk.decay[1][l]];
            let memory_step = [walk.memory[0][l], walk.memory[1][l]];
            let with_steps = |h: usize, g: usize| walk.with_steps[2 * h + g][l];
            let product = |h: usize, g: usize| {
                let mixed = with_steps(h, g) + with_steps(g, h);
                let decays = (a * mixed + own_steps[h + g] - decay[h] * decay[g]) * squared;
                let level_decay = |h: usize, g: usize| {
                    (level_steps[h][g] + a * with_steps(g, h) + own_steps[h + g] - level[h] * decay[g]) * inverse
                };
                share * share * level_level[h + g]
                    + share * of_decay * (level_decay(h, g) + level_decay(g, h))
                    + share * of_step * (level_steps[h][g] + level_steps[g][h])
                    + of_decay * (of_decay * decays + of_step * mixed)
                    + of_step * of_step * own_steps[h + g]
            };
            let power = [product(0, 0), product(0, 1), product(1, 1)];
            let (mut sum, mut memory) = ([0.0; 2], [0.0; 2]);
            for h in 0..2 {
                sum[h] = share * level_one[h] + of_decay * (total[h] - decay[h]) * inverse + of_step * total[h];
                let level_memory = (a * memory_step[h] - end_power[l] * level[h]) * inverse;
                let decay_memory = (a * memory_step[h] - end_power[l] * decay[h]) * squared;
                memory[h] = share * level_memory + of_decay * decay_memory + of_step * memory_step[h]
                    - self.one_memory[l] * sum[h] * one;
                (out.sum[h][l], out.memory[h][l]) = (sum[h], memory[h]);
                out.decay[h][l] = decay[h] * late * (a - self.rho);
            }
            out.power[0][l] = power[0] - sum[0] * sum[0] * one - memory[0] * memory[0] * pivot;
            out.power[1][l] = power[1] - sum[0] * sum[1] * one - memory[0] * memory[1] * pivot;
            out.power[2][l] = power[2] - sum[1] * sum[1] * one - memory[1] * memory[1] * pivot;
            let [uu, ud, dd] = [out.power[0][l], out.power[1][l], out.power[2][l]];
            let determinant = uu * dd - ud * ud;
            out.inverse[l] = if determinant > INDEPENDENT * uu * dd { 1.0 / determinant } else { f64::NAN };
        }
        out
    }

    /// One pass over the steps.
    #[inline(always)]
    fn walk(&self, steps: &[Step], end: usize) -> Walked {
        let mut out = Walked::default();
        for (m, step) in steps.iter().enumerate() {
            let i = step.point as usize;
            let next = steps.get(m + 1).map_or(end, |s| s.point as usize);
            let (by, count) = ([step.level, step.direction], (next - i - 1) as f64);
            let (left, memory) = (&self.powers[next - i - 1], &self.powers[i - self.from]);
            for l in 0..LANES {
                for h in 0..2 {
                    for g in 0..2 {
                        out.with_steps[2 * h + g][l] += out.decay[h][l] * by[g];
                    }
                    out.memory[h][l] += memory[l] * by[h];
                    out.decay[h][l] = (self.a[l] * out.decay[h][l] + by[h]) * left[l];
                }
            }
            let before = out.level;
            for h in 0..2 {
                for g in 0..2 {
                    out.level_steps[h][g] += before[h] * by[g];
                }
                out.total[h] += by[h];
                out.level[h] += by[h];
                // Before this sample, and before each sample up to the next step.
                out.level_one[h] += out.level[h] * count + before[h];
            }
            for (h, g) in [(0, 0), (0, 1), (1, 1)] {
                out.steps[h + g] += by[h] * by[g];
                out.level_level[h + g] += out.level[h] * out.level[g] * count + before[h] * before[g];
            }
        }
        out
    }
}

/// A look with the widest vector lanes of the processor; results are identical to the last bit.
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

/// Sums over the steps of both halves of a valve signal; products of halves in the order 00, 01, 11 or as `[one][other]`.
#[derive(Default)]
struct Walked {
    /// Final level and decays.
    level: [f64; 2],
    decay: [Lanes; 2],
    /// Products of steps with each other, their sum, and their products with the memory that begins at the first point.
    steps: [f64; 3],
    total: [f64; 2],
    memory: [Lanes; 2],
    /// Products of level and decays before a step with the step: `[level or decay][step]`.
    level_steps: [[f64; 2]; 2],
    with_steps: [Lanes; 4],
    /// Products of the levels before each sample with each other, and the sum of the levels.
    level_level: [f64; 3],
    level_one: [f64; 2],
}

/// Sums over the responses of both halves of a valve signal, without constant and memory, and their final states.
#[derive(Default)]
struct Own {
    power: [Lanes; 3],
    sum: [Lanes; 2],
    memory: [Lanes; 2],
    decay: [Lanes; 2],
    level: [f64; 2],
    /// Reciprocal of the determinant of the powers. It bounds what gain and kinetic band can explain without any constraint;
    /// NaN if the halves are not independent columns, so that no look is skipped.
    inverse: Lanes,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::ident::Options;
    use crate::core::ident::class::Class;
    use crate::core::ident::least_squares::Gram;
    use crate::core::ident::normalised::normalise;
    use crate::core::record::Record;
    use crate::core::sim::slips::{FirstSlip, Law, Stroke};
    use crate::core::sim::steps::Steps;

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
        let first = FirstSlip { direction: 1.0, threshold: normalised.path.values()[0] + 0.05 };
        steps.run(&normalised.path, 500, Stroke::FREE, Law::He, [0.2, 0.1], first);
        let freedom = Freedom { fd: [fd; 2], fd_default: fd, sign: 1.0, limits: normalised.limits };
        for rho in [0.0, 0.9] {
            let scan = CoarseScan::new(&problem, [rho; 2], 500, vec![3, 9, 20]);
            let seen = scan.look(&steps.list, &freedom);
            let mut valve = vec![0.0; 500];
            for step in &steps.list {
                valve[step.point as usize..].iter_mut().for_each(|v| *v += step.level - fd * step.direction);
            }
            let shape = [libm::log(seen.tau), seen.lag, 0.0];
            let x = Class::First.respond(&shape, &valve);
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
