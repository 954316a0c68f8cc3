//! How well a model from elsewhere follows a record, as it is.

use super::diagnosis::check;
use super::given;
use super::model::Model;
use super::problem::Problem;
use super::types::{GapError, GapOptions};
use crate::core::record::Record;
use crate::core::signal::stats;

/// A given model's free run over a record.
#[derive(Debug, Clone, PartialEq)]
pub struct Score {
    /// Mean squared error, PV units squared, from the first point that counts on.
    pub mse: f64,
    /// 100 (1 - rms error / std PV): 100 is perfect, 0 no better than the mean.
    pub fit_pct: f64,
    /// The free run, PV units; `None` where the valve's past has a say.
    pub prediction: Vec<Option<f64>>,
}

/// Runs a model freely over a record. Only what the record must supply is fitted: the stem's and the process' state
/// before it, and PV's level.
///
/// # Errors
/// Where the record is too short, a signal never moves, or the model cannot be simulated.
pub fn score(record: &Record, model: &Model, options: &GapOptions) -> Result<Score, GapError> {
    check(record, options)?;
    let problem = Problem::new(record, options.period_points, options.seed, vec![false; record.len()]);
    let fit = given::simulate(&problem, model, None)?;
    let from = problem.blocks.from.min(record.len());
    let errors: Vec<f64> =
        record.pv[from..].iter().zip(&fit.prediction[from..]).map(|(y, p)| (y - p) * (y - p)).collect();
    let mse = stats::mean(&errors);
    let prediction = fit.prediction.iter().enumerate().map(|(k, p)| (k >= from).then_some(*p)).collect();
    Ok(Score { mse, fit_pct: 100.0 * (1.0 - mse.sqrt() / stats::std_dev(&record.pv)), prediction })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::gap::model::{Process, SCHEMA, Valve};
    use crate::core::sim::noise::Noise;
    use crate::core::sim::process::{ProcessModel, ProcessState};
    use crate::core::sim::valve::he_step;

    #[test]
    fn the_model_that_made_a_record_follows_it_and_another_does_not() {
        let (n, ts_s) = (900, 2.0);
        let turn = |k: usize, period: f64| libm::sin(2.0 * core::f64::consts::PI * k as f64 / period);
        let op: Vec<f64> = (0..n).map(|k| 50.0 + 4.0 * turn(k, 70.0) + 2.0 * turn(k, 431.0)).collect();
        let made = ProcessModel { gain: 2.0, tau: 6.0, tau2: 0.0, dead_time: 2.5, integrating: false };
        let (mut process, mut noise, mut stem) = (ProcessState::at_rest(made, 0.0), Noise::new(4, 1), 50.0);
        let mut pv = Vec::new();
        for u in &op {
            // PV is measured before the valve answers this scan's OP.
            pv.push(120.0 + process.step(stem - 50.0, 0.0) + 0.02 * noise.gaussian());
            stem = he_step(stem, *u, 1.5, 0.5);
        }
        let record = Record::uniform(ts_s, op, pv);
        let process = Process {
            gain: 2.0,
            time_constants_s: vec![6.0 * ts_s],
            dead_time_s: 2.5 * ts_s,
            integrating: false,
            op: 50.0,
            pv: 120.0,
        };
        let valve = Valve { law: "he".to_owned(), fs: 1.5, fd: 0.5, stem0: None };
        let right = Model { schema: SCHEMA.to_owned(), ts_s, valve, process, effects: Vec::new() };
        let candidate = score(&record, &right, &GapOptions::default()).unwrap();
        assert!(candidate.fit_pct > 99.0 && candidate.mse.sqrt() < 0.03, "{} {}", candidate.fit_pct, candidate.mse);
        let mut wrong = right.clone();
        wrong.process.gain = 1.0;
        wrong.valve.fs = 3.0;
        assert!(score(&record, &wrong, &GapOptions::default()).unwrap().fit_pct < 70.0);
        wrong.valve.law = "kano".to_owned();
        assert!(score(&record, &wrong, &GapOptions::default()).is_err());
    }
}
