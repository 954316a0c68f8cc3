//! A fast cycle that a slower drift of OP hides.

use crate::detect::oscillation;
use crate::record::Record;
use crate::signal::{detrend, stats};

/// Typical period of the error over OP's below which OP's is a drift's.
const HIDDEN: f64 = 0.4;
/// Moving average that is taken off, periods of the error.
const WIDTH: f64 = 4.0;
/// Fewest points of a period of the error, and periods of it.
const LEAST_POINTS: f64 = 6.0;
const LEAST_PERIODS: f64 = 5.0;

/// The record without what is slower than four typical periods of its error (SP - PV, or -PV where the set point rests),
/// where that period is much shorter than OP's; `None` elsewhere.
///
/// All indicators cut a record by OP's period. Where a drift makes that one, as many as a hundred cycles of the valve's
/// count as one.
#[must_use]
pub fn cycle(record: &Record) -> Option<Record> {
    let op = record.op();
    let sp = record.sp.as_ref().filter(|sp| sp.len() == record.len());
    let error: Vec<f64> = match sp {
        Some(sp) => record.pv.iter().zip(sp).map(|(pv, sp)| pv - sp).collect(),
        None => record.pv.clone(),
    };
    let (slow, fast) = (oscillation::typical_period(&op)?, oscillation::typical_period(&error)?);
    if fast >= HIDDEN * slow || fast < LEAST_POINTS || LEAST_PERIODS * fast > record.len() as f64 {
        return None;
    }
    let width = (WIDTH * fast) as usize;
    let drift = detrend::moving_average(&op, width);
    let per_point = record.path_per_point();
    let op_path = record.op_path.iter().enumerate().map(|(at, u)| u - drift[at / per_point]).collect();
    let faster = |x: &[f64]| detrend::high_pass(x, width);
    let sp = sp.map(|sp| faster(sp));
    let pv = faster(&record.pv);
    let moves = stats::std_dev(&pv).is_normal();
    moves.then(|| Record { op_path, pv, sp, mv: None, ..record.clone() })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A cycle of 20 points beside a drift of OP of `size`.
    fn record(size: f64) -> Record {
        let cycle = |k: usize| libm::sin(k as f64 * 0.314);
        let drift = |k: usize| size * libm::sin(k as f64 * 0.008);
        Record::uniform(
            1.0,
            (0..1500).map(|k| cycle(k) + drift(k)).collect(),
            (0..1500).map(|k| cycle(k + 5)).collect(),
        )
    }

    #[test]
    fn a_drift_is_taken_off_and_the_cycle_stays() {
        let fast = cycle(&record(10.0)).unwrap();
        assert!(stats::span(&fast.op_path) < 2.4, "{}", stats::span(&fast.op_path));
        assert!(stats::span(&fast.pv) > 1.8 && fast.len() == 1500);
        assert!(cycle(&record(0.0)).is_none());
    }
}
