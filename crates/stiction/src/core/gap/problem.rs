//! The record as the search sees it: normalised, divided into blocks that are fitted and blocks that are held out.

use std::sync::{Arc, OnceLock};

use super::candidate::Parameters;
use super::neighbour::Load;
use super::traces::between;
use super::types::Blocks;
use crate::core::detect::oscillation;
use crate::core::ident::evaluator;
use crate::core::ident::normalised::{NormalisedRecord, normalise};
use crate::core::ident::{ModelChoice, Options, ValveChoice, sign};
use crate::core::record::Record;
use crate::core::signal::stats;

/// Filter of the view in which wrong slips and slow disturbances weigh little: `1 - rho q^-1`.
pub(crate) const MOVES_RHO: f64 = 0.95;
/// Periods in a block.
const BLOCK_PERIODS: f64 = 1.5;
/// Fewest and most blocks.
const BLOCKS: [usize; 2] = [6, 60];
/// How far back OP is compared to find points that are alike, periods.
const BACK: [f64; 8] = [0.0, 0.06, 0.12, 0.2, 0.3, 0.45, 0.65, 0.9];

/// Which error is meant: the free run's itself, or that of its differences.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum View {
    /// The error itself.
    Plain,
    /// Filtered differences: a wrong slip and a slow disturbance weigh little.
    Moves,
}

/// One record, normalised.
#[derive(Debug, Clone)]
pub struct Problem {
    /// The record in normalised form.
    pub normalised: NormalisedRecord,
    /// What counts for what.
    pub blocks: Blocks,
    /// PV as it is fitted, where a recorder put something of its own between what was measured: straight lines there.
    drawn: Option<Vec<f64>>,
    /// Points at which PV was measured.
    measured: Vec<bool>,
    /// See [`Problem::fill_held_out`].
    alike: OnceLock<Arc<Vec<[usize; 2]>>>,
    /// Stretches that are fitted, points.
    pub train: Vec<[usize; 2]>,
    /// Stretches that are held out.
    pub test: Vec<[usize; 2]>,
    /// PV on the fitted stretches, one after the other, plain and filtered.
    targets: [Vec<f64>; 2],
    /// The same for the evaluator.
    views: [Arc<evaluator::View>; 2],
    /// Sign of the gain, where it could be read.
    pub sign: Option<f64>,
    /// Typical period, points.
    pub period: f64,
    /// Whether it oscillates regularly.
    pub oscillates: bool,
    /// Middle of OP, OP units.
    pub op_middle: f64,
    /// Mean of PV, PV units.
    pub pv_mean: f64,
    /// Seconds a point, seconds a raw sample, raw samples a point.
    pub point_s: f64,
    /// Raw samples in a point.
    pub box_samples: f64,
    /// Where a model that was given has the base's parameters: its search begins there, too.
    pub stated: Vec<Parameters>,
    /// The neighbour that the effect of that name takes as a load.
    pub neighbour: Option<Arc<Load>>,
}

/// What the base of every fit is told.
#[must_use]
pub(crate) fn options(seed: u64, period: f64) -> Options {
    Options {
        model: ModelChoice::Fopdt,
        valve: ValveChoice::He,
        seed,
        period_points: Some(period),
        ..Options::default()
    }
}

/// Period of the record's oscillation, or of its typical movement, points; and whether it oscillates.
#[must_use]
pub(crate) fn period_of(record: &Record) -> (f64, bool) {
    let op = record.op();
    let n = record.len() as f64;
    let (period, regular) = match oscillation::detect(&op, &record.pv) {
        Some(o) if o.oscillating => (o.period_points, true),
        _ => (oscillation::typical_period(&record.pv).unwrap_or(n / 10.0), false),
    };
    (period.clamp(8.0, n / 4.0), regular)
}

