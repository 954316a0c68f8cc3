//! Several windows of one valve, diagnosed together: one physics and one set of effects, level and start of each window its own
//! (merged experiments, Ljung 1999, ch. 14).
//!
//! The windows are joined to one record. PV's level in a window is what the base leaves there on average; once an effect is
//! found, what the model with the effect leaves. The start of each window counts for nothing ([`super::windows`]), blocks are
//! held out within each window, and the run forward leaves out whole windows.

use core::ops::Range;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::diagnosis::diagnose_in;
use super::express::fit;
use super::judged::Diagnosis;
use super::noise;
use super::problem::{Problem, period_of};
use super::schedule::{self, Work};
use super::signatures;
use super::types::{Base, Blocks, Executor, Fit, GapError, GapOptions};
use super::windows::Windows;
use crate::record::{Facts, Record};
use crate::signal::stats;
use crate::sim::slips::Law;
use crate::units::Moment;

/// Fewest points of a window, and fewest periods.
const POINTS: usize = 60;
const PERIODS: f64 = 2.0;
/// Share by which sampling times may differ.
const SAME_TIME: f64 = 0.01;
/// Error of the common base over a window's own deviation from which the window is another loop's, where it is less than
/// [`OTHERS`] in most windows.
const ANOTHER: f64 = 1.1;
const OTHERS: f64 = 0.9;
/// Mean that a window may keep of what the best model leaves, as a share of that.
const LEVELLED: f64 = 0.1;
/// Bases that are fitted from one set of levels at most.
const ROUNDS: usize = 3;
/// Searches at most: the levels that the base asks for, and those that an effect asks for.
const SEARCHES: usize = 2;

/// One window.
#[derive(Debug, Clone, PartialEq)]
pub struct Window {
    /// Where it comes from, for messages and documents.
    pub source: String,
    /// What was recorded.
    pub record: Record,
}

/// A window as documents have it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct WindowNote {
    /// Its file, or another name.
    pub source: String,
    /// Timestamp of its first sample, ns since 1970.
    pub start_ns: i64,
    /// Timestamp of its last sample, ns since 1970.
    pub end_ns: i64,
    /// The start, RFC 3339.
    #[cfg_attr(feature = "schema", schemars(with = "String"))]
    pub start: Moment,
    /// The end, RFC 3339.
    #[cfg_attr(feature = "schema", schemars(with = "String"))]
    pub end: Moment,
    /// Raw samples.
    pub samples: u64,
    /// Its first sample on the joined time axis, s: all other times of the document are on that axis.
    pub from_s: f64,
    /// PV's level above the mean of all windows for the same OP, PV units.
    pub level: f64,
    /// Root mean squared error of the refitted base on its held-out blocks, PV units; `None` where nothing is held out.
    pub rmse: Option<f64>,
}

/// The diagnosis of several windows.
#[derive(Debug, Clone, PartialEq)]
pub struct Pooled {
    /// The joined record, every window at the common level.
    pub record: Record,
    /// The diagnosis of it.
    pub diagnosis: Diagnosis,
    /// The windows.
    pub windows: Vec<WindowNote>,
    /// Their period, points.
    pub period: f64,
}

impl Pooled {
    /// The record of each window at the common level.
    pub fn records(&self) -> impl Iterator<Item = Record> + '_ {
        (0..self.windows.len()).map(|at| {
            let points = self.points(at);
            self.record.part(points.start, points.end)
        })
    }

    /// The points of a window in the joined record.
    #[must_use]
    pub fn points(&self, at: usize) -> Range<usize> {
        let window = &self.windows[at];
        let from = (window.from_s / self.record.point_s()).round() as usize;
        from..(from + window.samples as usize / self.record.box_samples).min(self.record.len())
    }
}

/// Why windows cannot be diagnosed together.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PoolError {
    /// Fewer than two windows.
    #[error("one window only: give the files or sections of at least two")]
    Single,
    /// Another sampling time.
    #[error(
        "{source_name}: sampled every {ts_s} s, but {first} every {wanted_s} s; leave it out, or bring all to one time \
         with --downsample"
    )]
    SamplingTime {
        /// The window that differs.
        source_name: String,
        /// Its time between points, s.
        ts_s: f64,
        /// The first window.
        first: String,
        /// Its time between points, s.
        wanted_s: f64,
    },
    /// Too few points.
    #[error(
        "{source_name}: {points} points, but a window needs {needed} (two periods); leave it out or choose a longer section"
    )]
    TooShort {
        /// The window.
        source_name: String,
        /// Its points.
        points: usize,
        /// Points needed.
        needed: usize,
    },
    /// A constant signal.
    #[error("{source_name}: {signal} is constant; leave it out or choose a section in which it moves")]
    Still {
        /// The window.
        source_name: String,
        /// The signal.
        signal: &'static str,
    },
    /// The same data twice.
    #[error("{source_name}: the same data as {other}; leave one of them out")]
    Twice {
        /// The later of the two.
        source_name: String,
        /// The earlier.
        other: String,
    },
    /// A window that the common model does not follow.
    #[error(
        "{source_name}: the model of all windows leaves {left_pct:.0} % of PV's standard deviation there and {others_pct:.0} % in most \
         others: it is another loop's or was recorded after a change; leave it out or diagnose it by itself"
    )]
    AnotherLoop {
        /// The window.
        source_name: String,
        /// What is left there, %.
        left_pct: f64,
        /// The median of the others, %.
        others_pct: f64,
    },
    /// The joined record cannot be diagnosed.
    #[error(transparent)]
    Gap(#[from] GapError),
}

