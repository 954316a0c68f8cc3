//! The record as the budget sees it: PV standardised, at most some nine hundred points, and what drives it.

use std::sync::Arc;

use super::Known;
use crate::core::gap::neighbour::Load;
use crate::core::gap::noise::arx::{Design, LONGEST_LAG, START};
use crate::core::gap::problem::period_of;
use crate::core::gap::set_point::{self, Move};
use crate::core::gap::types::Fit;
use crate::core::record::Record;
use crate::core::signal::{detrend, stats};

/// Most points.
pub(crate) const MOST: usize = 900;
/// Fewest points that are split.
pub(crate) const FEWEST: usize = 100;
/// Fewest points in a period.
const IN_PERIOD: f64 = 8.0;
/// Periods in which PV answers the set point where no model says it.
const ANSWER: f64 = 0.125;
/// Periods that a record has at least, as the bins of the process' answer take them.
const PERIODS: f64 = 5.0;

/// The last part of a record that fits into `MOST` points.
#[derive(Debug, Clone, PartialEq)]
pub struct Series {
    /// PV, less its mean, in standard deviations.
    pub pv: Vec<f64>,
    /// OP, less its mean, in standard deviations.
    pub op: Vec<f64>,
    /// Free runs of the models that are known.
    pub runs: Vec<Run>,
    /// Mean and standard deviation of PV, PV units.
    pub of_pv: [f64; 2],
    /// Standard deviation of OP, OP units.
    pub op_deviation: f64,
    /// Period of the oscillation or of the typical movement, points.
    pub period: f64,
    /// Points of the record in one point.
    pub box_points: usize,
    /// First point of the record that is used.
    pub from: usize,
    /// Time between points, s.
    pub point_s: f64,
    /// Signals of other loops that may act on PV.
    pub loads: Vec<Arc<Load>>,
    /// Moves of the set point, points and standard deviations of PV.
    pub sp_moves: Vec<Move>,
    /// Points in which PV answers one.
    pub answer: f64,
}

/// A model's free run over a series.
#[derive(Debug, Clone, PartialEq)]
pub struct Run {
    /// `base`, or the id of the effect that the model has beside it.
    pub id: String,
    /// PV less its mean, in the series' units.
    pub pv: Vec<f64>,
    /// The stem, in the units of `op`; `None` without friction, or where the stem rests.
    pub stem: Option<Vec<f64>>,
    /// What PV gains with OP at rest, standard deviations of one over those of the other; `None` for an integrator.
    pub gain: Option<f64>,
    /// Free parameters of its model.
    pub parameters: usize,
}

