//! Noise and process fitted together to a series in boxes, with and without a cycle in the noise.

use core::f64::consts::TAU;

use super::kernel::{CorrelatedNoise, Factors, Kernel, StochasticCycle};
use super::simplex::minimum;
use crate::core::gap::budget::arx::solve;
use crate::core::gap::budget::search::Searched;
use crate::core::gap::budget::series::{START, Series};
use crate::core::gap::budget::shapes::Shape;
use crate::core::signal::{detrend, stats};
use crate::core::sim::process::Pole;

/// Points of a period that are enough, most points, and fewest points of a period where there would be more.
const IN_PERIOD: f64 = 24.0;
const MOST: usize = 500;
const FEWEST_IN_PERIOD: f64 = 12.0;
/// Variance, PV's being 1, beyond which a free run tells nothing of PV.
const FAR: f64 = 100.0;
/// Time constants and dead times, periods, from which a process is fitted.
const PROCESSES: [[f64; 2]; 3] = [[0.1, 0.1], [0.4, 0.1], [0.2, 0.3]];
/// Periods that are tried for a cycle; the shortest, boxes, and the longest, a part of the record; coherences, periods; and
/// the cycle's part of the correlated variance.
pub(super) const PERIODS: usize = 24;
const SHORTEST: f64 = 5.0;
const LONGEST: f64 = 1.0 / 3.0;
const COHERENCES: [f64; 2] = [2.0, 6.0];
const PARTS: [f64; 2] = [0.1, 0.5];
/// Places that are fitted, and the ratio of periods from which two of them are apart.
const FOLLOWED: usize = 3;
const APART: f64 = 1.28;
/// Evaluations of a first fit and of one that is kept.
const ROUGH: usize = 200;
const KEPT: usize = 400;
/// What one unit outside the bounds costs, nats.
const OUTSIDE: f64 = 20.0;

/// What may drive PV.
#[derive(Debug, Clone)]
pub(super) enum Driver {
    Nothing,
    /// A free run as it is.
    Run(Vec<f64>),
    /// OP or a stem, behind a first-order lag and a dead time.
    Lagged(Vec<f64>),
}

/// What is searched, as logarithms: lag and dead time; the white variance; variance and decay of two correlated parts; and
/// variance, period and coherence (periods) of a cycle. Times in boxes, PV's variance 1.
pub(super) type Point = Vec<f64>;
const LAG: usize = 0;
const DEAD_TIME: usize = 1;
const WHITE: usize = 2;
const CORRELATED: [usize; 2] = [3, 5];
const CYCLE: usize = 7;
/// First steps of the search along each.
const STEPS: [f64; 10] = [0.4, 0.4, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.15, 0.5];

/// The noise that a point stands for.
pub(super) fn kernel(x: &[f64]) -> Kernel {
    let correlated =
        |variance: f64, decay: f64| CorrelatedNoise { variance: libm::exp(variance), decay: libm::exp(decay) };
    let cycle = |x: &[f64]| StochasticCycle { envelope: correlated(x[0], x[1] + x[2]), period: libm::exp(x[1]) };
    Kernel {
        white: libm::exp(x[WHITE]),
        correlated: CORRELATED.map(|at| correlated(x[at], x[at + 1])),
        cycle: x.get(CYCLE..CYCLE + 3).map(cycle),
    }
}

/// A noise and a process, fitted.
pub(super) struct Fitted {
    /// Less what the process' parameters cost.
    pub log_likelihood: f64,
    pub factors: Factors,
    /// Innovations, in standard deviations of each.
    pub innovations: Vec<f64>,
    /// Level, process and what was before the record, each with its coefficient.
    columns: Vec<Vec<f64>>,
    coefficients: Vec<f64>,
}

impl Fitted {
    /// What level and process make of the driver.
    pub(super) fn run(&self) -> Vec<f64> {
        let mut out = vec![0.0; self.innovations.len()];
        for (column, c) in self.columns.iter().zip(&self.coefficients) {
            out.iter_mut().zip(column).for_each(|(out, x)| *out += c * x);
        }
        out
    }
}