/// Median period of the windows that oscillate, else of all, points.
fn period(windows: &[Window]) -> f64 {
    let all: Vec<(f64, bool)> = windows.iter().map(|w| period_of(&w.record)).collect();
    let of = |wanted: bool| -> Vec<f64> { all.iter().filter(|(_, o)| *o || !wanted).map(|(p, _)| *p).collect() };
    let regular = of(true);
    stats::median(&if regular.is_empty() { of(false) } else { regular })
}

/// Whether windows can be joined, by their records alone.
fn check(windows: &[Window], period: f64) -> Result<(), PoolError> {
    let [first, _, ..] = windows else { return Err(PoolError::Single) };
    for (at, window) in windows.iter().enumerate() {
        let (source_name, record) = (window.source.clone(), &window.record);
        let (ts_s, wanted_s) = (record.point_s(), first.record.point_s());
        let same_path = record.path_per_point() == first.record.path_per_point();
        if (ts_s / wanted_s - 1.0).abs() > SAME_TIME || !same_path || record.box_samples != first.record.box_samples {
            return Err(PoolError::SamplingTime { source_name, ts_s, first: first.source.clone(), wanted_s });
        }
        let needed = POINTS.max((PERIODS * period).ceil() as usize);
        if record.len() < needed {
            return Err(PoolError::TooShort { source_name, points: record.len(), needed });
        }
        for (signal, spread) in [("OP", stats::span(&record.op_path)), ("PV", stats::std_dev(&record.pv))] {
            if !spread.is_normal() {
                return Err(PoolError::Still { source_name, signal });
            }
        }
        if let Some(other) =
            windows[..at].iter().find(|w| w.record.pv == record.pv && w.record.op_path == record.op_path)
        {
            return Err(PoolError::Twice { source_name, other: other.source.clone() });
        }
    }
    Ok(())
}

/// The windows one after the other, and where each begins.
fn join(windows: &[Window]) -> (Record, Vec<usize>) {
    let records = || windows.iter().map(|w| &w.record);
    let all = |of: &dyn Fn(&Record) -> &[f64]| records().flat_map(of).copied().collect();
    let both = |of: fn(&Record) -> Option<&Vec<f64>>| -> Option<Vec<f64>> {
        let parts: Option<Vec<&Vec<f64>>> = records().map(of).collect();
        parts.map(|parts| parts.into_iter().flatten().copied().collect())
    };
    let sum = |of: &dyn Fn(&Facts) -> u32| records().map(|r| of(&r.facts)).sum();
    let first = &windows[0].record;
    let record = Record {
        start_ns: records().map(|r| r.start_ns).min().unwrap_or(first.start_ns),
        end_ns: records().map(|r| r.end_ns).max().unwrap_or(first.end_ns),
        raw_samples: records().map(|r| r.raw_samples).sum(),
        op_path: all(&|r| &r.op_path),
        pv: all(&|r| &r.pv),
        sp: both(|r| r.sp.as_ref()),
        mv: both(|r| r.mv.as_ref()),
        irregularity: records().map(|r| r.irregularity).fold(0.0, f64::max),
        facts: Facts {
            manual: sum(&|f| f.manual),
            filled: sum(&|f| f.filled),
            bad: sum(&|f| f.bad),
            pv_repeats: sum(&|f| f.pv_repeats),
            op_repeats: sum(&|f| f.op_repeats),
        },
        ..*first
    };
    let mut starts = Vec::with_capacity(windows.len());
    let mut end = 0;
    for record in records() {
        starts.push(end);
        end += record.len();
    }
    (record, starts)
}

/// Joined windows on the way to a diagnosis.
struct Joined<'o> {
    record: Record,
    starts: Vec<usize>,
    period: f64,
    options: &'o GapOptions,
}

/// Levels of the windows, and the base that was fitted at them.
struct Levelled {
    levels: Vec<f64>,
    base: Fit,
    problem: Problem,
}

