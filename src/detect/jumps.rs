//! PV moves in jumps while OP moves steadily.

use super::{Detector, View};

/// Concentration of PV's moves less that of OP's, -0.3..0.7: the concentration is the share of the squared moves over
/// a sixteenth of a period that the largest tenth of them holds. Needs no model, no cycle and no period.
pub(super) struct Jumps;

impl Detector for Jumps {
    fn name(&self) -> &'static str {
        "jumps"
    }

    fn score(&self, view: &View) -> Option<f64> {
        let width = ((view.period / 16.0) as usize).max(1);
        let difference = concentration(&view.pv, width)? - concentration(&view.op, width)?;
        Some(difference.clamp(-0.3, 0.7))
    }
}

fn concentration(x: &[f64], width: usize) -> Option<f64> {
    let mut squares: Vec<f64> = x.windows(width + 1).map(|w| (w[width] - w[0]) * (w[width] - w[0])).collect();
    squares.sort_by(|a, b| b.total_cmp(a));
    let total: f64 = squares.iter().sum();
    let top: f64 = squares[..squares.len() / 10].iter().sum();
    (total > 0.0).then(|| top / total)
}
