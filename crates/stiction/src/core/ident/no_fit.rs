//! Reasons why a record has no fit.

use thiserror::Error;

use crate::core::record::Record;
use crate::core::signal::stats;

/// Fewest points for a fit.
pub(super) const LEAST_POINTS: usize = 30;

/// Why there is no fit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum NoFit {
    /// Too few points.
    #[error("the record has {0} points, and a fit needs {LEAST_POINTS}; choose a longer window")]
    TooShort(usize),
    /// OP or PV has a value that is not finite.
    #[error("OP or PV has a value that is not a number; choose a window without such values, or fill them in")]
    NotFinite,
    /// OP is constant.
    #[error("OP is constant over 99 % of the record or more; choose a window in which the controller acts")]
    ConstantOp,
    /// PV is constant.
    #[error("PV is constant; choose a window in which it moves")]
    ConstantPv,
    /// No model explains any of PV.
    #[error("no model of valve and process fits this record; choose a window in which OP moves more")]
    NoModel,
}

impl NoFit {
    /// Checks that a record can be fitted.
    ///
    /// # Errors
    /// The first requirement that the record fails.
    pub(super) fn check(record: &Record) -> Result<(), Self> {
        if record.len() < LEAST_POINTS {
            Err(Self::TooShort(record.len()))
        } else if !record.op_path.iter().chain(&record.pv).all(|x| x.is_finite()) {
            Err(Self::NotFinite)
        } else if !stats::span(&record.op_path).is_normal() {
            Err(Self::ConstantOp)
        } else if !stats::std_dev(&record.pv).is_normal() {
            Err(Self::ConstantPv)
        } else {
            Ok(())
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::ident::{Options, quantify};

    #[test]
    fn a_record_without_a_fit_says_why() {
        let wave = |n: u32, per: f64| (0..n).map(|k| libm::sin(f64::from(k) * per)).collect::<Vec<f64>>();
        let fit = |op: Vec<f64>, pv: Vec<f64>| quantify(&Record::uniform(1.0, op, pv), &Options::default()).err();
        assert_eq!(fit(wave(29, 0.3), wave(29, 0.3)), Some(NoFit::TooShort(29)));
        assert_eq!(fit(vec![1.0; 90], wave(90, 0.3)), Some(NoFit::ConstantOp));
        assert_eq!(fit(wave(90, 0.3), vec![2.0; 90]), Some(NoFit::ConstantPv));
        let (mut broken, mut pulse) = (wave(900, 0.1), vec![1.0; 900]);
        (broken[450], pulse[450]) = (f64::NAN, 2.0);
        assert_eq!(fit(broken, wave(900, 0.1)), Some(NoFit::NotFinite));
        assert_eq!(fit(pulse, wave(900, 0.1)), Some(NoFit::ConstantOp));
        assert_eq!(fit(wave(400, 0.1), wave(400, 0.1)), None);
    }
}
