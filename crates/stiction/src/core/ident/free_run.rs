//! Runs a model from elsewhere freely over a record: how well it predicts data that it was not fitted to.
//!
//! Valve and process stay fixed. Only quantities that no earlier record can determine are fitted: the level (for an integrating
//! process its drift as well), the process's initial state, and the initial stem position.

use super::choice::Options;
use super::class::{Class, Limits, Shape};
use super::least_squares::Gram;
use super::model::Model;
use super::no_fit::LEAST_POINTS;
use super::normalised::{NormalisedRecord, Start};
use crate::core::record::Record;
use crate::core::signal::stats;
use crate::core::sim::slips::Law;

/// Most first slips tried in either direction.
const STARTS: usize = 256;

/// Result of a free run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FreeRun {
    /// Root mean squared error over the counted points, PV units.
    pub rmse: f64,
    /// A stem position, OP units, at which the process rests at `rest_pv`.
    pub rest_op: f64,
    /// PV there, PV units.
    pub rest_pv: f64,
}

/// The best free run of `model` over `record`; points up to `after_ns` are simulated and do not count.
///
/// `None` if a signal is constant, a parameter of the model is unusable, its class is unknown, or fewer than 30 points count.
#[must_use]
pub fn free_run(record: &Record, model: &Model, after_ns: i64) -> Option<FreeRun> {
    let normalised = NormalisedRecord::of(record, &Options::default()).ok()?;
    let NormalisedRecord { span, deviation, .. } = normalised;
    let (class, shape) = shaped(model, record, &normalised)?;
    let counted_ns = after_ns.saturating_sub(record.start_ns).max(0);
    let new = ((counted_ns as f64 * 1e-9 / record.point_s()).floor() as usize).saturating_add(1);
    let new = if counted_ns == 0 { 0 } else { new };
    let from = normalised.from.max(class.lag(&shape).ceil() as usize + 1).max(new);
    let point_gain = if model.integrating { model.gain * record.point_s() } else { model.gain };
    let coefficient = point_gain * span / deviation / class.gain(1.0);
    if from + LEAST_POINTS > record.len() || !coefficient.is_finite() {
        return None;
    }
    let run = Run { normalised: &normalised, class, shape, coefficient, from };
    let found = run.best(model.law, model.fs / span, model.fd / span)?;
    let rest = if class.integrates() { -found.drift / class.gain(coefficient) } else { found.stem };
    let level = if class.integrates() { 0.0 } else { found.level + coefficient * found.stem };
    Some(FreeRun {
        rmse: deviation * found.rmse,
        rest_op: stats::mean(&record.op_path) + span * rest,
        rest_pv: stats::mean(&record.pv) + deviation * level,
    })
}

/// The model's class and shape, in points.
fn shaped(model: &Model, record: &Record, normalised: &NormalisedRecord) -> Option<(Class, Shape)> {
    let class = model.class()?;
    let shape = class.shape(model.taus(record), model.lag(record));
    let limits = Limits { tau: normalised.limits.tau, lag: [0.0, 0.5 * record.len() as f64] };
    shape.iter().all(|s| s.is_finite()).then(|| (class, class.clamp(shape, &limits)))
}

struct Run<'a> {
    normalised: &'a NormalisedRecord,
    class: Class,
    shape: Shape,
    coefficient: f64,
    from: usize,
}

/// The best start, in deviations of PV and spans of OP.
#[derive(Clone, Copy)]
struct Found {
    rmse: f64,
    level: f64,
    drift: f64,
    stem: f64,
}