/// The best fit without a cycle by one driver.
pub(super) struct Without {
    pub at: Point,
    pub log_likelihood: f64,
    pub driver: Driver,
}

/// PV in boxes, each as coarse as the loop's period allows.
pub(super) struct Boxed {
    /// PV less the effects that were found, but for sinusoids.
    pv: Vec<f64>,
    pub op: Vec<f64>,
    /// The loop's period, boxes.
    pub period: f64,
    /// Points in a box.
    pub points: usize,
    bounds: [Point; 2],
}

impl Boxed {
    /// The boxes of a series, and what may drive them.
    pub(super) fn of(series: &Series, searched: &Searched) -> (Self, Vec<Driver>) {
        let n = series.n() - START;
        let mut points = ((series.period / IN_PERIOD) as usize).max(1);
        while n / points > MOST && series.period / (points + 1) as f64 > FEWEST_IN_PERIOD {
            points += 1;
        }
        let is_kept = |k: &usize| !matches!(searched.added[*k].shape, Shape::Sinusoid(_));
        let effects = searched.sum(&(0..searched.added.len()).filter(is_kept).collect::<Vec<_>>());
        let without: Vec<f64> = match effects.len() {
            0 => series.pv.clone(),
            _ => series.pv.iter().zip(&effects).map(|(y, x)| y - x).collect(),
        };
        let boxed = |x: &[f64]| detrend::box_means(&x[START..], points);
        let op = boxed(&series.op);
        let mut drivers = vec![Driver::Lagged(op.clone())];
        for run in &series.runs {
            drivers.extend(run.stem.iter().map(|stem| Driver::Lagged(boxed(stem))));
            drivers.extend((stats::variance(&run.pv) < FAR).then(|| Driver::Run(boxed(&run.pv))));
        }
        let pv = boxed(&without);
        let (count, period) = (pv.len() as f64, series.period / points as f64);
        let log = |x: [f64; STEPS.len()]| x.map(libm::log).to_vec();
        let low = log([0.3, 1.0, 1e-5, 1e-5, 0.3, 1e-5, 0.3, 1e-5, 3.0, 0.3]);
        let high = log([3.0 * period, 0.8 * period + 2.1, 2.0, 4.0, count, 9.0, 10.0 * count, 6.0, count / 2.0, 40.0]);
        (Self { pv, op, period, points, bounds: [low, high] }, drivers)
    }

    /// Number of boxes.
    pub(super) fn n(&self) -> usize {
        self.pv.len()
    }

    fn columns(&self, x: &[f64], driver: &Driver) -> Vec<Vec<f64>> {
        let mut out = vec![vec![1.0; self.n()]];
        match driver {
            Driver::Nothing => {}
            Driver::Run(run) => out.push(run.clone()),
            Driver::Lagged(u) => {
                let [lag, delay] = [x[LAG], x[DEAD_TIME]].map(libm::exp);
                let mut run = Vec::new();
                let rest = u.first().copied().unwrap_or(0.0);
                Pole::lag(lag, delay - delay.floor()).run(delay.floor() as usize, u, rest, &mut run);
                out.push(run);
                // What was before the record.
                out.push((0..self.n()).map(|k| libm::exp(-(k as f64) / lag)).collect());
            }
        }
        out
    }