impl Problem {
    /// Poses a record; `masked` points count for nothing.
    #[must_use]
    pub(crate) fn new(record: &Record, period: Option<f64>, seed: u64, masked: Vec<bool>) -> Self {
        let (span, deviation) = (stats::span(&record.op_path), stats::std_dev(&record.pv));
        let (seen, oscillates) = period_of(record);
        let period = period.unwrap_or(seen).clamp(8.0, record.len() as f64 / 4.0);
        let normalised = normalise(record, &options(seed, period), span, deviation);
        let blocks = divide(record.len(), normalised.from, period, masked);
        let sign = sign::of_gain(&normalised.mean, &normalised.pv);
        let nothing = Arc::new(evaluator::View::new(&[], 0.0, 1));
        let mut problem = Self {
            train: Vec::new(),
            test: Vec::new(),
            targets: [Vec::new(), Vec::new()],
            views: [Arc::clone(&nothing), nothing],
            drawn: None,
            measured: vec![true; record.len()],
            alike: OnceLock::new(),
            normalised,
            blocks,
            sign,
            period,
            oscillates,
            op_middle: stats::mean(&record.op_path),
            pv_mean: stats::mean(&record.pv),
            point_s: record.point_s(),
            box_samples: record.box_samples as f64,
            stated: Vec::new(),
            neighbour: None,
        };
        let held_out = problem.blocks.held_out.clone();
        problem.divide_by(&held_out);
        problem
    }

    /// The same problem fitted only where PV was `measured`; errors on held-out stretches count everywhere.
    #[must_use]
    pub(crate) fn fitted_where(mut self, measured: &[bool]) -> Self {
        if measured.len() == self.n() && !measured.iter().all(|m| *m) {
            self.measured = measured.to_vec();
            let held_out = self.blocks.held_out.clone();
            self.divide_by(&held_out);
        }
        self
    }

    /// PV as it is fitted, deviations.
    #[must_use]
    pub(crate) fn fitted_pv(&self) -> &[f64] {
        self.drawn.as_deref().unwrap_or(&self.normalised.pv)
    }

    /// OP units of a place in spans.
    #[must_use]
    pub(crate) fn op_of(&self, spans: f64) -> f64 {
        spans * self.normalised.span + self.op_middle
    }

    /// PV units of a value in deviations.
    #[must_use]
    pub(crate) fn pv_of(&self, deviations: f64) -> f64 {
        deviations * self.normalised.deviation + self.pv_mean
    }

    /// Whether PV was measured at a point.
    #[must_use]
    pub(crate) fn is_measured(&self, k: usize) -> bool {
        self.measured[k]
    }

    /// The same problem with other points held out.
    #[must_use]
    pub(crate) fn held_out_by(&self, held_out: &[bool]) -> Self {
        let mut problem = self.clone();
        problem.blocks.held_out = held_out.to_vec();
        problem.divide_by(held_out);
        problem
    }

    fn divide_by(&mut self, held_out: &[bool]) {
        self.alike = OnceLock::new();
        self.drawn = (!self.measured.iter().all(|m| *m)).then(|| {
            let kept: Vec<bool> = self.measured.iter().zip(held_out).map(|(m, held)| *m && !held).collect();
            let mut drawn = self.normalised.pv.clone();
            between(&kept, &mut drawn);
            drawn
        });
        let from = self.blocks.from;
        let stretches = |wanted: bool| {
            let mut out: Vec<[usize; 2]> = Vec::new();
            for (k, held) in held_out.iter().enumerate().skip(from) {
                let fitted = wanted || self.measured[k];
                // Filtered differences need the point before.
                let follows_held_out = !wanted && k > 0 && held_out[k - 1];
                if *held != wanted || self.blocks.masked[k] || !fitted || follows_held_out {
                    continue;
                }
                match out.last_mut() {
                    Some(last) if last[1] == k => last[1] = k + 1,
                    _ => out.push([k, k + 1]),
                }
            }
            out
        };
        (self.train, self.test) = (stretches(false), stretches(true));
        let mut targets = [Vec::new(), Vec::new()];
        for (target, view) in targets.iter_mut().zip(View::ALL) {
            self.gather(self.fitted_pv(), view, target);
        }
        self.targets = targets;
        let from = self.blocks.from.max(1);
        self.views = [0.0, MOVES_RHO]
            .map(|rho| Arc::new(evaluator::View::of_stretches(self.fitted_pv(), &[], rho, from, &self.train)));
    }

    /// Puts on the held-out points of a signal what it does at the other point before which OP moved most alike: a scan of
    /// the whole record sees nothing of them.
    pub(crate) fn fill_held_out(&self, x: &mut [f64]) {
        for [held, other] in self.alike.get_or_init(|| Arc::new(self.find_alike())).iter() {
            x[*held] = x[*other];
        }
    }

