//! The held-out residual, cut in groups, and whether a cut says more than chance.

use super::{Subject, Test};
use crate::core::gap::types::Fit;
use crate::core::record::Record;
use crate::core::signal::stats;
use crate::core::sim::noise::{Noise, stream_of};

/// Shuffles of a permutation test: p cannot be below 1/200.
const SHUFFLES: usize = 199;
/// Fewest points that are tested.
const MIN_POINTS: usize = 8;

/// What a model leaves of a record, and where that counts.
#[derive(Debug)]
pub(super) struct Held<'a> {
    /// The model.
    pub fit: &'a Fit,
    /// OP at each point, OP units.
    pub op: Vec<f64>,
    /// PV less the free run at each point, PV units; held over masked points, 0 before the first.
    pub residual: Vec<f64>,
    /// First point that counts.
    pub from: usize,
    /// Points that are held out, not masked, and have a residual.
    pub points: Vec<usize>,
    /// Period of the oscillation, points.
    pub period: f64,
    /// Seconds between points.
    pub point_s: f64,
    seed: u64,
}

/// How the squared residual falls to groups of points.
#[derive(Debug)]
pub(super) struct Shares {
    /// Share of each group; `None` where no point of it is held out.
    pub share: Vec<Option<f64>>,
    /// Share of the points of each group: what an even residual would give.
    pub expected: Vec<f64>,
    /// Whether the residual is uneven over the groups.
    pub test: Option<Test>,
}

impl<'a> Held<'a> {
    /// The subject's residual on the record that it was fitted to.
    pub(crate) fn new(record: &Record, subject: &Subject<'a>) -> Self {
        let Subject { fit, blocks, period_points, seed, .. } = *subject;
        let left = |k: usize| {
            let e = record.pv.get(k)? - fit.prediction.get(k)?;
            (k >= blocks.from && e.is_finite()).then_some(e)
        };
        let n = record.len();
        let flag = |mask: &[bool], k: usize| mask.get(k).copied().unwrap_or(false);
        let kept = |k: usize| if flag(&blocks.masked, k) { None } else { left(k) };
        let counts = |k: &usize| kept(*k).is_some() && flag(&blocks.held_out, *k);
        // Masked points take the value before them: an outlier must not ring in the bands.
        let mut last = 0.0;
        let mut held = |k: usize| {
            last = kept(k).unwrap_or(last);
            last
        };
        // Blocks are one and a half periods long.
        let period = period_points.filter(|p| p.is_finite() && *p >= 2.0).unwrap_or(blocks.length as f64 / 1.5);
        Self {
            fit,
            op: record.op(),
            residual: (0..n).map(&mut held).collect(),
            from: blocks.from.min(n),
            points: (0..n).filter(counts).collect(),
            period: period.clamp(2.0, (n as f64).max(2.0)),
            point_s: record.point_s(),
            seed,
        }
    }

    /// The residual at the points that count.
    pub(crate) fn values(&self) -> Vec<f64> {
        self.points.iter().map(|&k| self.residual[k]).collect()
    }

    /// Its squares.
    pub(crate) fn squares(&self) -> Vec<f64> {
        self.points.iter().map(|&k| self.residual[k] * self.residual[k]).collect()
    }

    /// The group (below `count`) of each point, and how many points each has.
    fn groups(&self, count: usize, group_of: impl Fn(usize) -> usize) -> (Vec<usize>, Vec<f64>) {
        let groups: Vec<usize> = self.points.iter().map(|&k| group_of(k).min(count.saturating_sub(1))).collect();
        let members = sums(&groups, &vec![1.0; groups.len()], count);
        (groups, members)
    }