    /// The likelihood of a point, everything linear at its best; `None` where its noise is singular.
    pub(super) fn fitted(&self, x: &[f64], driver: &Driver) -> Option<Fitted> {
        let factors = kernel(x).factors(self.n())?;
        let columns = self.columns(x, driver);
        let whitened: Vec<Vec<f64>> = columns.iter().map(|column| factors.whitened(column)).collect();
        let mut innovations = factors.whitened(&self.pv);
        let coefficients = solve(&whitened, &innovations, &vec![1.0; self.n()])?;
        for (column, c) in whitened.iter().zip(&coefficients) {
            innovations.iter_mut().zip(column).for_each(|(e, x)| *e -= c * x);
        }
        let nats = |(e, variance): (&f64, &f64)| -0.5 * (e * e + libm::log(TAU * variance));
        let nats: f64 = innovations.iter().zip(&factors.variances).map(nats).sum();
        let cost = if matches!(driver, Driver::Lagged(_)) { libm::log(self.n() as f64) } else { 0.0 };
        Some(Fitted { log_likelihood: nats - cost, factors, innovations, columns, coefficients })
    }

    /// The best point of a search that begins at `from` and makes `most` evaluations, and its log likelihood.
    pub(super) fn fit(&self, from: &[f64], driver: &Driver, most: usize) -> (Point, f64) {
        let [low, high] = &self.bounds;
        let inside = |x: &[f64]| -> Point {
            x.iter().zip(low.iter().zip(high)).map(|(x, (low, high))| x.clamp(*low, *high)).collect()
        };
        let cost = |x: &[f64]| {
            let near = inside(x);
            let outside: f64 = x.iter().zip(&near).map(|(x, near)| (x - near).abs()).sum();
            let value = self.fitted(&near, driver).map_or(f64::INFINITY, |fitted| -fitted.log_likelihood);
            value + OUTSIDE * outside
        };
        let (x, value) = minimum(&inside(from), &STEPS[..from.len()], most, cost);
        (inside(&x), -value)
    }

    /// The best fit without a cycle by a driver.
    pub(super) fn without(&self, driver: Driver) -> Without {
        let starts = if matches!(driver, Driver::Lagged(_)) { &PROCESSES[..] } else { &PROCESSES[..1] };
        let start = |[lag, dead_time]: &[f64; 2]| -> Point {
            let all = [lag * self.period, dead_time * self.period + 1.0, 0.01, 0.05, 2.0, 0.1, self.period];
            all.map(libm::log).to_vec()
        };
        let rough = starts.iter().map(|s| self.fit(&start(s), &driver, ROUGH));
        let best = rough.max_by(|x, y| x.1.total_cmp(&y.1)).unwrap_or_default();
        let (at, log_likelihood) = self.fit(&best.0, &driver, KEPT);
        Without { at, log_likelihood, driver }
    }

    /// Places of a cycle beside a fit without, the most promising first and apart in period.
    pub(super) fn places(&self, without: &Without) -> Vec<Point> {
        let bare = &without.at;
        let variance: f64 = CORRELATED.iter().map(|at| libm::exp(bare[*at])).sum();
        let [low, high] = [SHORTEST, LONGEST * self.n() as f64].map(libm::log);
        let mut all = Vec::new();
        for k in 0..PERIODS {
            let period = low + (high - low) * k as f64 / (PERIODS - 1) as f64;
            for (coherence, part) in COHERENCES.iter().flat_map(|c| PARTS.iter().map(move |part| (*c, *part))) {
                let mut x = bare.clone();
                CORRELATED.iter().for_each(|at| x[*at] += libm::log(1.0 - part));
                x.extend([libm::log(part * variance.max(0.02)), period, libm::log(coherence)]);
                if let Some(fitted) = self.fitted(&x, &without.driver) {
                    all.push((fitted.log_likelihood, x));
                }
            }
        }
        all.sort_by(|x, y| y.0.total_cmp(&x.0));
        let mut out: Vec<Point> = Vec::new();
        for (_, x) in all {
            let is_new = out.iter().all(|other| (other[CYCLE + 1] - x[CYCLE + 1]).abs() > libm::log(APART));
            if is_new && out.len() < FOLLOWED {
                out.push(x);
            }
        }
        out
    }

    /// A fit without a cycle at another fit's cycle.
    pub(super) fn beside(without: &Without, with: &[f64]) -> Point {
        without.at.iter().chain(&with[CYCLE..]).copied().collect()
    }
}