impl Joined<'_> {
    fn windows(&self, left: Vec<f64>) -> Arc<Windows> {
        Arc::new(Windows::new(self.starts.clone(), left))
    }

    /// The record with a level taken out of PV and SP in each window, and another out of OP.
    fn levelled(&self, pv: &[f64], op: &[f64]) -> Record {
        let mut record = self.record.clone();
        let path = record.path_per_point();
        for (at, window) in self.windows(Vec::new()).ranges(record.len()).enumerate() {
            let signals = [Some(&mut record.pv), record.sp.as_mut()];
            signals.into_iter().flatten().for_each(|x| x[window.clone()].iter_mut().for_each(|y| *y -= pv[at]));
            let path = window.start * path..window.end * path;
            record.op_path[path].iter_mut().for_each(|u| *u -= op[at]);
        }
        record
    }

    /// Means of each window over its last whole periods.
    fn means(&self, x: &[f64]) -> Vec<f64> {
        let mean = |window: Range<usize>| {
            let whole = (window.len() as f64 / self.period).floor().max(1.0) * self.period;
            let from = window.end.saturating_sub(whole.round() as usize).max(window.start);
            stats::mean(&x[from..window.end])
        };
        self.windows(Vec::new()).ranges(x.len()).map(mean).collect()
    }

    /// The base of a levelled record, and how many responses that took.
    fn base(&self, record: &Record, executor: &dyn Executor) -> (Option<(Fit, Problem)>, u64) {
        let (period, options) = (self.period, self.options);
        let traces = signatures::traces(record, period, &options.without);
        let problem = Problem::new(record, Some(period), options.seed, traces.masked.clone());
        let problem = problem.fitted_where(&traces.measured).in_windows(self.windows(Vec::new()));
        let floor = noise::floor(&record.pv, &traces.measured, false).noise_floor;
        let law = if options.base == Base::Linear { None } else { Some(Law::He) };
        let (budget, seed) = (options.budget_evaluations, options.seed);
        let mut work = Work { executor, budget, done: 0, stopped: false, spent: false, seed, asked: None };
        let found = schedule::base(&problem, law, floor, &mut work);
        let made = found.and_then(|(base, _)| fit(&problem, &base, floor, &|_| {}));
        (made.map(|fit| (fit, problem)), work.done)
    }

    /// The levels that the base asks for, from those of windows that stand alike and from those that OP's means ask for: fitted
    /// to wrong levels, a base does not ask for the right ones. And how many responses that took.
    fn levels(&self, executor: &dyn Executor) -> (Option<Levelled>, u64) {
        // Both signals about their means ask for no level; the gain found so tells the levels where OP is as it is.
        let [pv, op] = [&self.record.pv, &self.record.op()].map(|x| self.means(x));
        let (found, mut done) = self.base(&self.levelled(&pv, &op), executor);
        let none = vec![0.0; pv.len()];
        let mut starts = vec![none.clone()];
        starts.extend(found.map(|(fit, _)| {
            let levels: Vec<f64> = pv.iter().zip(&op).map(|(y, u)| y - fit.model.process.gain * u).collect();
            let middle = stats::mean(&levels);
            levels.iter().map(|level| level - middle).collect()
        }));
        let mut best: Option<Levelled> = None;
        for mut levels in starts {
            for _ in 0..ROUNDS {
                let record = self.levelled(&levels, &none);
                let (found, more) = self.base(&record, executor);
                done += more;
                let Some((base, problem)) = found else { break };
                let shifts = self.shifts(&residual(&record, &base), &problem.blocks);
                let is_level = shifts.iter().all(|shift| shift.abs() <= LEVELLED * base.rmse_train);
                let asked = levels.iter().zip(&shifts).map(|(level, shift)| level + shift).collect();
                if best.as_ref().is_none_or(|best| base.rmse_train < best.base.rmse_train) {
                    best = Some(Levelled { levels, base, problem });
                }
                levels = asked;
                if is_level {
                    break;
                }
            }
        }
        (best, done)
    }

    /// Mean of a residual over each window's fitted points.
    fn shifts(&self, left: &[f64], blocks: &Blocks) -> Vec<f64> {
        let fitted = |k: &usize| *k >= blocks.from && !blocks.held_out[*k] && !blocks.masked[*k];
        let mean = |window: Range<usize>| {
            let points: Vec<f64> = window.filter(fitted).map(|k| left[k]).collect();
            if points.is_empty() { 0.0 } else { stats::mean(&points) }
        };
        self.windows(Vec::new()).ranges(left.len()).map(mean).collect()
    }
}

fn residual(record: &Record, fit: &Fit) -> Vec<f64> {
    record.pv.iter().zip(&fit.prediction).map(|(y, p)| y - p).collect()
}

