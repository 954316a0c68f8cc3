//! Travel of OP while PV is constant.

use super::{Detector, View};
use crate::core::signal::stats;

/// Longest travel of OP while PV stays inside a narrow band, over OP's span, 0..1. The band is six standard deviations of
/// PV's smoothed noise, at least 12 % of PV's own span.
pub(super) struct Travel;

impl Detector for Travel {
    fn name(&self) -> &'static str {
        "travel"
    }

    fn score(&self, view: &View) -> Option<f64> {
        let sorted = stats::sorted(&view.pv);
        let wide = stats::quantile_sorted(&sorted, 0.98) - stats::quantile_sorted(&sorted, 0.02);
        let band = (6.0 * view.pv_noise / (view.output.period / 32.0).max(1.0).sqrt()).max(0.12 * wide);
        let span = stats::span(&view.output.op);
        if span.is_nan() || span <= 0.0 {
            return None;
        }
        let mut longest = 0.0_f64;
        let mut from = 0;
        while from < view.pv.len() {
            let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
            let (mut op_low, mut op_high) = (f64::INFINITY, f64::NEG_INFINITY);
            for (pv, op) in view.pv[from..].iter().zip(&view.output.op[from..]) {
                (low, high) = (low.min(*pv), high.max(*pv));
                if high - low > band {
                    break;
                }
                (op_low, op_high) = (op_low.min(*op), op_high.max(*op));
            }
            longest = longest.max(op_high - op_low);
            from += 1;
        }
        Some((longest / span).min(1.0))
    }
}
