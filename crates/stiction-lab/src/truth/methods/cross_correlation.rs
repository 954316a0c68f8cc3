//! Horch's cross-correlation (Horch 1999): zero crossings of the correlation of OP and PV next to lag 0.

use super::{Answer, Case, Method};
use stiction::core::signal::spectrum::zero_crossings;
use stiction::core::signal::stats::dot;

/// Published thresholds for the asymmetry of the crossings, and for the correlation at lag 0 relative to its extremes.
const LAGS: [f64; 2] = [1.0 / 3.0, 2.0 / 3.0];
const LEVELS: [f64; 2] = [0.072, 1.0 / 3.0];

/// Statistic: `|l - r| / (l + r)` of the zero crossings at lags -l and r; near 1 for an odd correlation, as caused by a
/// sticking valve under an integrating controller, near 0 for an even one. For self-regulating, oscillating loops.
pub(super) struct CrossCorrelation;

impl Method for CrossCorrelation {
    fn name(&self) -> &'static str {
        "Horch, cross-correlation"
    }

    fn decision(&self) -> &'static str {
        "lags 1/3, 2/3; levels .072, 1/3"
    }

    fn answer(&self, case: &Case<'_>) -> Answer {
        if case.integrating || !case.oscillates {
            return Answer::default();
        }
        let Some([lags, levels]) = figures(case) else { return Answer::default() };
        let sticks = match () {
            () if lags > LAGS[1] && levels > LEVELS[1] => Some(true),
            () if lags < LAGS[0] && levels < LEVELS[0] => Some(false),
            () => None,
        };
        Answer { statistic: Some(lags), sticks }
    }
}

/// Asymmetry of the crossings, and of the levels.
fn figures(case: &Case<'_>) -> Option<[f64; 2]> {
    let (op, pv) = (&case.view.output.op_fast, &case.view.pv_fast);
    let most = (case.view.output.period as usize).min(op.len().saturating_sub(1));
    let later: Vec<f64> = (0..=most).map(|lag| dot(op, &pv[lag..])).collect();
    let earlier: Vec<f64> = (0..=most).map(|lag| dot(&op[lag..], pv)).collect();
    let [right, left] = [&later, &earlier].map(|side| zero_crossings(side, 0.0).first().copied());
    let (right, left) = (right?, left?);
    let inside = |side: &[f64], to: f64| side[..=to as usize].iter().fold(0.0_f64, |most, r| most.max(r.abs()));
    let (middle, extreme) = (later[0].abs(), inside(&later, right).max(inside(&earlier, left)));
    Some([(left - right).abs() / (left + right), (extreme - middle) / (extreme + middle)])
}
