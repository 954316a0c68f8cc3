//! He's curve fit (He, Wang, Pottmann and Qin 2007): half cycles that are triangles rather than sinusoids.

use super::{Answer, Case, Method};
use stiction::core::detect::curve_fit;

/// Published thresholds.
const INDEX: [f64; 2] = [0.4, 0.6];

/// Statistic: the error of sinusoids over that of sinusoids and triangles, fitted to the half cycles of OP, or of PV if the
/// process integrates. For oscillating loops.
pub(super) struct CurveFit;

impl Method for CurveFit {
    fn name(&self) -> &'static str {
        "He, curve fit"
    }

    fn decision(&self) -> &'static str {
        "index 0.4, 0.6"
    }

    fn answer(&self, case: &Case<'_>) -> Answer {
        if !case.oscillates {
            return Answer::default();
        }
        let signal = if case.integrating { &case.view.pv_fast } else { &case.view.output.op_fast };
        Answer::by_thresholds(curve_fit(signal, case.view.output.period), INDEX[0], INDEX[1])
    }
}
