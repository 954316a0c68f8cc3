//! PV moves in jumps while OP moves steadily.

use super::{Detector, View};
use crate::core::signal::stats;

/// Excess concentration of PV's moves over OP's, 0..0.7 (a lower concentration is not informative, because OP follows a set
/// point that changes in steps). The concentration is the share of the squared moves over a sixteenth of a period in the
/// largest tenth of them. The same for the changes of the moves, if larger: after a jumping valve, an integrating process
/// changes slope instead of jumping. Needs no model, cycle or period, but a sampling time well below a sixteenth of OP's
/// typical period.
pub(super) struct Jumps;

impl Detector for Jumps {
    fn name(&self) -> &'static str {
        "jumps"
    }

    fn score(&self, view: &View) -> Option<f64> {
        excess(&view.output.op, &view.pv, view.output.period)
    }
}

/// The same for any two signals of equal length, with a period in points.
pub(super) fn excess(op: &[f64], pv: &[f64], period: f64) -> Option<f64> {
    let width = ((period / 16.0) as usize).max(1);
    let (op, pv) = (moves(op, width), moves(pv, width));
    let jumps = concentration(&pv)? - concentration(&op)?;
    let turns = match (concentration(&moves(&pv, width)), concentration(&moves(&op, width))) {
        (Some(pv), Some(op)) => pv - op,
        _ => jumps,
    };
    Some(jumps.max(turns).clamp(0.0, 0.7))
}

fn moves(x: &[f64], width: usize) -> Vec<f64> {
    x.windows(width + 1).map(|w| w[width] - w[0]).collect()
}

/// Share of the sum of squares in the largest tenth.
fn concentration(x: &[f64]) -> Option<f64> {
    let mut squares: Vec<f64> = x.iter().map(|d| d * d).collect();
    let total = stats::sum(&squares);
    let tenth = squares.len() / 10;
    if tenth > 0 {
        squares.select_nth_unstable_by(tenth, |a, b| b.total_cmp(a));
    }
    (total > 0.0).then(|| stats::sum(&squares[..tenth]) / total)
}
