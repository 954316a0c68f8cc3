//! Horch's cross-correlation: with a sticking valve and an integrating controller, OP and PV are a quarter period apart.

use super::{Detector, View};
use crate::core::signal::stats::dot;

/// Share of the odd part in the energy of the cross-correlation of OP and PV, 0..1 (after Horch 1999, who uses the
/// correlation's zero crossings). Near 0 for a loop whose OP mirrors PV, as with an oscillating disturbance or tight
/// proportional control. A high value alone is not conclusive, because noise is half odd.
pub(super) struct CrossCorrelation;

impl Detector for CrossCorrelation {
    fn name(&self) -> &'static str {
        "horch"
    }

    fn score(&self, view: &View) -> Option<f64> {
        let n = view.output.op_fast.len();
        let most = (view.output.period as usize).min(n.saturating_sub(1));
        let (mut odd, mut all) = (0.0, 0.0);
        for lag in 0..=most {
            let ahead = dot(&view.output.op_fast[lag..], &view.pv_fast);
            let behind = dot(&view.output.op_fast, &view.pv_fast[lag..]);
            let weight = if lag == 0 { 0.5 } else { 1.0 };
            odd += weight * 0.5 * (ahead - behind) * (ahead - behind);
            all += weight * (ahead * ahead + behind * behind);
        }
        (all > 0.0).then(|| odd / all)
    }
}
