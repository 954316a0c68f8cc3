//! Two cheap looks at a record of which nothing is expected: do PV's moves come in jumps, and does a stem predict PV better
//! than OP does?
//!
//! Coarse forms of [`super::jumps`] and [`super::one_step`]: some hundred boxes, no lines, twenty stems.

use super::inputs::{Boxes, Grain, Input};
use super::known::{Known, Sums, Work, log_ratio};
use super::{jumps, usable};
use crate::record::Record;
use crate::signal::{detrend, stats};

/// What the looks show.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Signs {
    /// How much more concentrated PV's moves are than OP's, see [`super::jumps`]; 0 where neither moves.
    pub jumps: f64,
    /// Twice the logarithm of the likelihoods' ratio of the best stem and OP as inputs that predict PV one step ahead;
    /// 0 where no stem moves.
    pub stem: f64,
}

const GRAIN: Grain = Grain { per_period: 20.0, enough: 40, most: 400, periodic: false };
/// s over OP's span; j over s under He's and under the tracking law.
const BANDS: [f64; 5] = [0.09, 0.18, 0.3, 0.45, 0.64];
const JUMPS: [[f64; 2]; 2] = [[0.35, 1.0], [0.0, 0.35]];

/// Looks at a record whose OP has a typical period of `period` points, if it has one; `None` where the record is too short or a signal
/// does not move.
#[must_use]
pub fn signs(record: &Record, period: Option<f64>) -> Option<Signs> {
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