impl Series {
    /// The series of a record; `None` where it is too short, or OP or PV does not move.
    #[must_use]
    pub(crate) fn of(record: &Record, known: &Known<'_>) -> Option<Self> {
        let n = record.len();
        if n < FEWEST {
            return None;
        }
        let period = known.period.filter(|p| p.is_finite() && *p > 0.0).unwrap_or_else(|| period_of(record).0);
        let fine = ((period / IN_PERIOD) as usize).max(1);
        let box_points = n.div_ceil(MOST).min(fine);
        let before = known.from.saturating_sub((START - LONGEST_LAG) * box_points).min(n);
        let count = ((n - before) / box_points).min(MOST);
        let from = n - count * box_points;
        let boxed = |x: &[f64]| detrend::box_means(&x[from..], box_points);
        let (pv, op) = (boxed(&record.pv), boxed(&record.op()));
        let [of_pv, of_op] = [&pv, &op].map(|x| [stats::mean(x), stats::std_dev(x)]);
        if count < FEWEST || ![of_pv, of_op].iter().flatten().all(|v| v.is_finite()) {
            return None;
        }
        if !of_pv[1].is_normal() || !of_op[1].is_normal() {
            return None;
        }
        let scaled = |x: &[f64], mean: f64, by: f64| -> Vec<f64> { x.iter().map(|v| (v - mean) / by).collect() };
        let centred = |x: &[f64], by: f64| {
            let x = boxed(x);
            scaled(&x, stats::mean(&x), by)
        };
        let run = |fit: &Fit| Run {
            id: fit.id.clone(),
            pv: centred(&fit.prediction, of_pv[1]),
            stem: (fit.model.valve.fs > 0.0)
                .then(|| centred(&fit.valve, of_op[1]))
                .filter(|s| stats::std_dev(s) > 1e-6),
            gain: (!fit.model.process.integrating).then_some(fit.model.process.gain * of_op[1] / of_pv[1]),
            parameters: fit.parameters,
        };
        let runs: Vec<Run> = known.models.iter().map(run).collect();
        let series = Self {
            pv: scaled(&pv, of_pv[0], of_pv[1]),
            op: scaled(&op, of_op[0], of_op[1]),
            runs,
            of_pv,
            op_deviation: of_op[1],
            period: (period / box_points as f64).min(count as f64 / PERIODS).max(IN_PERIOD),
            box_points,
            from,
            point_s: record.point_s() * box_points as f64,
            loads: Vec::new(),
            sp_moves: set_point::moves(record)
                .into_iter()
                .filter(|m| m.at >= from)
                .map(|m| Move { at: (m.at - from) / box_points, size: m.size / of_pv[1] })
                .collect(),
            answer: known.models.first().map_or(period * ANSWER / box_points as f64, |fit| {
                let point_s = record.point_s() * box_points as f64;
                set_point::answer_points(&fit.model.process, point_s)
            }),
        };
        Some(series.with_loads(known.loads))
    }

    /// The same with loads that are given at the record's points; those that rest in the series are left out.
    fn with_loads(mut self, loads: &[Load]) -> Self {
        let boxed = |load: &Load| {
            let values = detrend::box_means(load.values.get(self.from..)?, self.box_points);
            let own = Load::new(&load.name, load.from_op, values.get(..self.n())?, load.p_value);
            let deviation = own.deviation * load.deviation;
            deviation.is_normal().then(|| Arc::new(Load { deviation, ..own }))
        };
        self.loads = loads.iter().filter_map(boxed).collect();
        self
    }

    /// The noise model's design of PV driven by a signal in standard deviations, or by nothing.
    #[must_use]
    pub(crate) fn driven_by(&self, u: Option<&[f64]>) -> Design {
        Design::new(&self.pv, u, self.period)
    }

    /// Number of points.
    #[must_use]
    pub fn n(&self) -> usize {
        self.pv.len()
    }

    /// Time of a point after the record's start, s.
    #[must_use]
    pub fn time_s(&self, point: usize) -> f64 {
        self.from as f64 * self.point_s / self.box_points as f64 + point as f64 * self.point_s
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_long_record_is_boxed_and_a_short_or_still_one_refused() {
        let wave = |k: usize| libm::sin(k as f64 * 0.05);
        let record =
            |n: usize| Record::uniform(2.0, (0..n).map(wave).collect(), (0..n).map(|k| 3.0 + wave(k + 9)).collect());
        let series = Series::of(&record(2_001), &Known::default()).unwrap();
        assert_eq!((series.n(), series.box_points, series.from, series.point_s), (667, 3, 0, 6.0));
        assert!((stats::std_dev(&series.pv) - 1.0).abs() < 1e-9 && (series.of_pv[0] - 3.0).abs() < 0.05);
        assert!((series.period - 41.9).abs() < 1.0);
        assert_eq!(Series::of(&record(FEWEST - 1), &Known::default()), None);
        assert_eq!(Series::of(&Record::uniform(1.0, vec![1.0; 300], record(300).pv), &Known::default()), None);
        // Boxes must not be wider than an eighth of the period: the record's end is used.
        let fast = Series::of(&record(4_000), &Known { period: Some(17.0), ..Known::default() }).unwrap();
        assert_eq!((fast.box_points, fast.n(), fast.time_s(0)), (2, 900, 2.0 * 2_200.0));
    }
}