    fn find_alike(&self) -> Vec<[usize; 2]> {
        let op = &self.normalised.mean;
        let back = BACK.map(|periods| (periods * self.period).round() as usize);
        let apart = |a: usize, b: usize, most: f64| {
            let mut sum = 0.0;
            for lag in back {
                let difference = op[a.saturating_sub(lag)] - op[b.saturating_sub(lag)];
                sum += difference * difference;
                if sum >= most {
                    break;
                }
            }
            sum
        };
        let is_held = |k: &usize| self.blocks.held_out[*k];
        let others: Vec<usize> =
            (self.blocks.from..self.n()).filter(|k| !is_held(k) && !self.blocks.masked[*k]).collect();
        let nearest = |held: usize| {
            let start = (f64::INFINITY, None);
            let nearer = |(least, at), other: &usize| {
                let distance = apart(held, *other, least);
                if distance < least { (distance, Some(*other)) } else { (least, at) }
            };
            others.iter().fold(start, nearer).1.map(|other| [held, other])
        };
        (0..self.n()).filter(is_held).filter_map(nearest).collect()
    }

    /// PV on the fitted stretches as the evaluator takes it.
    #[must_use]
    pub(crate) fn view(&self, view: View) -> &Arc<evaluator::View> {
        &self.views[view as usize]
    }

    /// PV on the fitted stretches.
    #[must_use]
    pub(crate) fn target(&self, view: View) -> &[f64] {
        &self.targets[view as usize]
    }

    /// The same problem for running a model over all of it.
    #[must_use]
    pub(crate) fn whole(&self) -> Self {
        let mut problem = self.clone();
        problem.train = vec![[0, self.n()]];
        problem
    }

    /// Points in the record.
    #[must_use]
    pub(crate) fn n(&self) -> usize {
        self.normalised.pv.len()
    }

    /// Longest lag, points.
    #[must_use]
    pub(crate) fn longest_lag(&self) -> f64 {
        self.normalised.limits.lag[1]
    }
}

impl View {
    /// All, in the order of their targets.
    pub(crate) const ALL: [Self; 2] = [Self::Plain, Self::Moves];
}

impl Problem {
    /// A signal on the fitted stretches, as a view sees it.
    pub(crate) fn gather(&self, x: &[f64], view: View, out: &mut Vec<f64>) {
        out.clear();
        match view {
            View::Plain => self.train.iter().for_each(|[from, to]| out.extend_from_slice(&x[*from..*to])),
            View::Moves => {
                for [from, to] in &self.train {
                    out.extend(x[from.max(&1) - 1..*to].windows(2).map(|w| w[1] - MOVES_RHO * w[0]));
                }
            }
        }
    }
}

/// Blocks of one and a half periods from `from` on, every second one held out.
fn divide(n: usize, from: usize, period: f64, masked: Vec<bool>) -> Blocks {
    let rest = n - from;
    let least = rest.div_ceil(BLOCKS[1]).max(4);
    let most = (rest / BLOCKS[0]).max(least);
    let length = ((BLOCK_PERIODS * period).round() as usize).clamp(least, most);
    let number: Vec<usize> = (0..n).map(|k| k.saturating_sub(from) / length).collect();
    let held_out = (0..n).map(|k| k >= from && number[k] % 2 == 1).collect();
    Blocks { from, length, held_out, masked, number }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn half_is_held_out_and_masked_points_count_nowhere() {
        let op: Vec<f64> = (0..600).map(|k| libm::sin(f64::from(k) * 0.1)).collect();
        let pv: Vec<f64> = (0..600).map(|k| libm::sin(f64::from(k) * 0.1 - 0.5)).collect();
        let mut masked = vec![false; 600];
        masked[300] = true;
        let problem = Problem::new(&Record::uniform(1.0, op, pv), None, 1, masked);
        let count = |x: &[[usize; 2]]| x.iter().map(|[a, b]| b - a).sum::<usize>();
        let (train, test) = (count(&problem.train), count(&problem.test));
        let after_held_out = problem.blocks.held_out.windows(2).filter(|w| w[0] && !w[1]).count();
        assert_eq!(train + test + after_held_out + 1 + problem.blocks.from, 600);
        assert!(test * 3 > train && train * 3 > test);
        assert_eq!(problem.target(View::Plain).len(), train);
        assert!(problem.train.iter().chain(&problem.test).all(|[a, b]| *b <= 300 || *a > 300));
        assert!((problem.period - 62.8).abs() < 1.0 && problem.oscillates);
    }
}