    /// Cuts the squared residual by the group (below `count`) of each point.
    pub(crate) fn shares(&self, purpose: &str, count: usize, group_of: impl Fn(usize) -> usize) -> Shares {
        let (groups, members) = self.groups(count, group_of);
        let squares = self.squares();
        let whole: f64 = squares.iter().sum();
        let total = (groups.len() as f64).max(1.0);
        let expected: Vec<f64> = members.iter().map(|m| m / total).collect();
        let is_some = whole.is_finite() && whole > 0.0;
        let share = |(sum, m): (f64, &f64)| (is_some && *m > 0.0).then(|| sum / whole);
        let uneven = |squares: &[f64]| {
            let terms = sums(&groups, squares, count).into_iter().zip(&expected).filter(|(_, e)| **e > 0.0);
            terms.map(|(sum, e)| (sum / whole - e) * (sum / whole - e) / e).sum::<f64>()
        };
        Shares {
            share: sums(&groups, &squares, count).into_iter().zip(&members).map(share).collect(),
            test: if is_some { self.test(purpose, &squares, uneven) } else { None },
            expected,
        }
    }

    /// The share of variance that the means of groups explain (R2), tested.
    pub(crate) fn explained(&self, purpose: &str, count: usize, group_of: impl Fn(usize) -> usize) -> Option<Test> {
        let (groups, members) = self.groups(count, group_of);
        let r2 = |values: &[f64]| {
            let (m, n) = (stats::mean(values), values.len() as f64);
            let sums = sums(&groups, values, count);
            let between: f64 = sums.iter().zip(&members).filter(|(_, n)| **n > 0.0).map(|(sum, n)| sum * sum / n).sum();
            (between - m * m * n) / (stats::variance(values) * n)
        };
        self.test(purpose, &self.values(), r2)
    }

    /// Tests a statistic of values at the held points against the same after shuffling: blocks of one and a half
    /// periods change places and turn within themselves, so that their own correlation stays and their place goes.
    pub(crate) fn test(&self, purpose: &str, values: &[f64], statistic: impl Fn(&[f64]) -> f64) -> Option<Test> {
        let length = (1.5 * self.period).round().max(1.0) as usize;
        if values.len() < MIN_POINTS { None } else { self.against_chance(purpose, values, length, statistic) }
    }

    /// The same for values that do not hang together, each moved alone.
    pub(crate) fn test_singly(&self, purpose: &str, values: &[f64], statistic: impl Fn(&[f64]) -> f64) -> Option<Test> {
        self.against_chance(purpose, values, 1, statistic)
    }

    fn against_chance(
        &self,
        purpose: &str,
        values: &[f64],
        length: usize,
        statistic: impl Fn(&[f64]) -> f64,
    ) -> Option<Test> {
        let value = statistic(values);
        if !value.is_finite() {
            return None;
        }
        let mut noise = Noise::new(self.seed, stream_of(purpose));
        let mut chance: Vec<f64> = Vec::with_capacity(SHUFFLES);
        let mut moved = Vec::with_capacity(values.len());
        for _ in 0..SHUFFLES {
            shuffle_into(values, length, &mut noise, &mut moved);
            chance.push(statistic(&moved));
        }
        let above = chance.iter().filter(|c| **c >= value).count();
        Some(Test { value, threshold: stats::quantile(&chance, 0.95), p: (1 + above) as f64 / (1 + SHUFFLES) as f64 })
    }
}

/// Sum of the values of each group.
fn sums(groups: &[usize], values: &[f64], count: usize) -> Vec<f64> {
    let mut sums = vec![0.0; count];
    groups.iter().zip(values).for_each(|(&g, v)| sums[g] += v);
    sums
}

/// The blocks of `values` in random order, each turned by a random number of points.
fn shuffle_into(values: &[f64], length: usize, noise: &mut Noise, out: &mut Vec<f64>) {
    let mut order: Vec<&[f64]> = values.chunks(length.max(1)).collect();
    for last in (1..order.len()).rev() {
        order.swap(last, noise.below(last as u64 + 1) as usize);
    }
    out.clear();
    for block in order {
        let turn = noise.below(block.len() as u64) as usize;
        out.extend_from_slice(&block[turn..]);
        out.extend_from_slice(&block[..turn]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shuffling_keeps_every_value() {
        let values: Vec<f64> = (0..103).map(f64::from).collect();
        let (mut noise, mut out) = (Noise::new(3, 1), Vec::new());
        shuffle_into(&values, 20, &mut noise, &mut out);
        assert_ne!(out, values);
        assert_eq!(stats::sorted(&out), values);
    }
}
