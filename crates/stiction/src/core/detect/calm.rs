//! Two cheap tests for calm records: whether PV moves in jumps, and whether a stem predicts PV better than OP.
//!
//! Coarse versions of [`super::jumps`] and [`super::one_step`]: about a hundred bins, no lines, twenty stems.

use super::inputs::{Boxes, Grain, Input};
use super::known::{Known, Sums, Work, log_ratio};
use super::{jumps, usable};
use crate::core::record::Record;
use crate::core::signal::{detrend, stats};

/// Results of the tests.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Signs {
    /// Excess concentration of PV's moves over OP's, see [`super::jumps`]; 0 if either is constant.
    pub jumps: f64,
    /// Twice the log likelihood ratio of the best stem and OP as inputs for one-step prediction of PV; 0 if no stem moves.
    pub stem: f64,
}

const GRAIN: Grain = Grain { per_period: 20.0, enough: 40, most: 400, periodic: false };
/// s over OP's span; j over s for He's and for the tracking model.
const BANDS: [f64; 5] = [0.09, 0.18, 0.3, 0.45, 0.64];
const JUMPS: [[f64; 2]; 2] = [[0.35, 1.0], [0.0, 0.35]];

/// Tests a record whose OP has a typical period of `period` points, if any; `None` if the record is too short or a signal
/// is constant.
#[must_use]
pub(crate) fn signs(record: &Record, period: Option<f64>) -> Option<Signs> {
    let period = usable(period, record.len());
    let boxes = Boxes::of(&record.op_path, record.path_per_point(), record.len(), period, GRAIN)?;
    let pv = detrend::box_means(&record.pv[..boxes.op.len() * boxes.points], boxes.points);
    let (level, spread) = (stats::mean(&pv), stats::std_dev(&pv));
    if !spread.is_normal() {
        return None;
    }
    let concentrated = jumps::excess(&boxes.op, &pv, period / boxes.points as f64).unwrap_or(0.0);
    let pv = pv.iter().map(|y| (y - level) / spread).collect();
    let sums = Sums::new(Known::past(pv, boxes.from, boxes.order), &boxes.follow, boxes.lags);
    let (op, stems) = boxes.few(&BANDS, JUMPS);
    let mut work = Work::default();
    let mut error = |input: &Input| sums.error(input, None, &mut work);
    let without = error(&op);
    let with = stems.iter().map(error).fold(f64::INFINITY, f64::min);
    let stem = if with.is_finite() { sums.count() as f64 * log_ratio(without, with) } else { 0.0 };
    Some(Signs { jumps: concentrated, stem })
}
