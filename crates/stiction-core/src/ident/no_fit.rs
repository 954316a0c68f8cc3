//! Why a record has no fit.

use thiserror::Error;

use crate::record::Record;
use crate::signal::stats;

/// Fewest points of a fit.
const LEAST_POINTS: usize = 30;

/// Why there is no fit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum NoFit {
    /// Too few points.
    #[error("the record has {0} points, and a fit needs {LEAST_POINTS}; choose a longer window")]
    TooShort(usize),
    /// OP is constant or not finite.
    #[error("OP does not move, or is not a number; choose a window in which the controller acts")]
    ConstantOp,
    /// PV is constant or not finite.
    #[error("PV does not move, or is not a number; choose a window in which it does")]
    ConstantPv,
    /// No process behind a valve explains any of PV.
    #[error("no process follows OP through a valve in this record; choose a window in which OP moves more")]
    NoModel,
}

impl NoFit {
    /// Whether a record lacks what every fit needs.
    ///
    /// # Errors
    /// What it lacks.
    pub(super) fn check(record: &Record) -> Result<(), Self> {
        if record.len() < LEAST_POINTS {
            Err(Self::TooShort(record.len()))
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
    use crate::ident::{Options, quantify};

    #[test]
    fn a_record_without_a_fit_says_why() {
        let wave = |n: u32, per: f64| (0..n).map(|k| libm::sin(f64::from(k) * per)).collect::<Vec<f64>>();
        let fit = |op: Vec<f64>, pv: Vec<f64>| quantify(&Record::uniform(1.0, op, pv), &Options::default()).err();
        assert_eq!(fit(wave(29, 0.3), wave(29, 0.3)), Some(NoFit::TooShort(29)));
        assert_eq!(fit(vec![1.0; 90], wave(90, 0.3)), Some(NoFit::ConstantOp));
        assert_eq!(fit(wave(90, 0.3), vec![f64::NAN; 90]), Some(NoFit::ConstantPv));
        assert_eq!(fit(wave(400, 0.1), wave(400, 0.1)), None);
    }
}
