//! PV moves in jumps while OP moves steadily.

use super::{Detector, View};
use crate::signal::stats;

/// How much more concentrated PV's moves are than OP's, 0..0.7 (less concentrated says nothing: OP answers a set point that
/// steps in steps): the concentration is the share of the squared moves
/// over a sixteenth of a period that the largest tenth of them holds. The same of the changes of the moves, where that is
/// more: behind a valve that jumps, an integrating process turns sharply instead of jumping. Needs no model, no cycle and
/// no period, but a sampling time well below a sixteenth of OP's typical time.
pub(super) struct Jumps;

impl Detector for Jumps {
    fn name(&self) -> &'static str {
        "jumps"
    }

    fn score(&self, view: &View) -> Option<f64> {
        excess(&view.output.op, &view.pv, view.output.period)
    }
}

/// The same of any two signals of equal length and a period in their points.
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
