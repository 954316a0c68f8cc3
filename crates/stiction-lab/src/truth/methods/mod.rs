//! Published methods for detecting stiction, to compare with the shipped classifier: one file each.
//!
//! All methods get the preparation of the classifier's indicators: at most 80 points per period, smoothed over a sixteenth of
//! it. Each returns a statistic, larger for sticking valves, and the answer by the published thresholds; a method that does not
//! apply, or whose statistic is between its two thresholds, returns no answer.

mod cross_correlation;
mod curve_fit;
mod shape;
mod toolbox;

use stiction::core::detect::{View, oscillation};
use stiction::core::ident::sign;
use stiction::core::record::Record;

/// A record prepared for the methods.
#[derive(Debug)]
pub struct Case<'r> {
    record: &'r Record,
    view: View,
    integrating: bool,
    oscillates: bool,
    /// Signs of the process gain to try: the controller's if it can be identified, else both.
    signs: Vec<f64>,
}

impl<'r> Case<'r> {
    /// Prepares a record. The caller states whether the process integrates, because the methods leave that to their user.
    #[must_use]
    pub fn new(record: &'r Record, integrating: bool) -> Self {
        let op = record.op();
        let oscillates = oscillation::detect(&op, &record.pv).is_some_and(|found| found.oscillating);
        let sign = sign::of_gain_with_sp(&op, &record.pv, record.sp.as_deref());
        let signs = sign.map_or(vec![1.0, -1.0], |sign| vec![sign]);
        Self { record, view: View::new(record), integrating, oscillates, signs }
    }
}

/// A method's result for a record.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Answer {
    /// The statistic.
    pub statistic: Option<f64>,
    /// Whether the valve sticks by the published thresholds.
    pub sticks: Option<bool>,
}

impl Answer {
    /// Sticking from `sticks` up, not sticking below `healthy`, undecided in between.
    fn by_thresholds(statistic: Option<f64>, healthy: f64, sticks: f64) -> Self {
        let decide = |x: f64| (x >= sticks).then_some(true).or((x < healthy).then_some(false));
        Self { statistic, sticks: statistic.and_then(decide) }
    }
}

/// A published method.
pub trait Method: Sync {
    /// The method's name in tables.
    fn name(&self) -> &'static str;
    /// The published decision.
    fn decision(&self) -> &'static str;
    /// Applies the method to a record.
    fn answer(&self, case: &Case<'_>) -> Answer;
}

/// Every method.
pub const ALL: [&dyn Method; 4] =
    [&toolbox::Toolbox, &cross_correlation::CrossCorrelation, &curve_fit::CurveFit, &shape::Shape];

#[cfg(test)]
mod tests {
    use super::*;
    use stiction::core::sim::process::Pole;
    use stiction::core::sim::valve::he_step;

    fn answers(op: &[f64], pv: &[f64]) -> Vec<Answer> {
        let record = Record::uniform(1.0, op.to_vec(), pv.to_vec());
        let case = Case::new(&record, false);
        ALL.iter().map(|method| method.answer(&case)).collect()
    }

    fn sticks(found: &[Answer]) -> Vec<Option<bool>> {
        found.iter().map(|answer| answer.sticks).collect()
    }

    /// OP is the integral of the error: the stem slips at OP's reversals, and PV follows as the output of a fast process.
    #[test]
    fn a_stick_slip_cycle_is_called_by_every_method() {
        let triangle = |k: usize| {
            let t = (k % 100) as f64 / 100.0;
            if t < 0.5 { 16.0 * t - 4.0 } else { 12.0 - 16.0 * t }
        };
        let op: Vec<f64> = (0..1000).map(triangle).collect();
        let (mut position, mut pv) = (-3.5, Vec::new());
        let stem = op.iter().map(|u| {
            position = he_step(position, *u, 7.0, 0.1);
            position
        });
        let stem: Vec<f64> = stem.collect();
        Pole::lag(2.0, 0.0).run(0, &stem, 0.0, &mut pv);
        let found = answers(&op, &pv);
        assert_eq!(sticks(&found), [Some(true); 4], "{found:?}");
    }

    #[test]
    fn sinusoids_in_antiphase_are_called_by_the_toolbox_alone_if_at_all() {
        let wave = |k: usize| libm::sin(2.0 * core::f64::consts::PI * k as f64 / 100.0);
        let (op, pv): (Vec<f64>, Vec<f64>) = (0..1000).map(|k| (wave(k), -2.0 * wave(k))).unzip();
        let found = answers(&op, &pv);
        assert_eq!(sticks(&found[1..]), [Some(false); 3], "{found:?}");
    }

    #[test]
    fn without_an_oscillation_those_that_need_one_give_no_answer() {
        let drift: Vec<f64> = (0..600).map(|k| k as f64 * 0.01).collect();
        let found = answers(&drift, &drift);
        assert_eq!((found[1], found[2]), (Answer::default(), Answer::default()));
    }
}