/// Names the window that a base of all does not follow.
fn alike(joined: &Joined<'_>, windows: &[Window], left: &[f64], problem: &Problem) -> Result<(), PoolError> {
    let counts = |k: &usize| *k as f64 >= joined.period && !problem.blocks.masked[*k];
    let share = |(window, of): (Range<usize>, &Window)| {
        let points: Vec<f64> = window.filter(counts).map(|k| left[k]).collect();
        let own = stats::mean(&points);
        let power = points.iter().map(|x| (x - own) * (x - own)).sum::<f64>() / points.len().max(1) as f64;
        power.sqrt() / stats::std_dev(&of.record.pv)
    };
    let shares: Vec<f64> = joined.windows(Vec::new()).ranges(left.len()).zip(windows).map(share).collect();
    let Some(worst) = (0..shares.len()).max_by(|a, b| shares[*a].total_cmp(&shares[*b])) else { return Ok(()) };
    let others: Vec<f64> = shares.iter().enumerate().filter(|(i, _)| *i != worst).map(|(_, s)| *s).collect();
    let most = stats::median(&others);
    if shares[worst] > ANOTHER && most < OTHERS {
        let source_name = windows[worst].source.clone();
        return Err(PoolError::AnotherLoop { source_name, left_pct: 100.0 * shares[worst], others_pct: 100.0 * most });
    }
    Ok(())
}

/// Diagnoses windows together.
///
/// # Errors
/// A window that does not fit the others, with its name; or the joined record cannot be diagnosed.
pub fn diagnose(windows: &[Window], options: &GapOptions, executor: &dyn Executor) -> Result<Pooled, PoolError> {
    let period = options.period_points.unwrap_or_else(|| period(windows));
    check(windows, period)?;
    let options = GapOptions { period_points: Some(period), neighbours: Vec::new(), ..options.clone() };
    let (record, starts) = join(windows);
    let joined = Joined { record, starts, period, options: &options };
    let points = joined.record.len();
    let no_base = |evaluations| GapError::NoBase { points, evaluations };
    let (levelled, mut done) = joined.levels(executor);
    let Levelled { mut levels, base, problem } = levelled.ok_or(no_base(done))?;
    let none = vec![0.0; levels.len()];
    let mut record = joined.levelled(&levels, &none);
    let left = residual(&record, &base);
    alike(&joined, windows, &left, &problem)?;
    let mut shifts = joined.shifts(&left, &problem.blocks);
    let seen = joined.windows(left);
    let mut made = None;
    for _ in 0..SEARCHES {
        levels.iter_mut().zip(&shifts).for_each(|(level, shift)| *level += shift);
        record = joined.levelled(&levels, &none);
        let diagnosis = diagnose_in(&record, &options, Some(&seen), executor)?;
        done += diagnosis.evaluations;
        let fits = diagnosis.effects.iter().filter(|e| e.simulated).filter_map(|e| e.fit.as_ref());
        let best = fits.chain([&diagnosis.base]).min_by(|a, b| a.rmse_train.total_cmp(&b.rmse_train));
        let (left, least) = best.map_or_else(Default::default, |best| (residual(&record, best), best.rmse_train));
        shifts = joined.shifts(&left, &diagnosis.blocks);
        let stopped = diagnosis.stopped_early;
        made = Some(diagnosis);
        if stopped || shifts.iter().all(|shift| shift.abs() <= LEVELLED * least) {
            break;
        }
    }
    let mut diagnosis = made.ok_or(no_base(done))?;
    diagnosis.evaluations = done;
    let windows = notes(windows, &joined, &record, &levels, &diagnosis);
    Ok(Pooled { record, diagnosis, windows, period })
}

/// The windows as documents have them.
fn notes(
    windows: &[Window],
    joined: &Joined<'_>,
    record: &Record,
    levels: &[f64],
    diagnosis: &Diagnosis,
) -> Vec<WindowNote> {
    let (left, blocks) = (residual(record, &diagnosis.base), &diagnosis.blocks);
    let middle = stats::mean(levels);
    let ranges = joined.windows(Vec::new());
    let of = |(at, (window, range)): (usize, (&Window, Range<usize>))| {
        let counts = |k: &usize| blocks.held_out[*k] && !blocks.masked[*k];
        let held: Vec<f64> = range.clone().filter(counts).map(|k| left[k] * left[k]).collect();
        let own = &window.record;
        WindowNote {
            source: window.source.clone(),
            start_ns: own.start_ns,
            end_ns: own.end_ns,
            start: Moment(own.start_ns),
            end: Moment(own.end_ns),
            samples: own.raw_samples as u64,
            from_s: range.start as f64 * record.point_s(),
            level: levels[at] - middle,
            rmse: (!held.is_empty()).then(|| stats::mean(&held).sqrt()),
        }
    };
    windows.iter().zip(ranges.ranges(record.len())).enumerate().map(of).collect()
}
