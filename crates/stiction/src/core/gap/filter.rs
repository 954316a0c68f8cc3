//! A filter in the transmitter or in the PV block: it lags signal and noise alike, so what a free run leaves has a memory
//! of just the filter's time constant. With the filter undone the record is the base's again and its noise is white.
//!
//! The pole is read from what the best models leave, or is that of a second lag; PV is unfiltered with it, the base is
//! fitted to that, and lag and colour agree where the filter explains PV one step ahead as well as any model with a memory of its own.

use super::express::fit;
use super::noise::{self, least_squares::solve};
use super::problem::Problem;
use super::schedule::{self, Found, Work, residual_of};
use super::search::Search;
use super::traces::Traces;
use super::types::{Fit, Parameter};
use crate::core::record::Record;
use crate::core::sim::process::separated;
use crate::core::sim::slips::Law;

/// Poles that are a filter's: below, a scan's own; above, a drift.
const POLES: [f64; 2] = [0.3, 0.985];
/// Log mean squared error that an autoregression of higher order may gain over one of first order.
const FIRST_ORDER: f64 = 0.15;
/// Poles that are tried, how far apart their time constants are, and how many of these a record has to hold.
const TRIED: usize = 2;
const APART: f64 = 0.2;
const LENGTHS: f64 = 10.0;
/// Log mean squared error one step ahead by which the filter may stay behind the best model with a memory of four, and by
/// which it has to be ahead of the base with one.
const BEHIND: f64 = 0.06;
const AHEAD: f64 = 0.08;
/// Error of the base on the unfiltered record over that record's floor.
const EXPLAINED: f64 = 1.15;
/// Correlation of one point's noise with the next on the unfiltered record below which that record never had the filter:
/// undoing one of the least pole makes -0.28 of white noise, of a long one -0.5; noise that had it becomes white.
const OVERDONE: f64 = -0.2;

/// A filter that was found.
#[derive(Debug)]
pub(crate) struct Filtered {
    /// Base and filter, as PV sees them.
    pub fit: Fit,
    /// Time constant of the filter, s.
    pub lag_s: f64,
    /// Standard deviation of the noise behind the filter, PV units.
    pub noise_sd: f64,
}

impl Filtered {
    /// Its size.
    #[must_use]
    pub(crate) fn parameters(&self) -> Vec<Parameter> {
        vec![Parameter { name: "lag", value: self.lag_s, unit: "s" }]
    }
}

/// Looks for a filter; `None` where what is left has no such memory, where a recorder made PV, or where lag and colour do
/// not agree.
pub(crate) fn look(
    record: &Record,
    problem: &Problem,
    found: &Found,
    traces: &Traces,
    floor: Option<f64>,
    work: &mut Work<'_>,
) -> Option<Filtered> {
    let law = found.base.structure.law?;
    if traces.signatures.iter().any(|s| s.met) {
        return None;
    }
    // White noise at the floor behind any model speaks against a filter.
    let all = || core::iter::once(&found.base).chain(&found.searches);
    if all().any(|search| schedule::is_calm(problem, search, floor)) {
        return None;
    }
    let left: Vec<Left> = all().filter_map(|search| Left::by(problem, search)).collect();
    let of_base = left.first()?.one_step;
    let best = left.iter().map(|l| l.one_step).fold(f64::INFINITY, f64::min);
    for pole in candidates(problem, found, &left) {
        if work.stopped {
            return None;
        }
        let undone = Undone::new(record, problem, traces, pole);
        let search = undone.search(law, work)?;
        let made = undone.filtered(problem, &search)?;
        let agrees = made.one_step <= best + BEHIND && made.one_step <= of_base - AHEAD;
        if agrees && made.over_floor <= EXPLAINED && made.r1 >= OVERDONE {
            return Some(made.filtered);
        }
    }
    None
}