impl Run<'_> {
    fn best(&self, law: Law, fs: f64, fd: f64) -> Option<Found> {
        let stems: Vec<Vec<f64>> = if fs == 0.0 {
            vec![self.normalised.mean.clone()]
        } else {
            let starts = self.starts(fs);
            let normalised = self.normalised;
            let stem = |start| normalised.path.stem(law, [fs + fd, fs - fd], fd, normalised.first_slip(start)).0;
            starts.into_iter().map(stem).collect()
        };
        let found = stems.iter().map(|stem| self.levelled(stem, &self.class.respond(&self.shape, stem)));
        found.filter(|b| b.rmse.is_finite()).min_by(|a, b| a.rmse.total_cmp(&b.rmse))
    }

    /// Every possible first slip of a stem within the band: each running extreme of OP up to two bands away.
    fn starts(&self, fs: f64) -> Vec<Start> {
        let mut starts = Vec::new();
        for (list, up) in self.normalised.extremes.iter().zip([true, false]) {
            let near = |r: &&f64| (**r - list[0]).abs() <= 2.0 * fs;
            let count = list.iter().take_while(near).count();
            let every = count.div_ceil(STARTS).max(1);
            starts.extend((0..count.min(list.len())).step_by(every).map(|extreme| Start { up, extreme, place: 0.5 }));
        }
        starts
    }

    /// Fits level, drift and memory to the residual; the error that remains.
    fn levelled(&self, stem: &[f64], response: &[f64]) -> Found {
        let n = stem.len() - self.from;
        let left = self.normalised.pv.iter().zip(response).skip(self.from);
        let left: Vec<f64> = left.map(|(pv, r)| pv - self.coefficient * r).collect();
        let count = self.class.memory_len();
        let mut columns = vec![Vec::new(); count];
        for (index, column) in columns.iter_mut().enumerate() {
            self.class.memory(&self.shape, index, self.from, n, 0.0, column);
            // A memory that has decayed ends early.
            column.resize(n, 0.0);
        }
        let mut views: Vec<&[f64]> = columns.iter().map(Vec::as_slice).collect();
        views.push(&left);
        let mut gram = Gram::of(&views);
        gram.eliminate(count);
        let x = gram.back(count, &[]);
        let slope = if n > 1 && self.class.integrates() { columns[1][1] - columns[1][0] } else { 0.0 };
        Found {
            rmse: (gram.at(count, count).max(0.0) / n as f64).sqrt(),
            level: x[0],
            drift: x[1] * slope,
            stem: stats::mean(&stem[self.from..]),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::sim::closed_loop::{ClosedLoop, LoopModel, ValveLaw, ValveModel};
    use crate::core::sim::controller::{Action, PidSettings};
    use crate::core::sim::process::ProcessModel;

    const NOISE: f64 = 0.05;

    fn plant(fs: f64, fd: f64, tau: f64, integrating: bool) -> ClosedLoop {
        let gain = if integrating { 0.02 } else { 2.0 };
        let (kc, ti_s) = if integrating { (0.8, 150.0) } else { (0.8, 8.0) };
        let model = LoopModel {
            ts_s: 2.0,
            process: ProcessModel { gain, tau, tau2: 0.0, dead_time: 3.5, integrating },
            rest_op: 50.0,
            rest_pv: 60.0,
            controller: PidSettings {
                kc,
                ti_s: 2.0 * ti_s,
                td_s: 0.0,
                action: Action::Reverse,
                op_min: 0.0,
                op_max: 100.0,
                op_resolution: 0.0,
            },
            valve: ValveModel { law: ValveLaw::He, fs, fd, ..ValveModel::HEALTHY },
            pv_noise_sd: NOISE,
            load: vec![],
            pv_disturbance: vec![],
        };
        ClosedLoop::new(model, 0.0, 60.0, 7)
    }

    fn truth(fs: f64, fd: f64) -> Model {
        let (gain, dead_time_s) = (2.0, 7.0);
        Model { law: Law::He, fs, fd, gain, time_constants_s: vec![40.0], dead_time_s, integrating: false }
    }

    #[test]
    fn the_true_model_leaves_the_noise_and_a_valve_that_sticks_more_does_not() {
        let mut plant = plant(5.0, 3.0, 20.0, false);
        let _ = plant.record(700, 61.0);
        let mut record = plant.record(900, 60.5);
        let run = free_run(&record, &truth(5.0, 3.0), 0).unwrap();
        assert!((run.rmse / NOISE - 1.0).abs() < 0.15, "{run:?}");
        // PV rests at 60 with the valve at 50.
        assert!((run.rest_pv - 60.0 - 2.0 * (run.rest_op - 50.0)).abs() < 0.05, "{run:?}");
        let other = free_run(&record, &truth(7.0, 4.0), 0).unwrap();
        assert!(other.rmse > 5.0 * NOISE, "{other:?}");
        record.pv.iter_mut().for_each(|pv| *pv += 30.0);
        let shifted = free_run(&record, &truth(5.0, 3.0), 0).unwrap();
        assert!((shifted.rmse - run.rmse).abs() < 1e-5 && (shifted.rest_pv - run.rest_pv - 30.0).abs() < 1e-3);
    }

    #[test]
    fn only_what_comes_after_counts() {
        let mut record = plant(5.0, 3.0, 20.0, false).record(1200, 61.0);
        record.pv[..500].iter_mut().enumerate().for_each(|(k, pv)| *pv += f64::from(u8::from(k % 9 < 4)));
        let whole = free_run(&record, &truth(5.0, 3.0), 0).unwrap();
        let later = free_run(&record, &truth(5.0, 3.0), 1_000_000_000_000).unwrap();
        assert!(whole.rmse > 4.0 * NOISE && later.rmse < 1.2 * NOISE, "{whole:?} {later:?}");
        assert_eq!(free_run(&record, &truth(5.0, 3.0), record.end_ns), None);
    }

    #[test]
    fn an_integrating_process_rests_where_its_level_holds() {
        let record = plant(3.0, 1.0, 0.0, true).record(1500, 61.0);
        let model = Model { gain: 0.01, time_constants_s: vec![], integrating: true, ..truth(3.0, 1.0) };
        let run = free_run(&record, &model, 0).unwrap();
        assert!(run.rmse < 1.3 * NOISE && (run.rest_op - 50.0).abs() < 0.2, "{run:?}");
    }

    #[test]
    fn what_cannot_be_run_is_not() {
        let record = plant(5.0, 3.0, 20.0, false).record(300, 61.0);
        let wrong = |model: Model| assert_eq!(free_run(&record, &model, 0), None, "{model:?}");
        wrong(Model { time_constants_s: vec![], ..truth(5.0, 3.0) });
        wrong(Model { time_constants_s: vec![-1.0], ..truth(5.0, 3.0) });
        wrong(Model { gain: f64::NAN, ..truth(5.0, 3.0) });
        wrong(Model { dead_time_s: f64::INFINITY, ..truth(5.0, 3.0) });
        let still = Record::uniform(1.0, vec![1.0; 300], vec![1.0; 300]);
        assert_eq!(free_run(&still, &truth(5.0, 3.0), 0), None);
    }
}