/// Poles to try: that of what the best models leave, where it is of first order, and those of the second lag's fit.
fn candidates(problem: &Problem, found: &Found, left: &[Left]) -> Vec<f64> {
    let mut by_error: Vec<&Left> = left.iter().filter(|l| l.is_first).collect();
    by_error.sort_by(|a, b| a.one_step.total_cmp(&b.one_step));
    let of_noise = by_error.first().map(|l| l.pole);
    let lag = found.searches.iter().find(|l| l.structure.id() == super::effects::extra_lag::EFFECT.id);
    let lags = lag.and_then(|search| {
        let best = search.best.first()?;
        Some(search.structure.plan(&best.theta).time_constants(best.theta.log_tau))
    });
    let of_lags = lags.unwrap_or_default().map(|tau| libm::exp(-1.0 / tau.max(1e-3)));
    let mut out: Vec<f64> = Vec::new();
    for pole in of_noise.into_iter().chain(of_lags).filter(|p| (POLES[0]..POLES[1]).contains(p)) {
        let near = |other: &f64| (libm::log(*other) / libm::log(pole) - 1.0).abs() < APART;
        if !out.iter().any(near) && problem.n() as f64 * (1.0 - pole) > LENGTHS {
            out.push(pole);
        }
    }
    out.truncate(TRIED);
    out
}

/// What a search's best model leaves, one step ahead.
struct Left {
    /// Log mean squared error of an autoregression, PV units squared.
    one_step: f64,
    /// Pole of one of first order.
    pole: f64,
    /// Whether that is nearly as good: what swings or answers moves is of higher order than a filter's noise.
    is_first: bool,
}

impl Left {
    fn by(problem: &Problem, search: &Search) -> Option<Self> {
        let left = residual_of(problem, search)?;
        let log = |mse: f64| libm::log(mse.max(1e-300)) + 2.0 * libm::log(problem.normalised.deviation);
        let (high, first, pole) = noise::memory(&left, &problem.train)?;
        Some(Self { one_step: log(high), pole, is_first: log(first) - log(high) < FIRST_ORDER })
    }
}

/// A record whose PV was unfiltered.
struct Undone {
    problem: Problem,
    floor: Option<f64>,
    pole: f64,
}

/// Base and filter on a record.
struct Made {
    filtered: Filtered,
    one_step: f64,
    over_floor: f64,
    /// Autocorrelation at lag 1 of what the base leaves of the unfiltered record.
    r1: f64,
}

impl Undone {
    fn new(record: &Record, problem: &Problem, traces: &Traces, pole: f64) -> Self {
        let mut pv = record.pv.clone();
        for (now, pair) in pv.iter_mut().skip(1).zip(record.pv.windows(2)) {
            *now = (pair[1] - pole * pair[0]) / (1.0 - pole);
        }
        let floor = noise::floor(&pv, &traces.measured, false).noise_floor;
        let record = Record { pv, mv: None, ..record.clone() };
        let mut problem = Problem::new(&record, Some(problem.period), 1, traces.masked.clone());
        // The first value was not unfiltered.
        problem.blocks.from = problem.blocks.from.max(1);
        Self { problem, floor, pole }
    }

    fn search(&self, law: Law, work: &mut Work<'_>) -> Option<Search> {
        schedule::base(&self.problem, Some(law), self.floor, work).map(|(search, _)| search)
    }

    /// The unfiltered record's base behind the filter.
    fn filtered(&self, problem: &Problem, search: &Search) -> Option<Made> {
        let floor = self.floor?;
        let a = self.pole;
        let base = fit(&self.problem, search, self.floor, &|_| {})?;
        let from = problem.blocks.from.max(self.problem.blocks.from);
        let pv: Vec<f64> = problem.normalised.pv.iter().map(|y| problem.pv_of(*y)).collect();
        let mut prediction = base.prediction.clone();
        let mut before = prediction.get(from)?.to_owned();
        for p in &mut prediction[from..] {
            before = a * before + (1.0 - a) * *p;
            *p = before;
        }
        add_memory(problem, &pv, &mut prediction, from, a);
        let residual: Vec<f64> = pv.iter().zip(&prediction).map(|(y, p)| y - p).collect();
        let one_step = noise::mean_square(&noise::innovations(&residual, &problem.train, &[1.0, -a]));
        let noise_sd = floor * ((1.0 - a) / (1.0 + a)).sqrt();
        let lag_s = -problem.point_s / libm::log(a);
        let over_floor = base.rmse_train / floor;
        let (_, _, r1) = noise::memory(&residual_of(&self.problem, search)?, &self.problem.train)?;
        let mut model = base.model.clone();
        model.process.time_constants_s = with_lag(&base.model.process.time_constants_s, lag_s);
        let id = super::effects::sensor_filter::EFFECT.id.to_owned();
        let fit = Fit {
            parameters: base.parameters + 1,
            evaluations: base.evaluations,
            at_floor: base.at_floor,
            ..Fit::of_run(problem, id, model, prediction, base.valve, Some(noise_sd))
        };
        let one_step = libm::log(one_step.max(1e-300));
        Some(Made { filtered: Filtered { fit, lag_s, noise_sd }, one_step, over_floor, r1 })
    }
}

/// Both time constants, largest first, as far apart as the simulator wants them.
fn with_lag(own: &[f64], lag_s: f64) -> Vec<f64> {
    let Some(tau) = own.first().copied() else { return vec![lag_s] };
    let (a, b) = separated(tau, lag_s);
    vec![a.max(b), a.min(b)]
}

/// What the filter held when the record began, fitted to the training points.
fn add_memory(problem: &Problem, pv: &[f64], prediction: &mut [f64], from: usize, a: f64) {
    let decay: Vec<f64> = (0..pv.len()).map(|k| libm::exp(libm::log(a) * k.saturating_sub(from) as f64)).collect();
    let points: Vec<usize> = problem.train.iter().flat_map(|[b, e]| *b..*e).filter(|k| *k >= from).collect();
    let at = |of: &dyn Fn(usize) -> f64| points.iter().map(|k| of(*k)).collect::<Vec<f64>>();
    let (left, column) = (at(&|k| pv[k] - prediction[k]), at(&|k| decay[k]));
    let size = solve(&[column], &left, &vec![1.0; left.len()]).map_or(0.0, |found| found[0]);
    prediction.iter_mut().zip(&decay).skip(from).for_each(|(p, d)| *p += size * d);
}

#[cfg(test)]
mod tests {
    use super::super::effects::sensor_filter::EFFECT;
    use super::super::{GapOptions, Serial, diagnose};
    use super::*;
    use crate::core::sim::noise::Noise;
    use crate::core::sim::process::{ProcessModel, ProcessState};
    use crate::core::sim::valve::he_step;

    /// A sticking valve, a process, and a lag of 9 samples through which the noise goes too, or not.
    fn record(is_filter: bool) -> Record {
        let turn = |k: usize, period: f64| libm::sin(2.0 * core::f64::consts::PI * k as f64 / period);
        let op: Vec<f64> = (0..900).map(|k| 50.0 + 4.0 * turn(k, 70.0) + 2.0 * turn(k, 431.0)).collect();
        let model = ProcessModel { gain: 2.0, tau: 5.0, tau2: 0.0, dead_time: 2.5, integrating: false };
        let (mut process, mut noise, mut stem) = (ProcessState::at_rest(model, 0.0), Noise::new(4, 1), 50.0);
        let (mut filtered, share, mut pv) = (0.0, 1.0 - libm::exp(-1.0 / 9.0), Vec::new());
        for u in &op {
            let (y, e) = (process.step(stem - 50.0, 0.0), 0.3 * noise.gaussian());
            filtered += share * (y + if is_filter { e } else { 0.0 } - filtered);
            pv.push(120.0 + filtered + if is_filter { 0.0 } else { 0.2 * e });
            stem = he_step(stem, *u, 3.0, 1.0);
        }
        Record::uniform(2.0, op, pv)
    }

    #[test]
    fn a_lag_that_its_noise_shares_is_a_filter() {
        let found = diagnose(&record(true), &GapOptions::default(), &Serial).unwrap();
        assert_eq!(found.cause.id, EFFECT.id);
        let lag = found.named().unwrap().parameters["lag"].value;
        assert!((lag / 18.0 - 1.0).abs() < 0.25, "{lag}");
        let white = diagnose(&record(false), &GapOptions::default(), &Serial).unwrap();
        assert_ne!(white.cause.id, EFFECT.id);
    }

    #[test]
    fn undoing_a_filter_that_was_none_leaves_noise_that_swings_from_point_to_point() {
        let of = |is_filter: bool| {
            let record = record(is_filter);
            let problem = Problem::new(&record, Some(70.0), 1, vec![false; record.len()]);
            let traces = super::super::signatures::traces(&record, 70.0, &[]);
            let pole = libm::exp(-1.0 / 9.0);
            let undone = Undone::new(&record, &problem, &traces, pole);
            let mut work = Work {
                executor: &Serial,
                budget: 100_000,
                done: 0,
                stopped: false,
                spent: false,
                seed: 1,
                asked: None,
            };
            let search = undone.search(Law::He, &mut work).unwrap();
            undone.filtered(&problem, &search).unwrap().r1
        };
        let (filter, white) = (of(true), of(false));
        assert!(filter > OVERDONE && white < OVERDONE, "{filter} {white}");
    }
}
