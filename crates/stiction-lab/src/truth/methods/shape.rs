//! Yamashita's qualitative shapes (Yamashita 2006): OP moves while PV rests, and PV then moves in the right direction.

use super::{Answer, Case, Method};
use stiction::core::signal::detrend::remove_mean;
use stiction::core::signal::stats::std_dev;

/// Published threshold: the value for unrelated signals.
const INDEX: f64 = 0.25;

/// Statistic: rho 3, the share of moving samples in which OP moves and PV rests, without the rests that end in a way
/// inconsistent with a sticking valve. For self-regulating loops whose PV follows the valve fast, such as flow; applied to all
/// self-regulating ones.
pub(super) struct Shape;

/// A sample's move: up, none, down.
type Moves = (i8, i8);

impl Method for Shape {
    fn name(&self) -> &'static str {
        "Yamashita, shapes"
    }

    fn decision(&self) -> &'static str {
        "rho 3 > 0.25"
    }

    fn answer(&self, case: &Case<'_>) -> Answer {
        if case.integrating {
            return Answer::default();
        }
        let (op, pv) = (moves(&case.view.output.op), moves(&case.view.pv));
        let signs = case.signs.iter().map(|sign| if *sign < 0.0 { -1 } else { 1 });
        let of = |sign: i8| rho3(op.iter().zip(&pv).map(|(u, y)| (*u, sign * y)));
        let best = signs.filter_map(of).reduce(f64::max);
        Answer::by_thresholds(best, INDEX, INDEX)
    }
}

/// First differences in three symbols: more than a standard deviation above their mean, below, or neither.
fn moves(x: &[f64]) -> Vec<i8> {
    let differences = remove_mean(&x.windows(2).map(|w| w[1] - w[0]).collect::<Vec<f64>>());
    let band = std_dev(&differences);
    differences
        .iter()
        .map(|d| {
            if *d > band {
                1
            } else if *d < -band {
                -1
            } else {
                0
            }
        })
        .collect()
}

/// `None` if nothing moves. Samples in which both rest are skipped.
fn rho3(samples: impl Iterator<Item = Moves>) -> Option<f64> {
    let moving: Vec<Moves> = samples.filter(|moves| *moves != (0, 0)).collect();
    let mut rests = 0;
    for stretch in moving.chunk_by(|a, b| a == b).collect::<Vec<_>>().windows(2) {
        let [(op, pv), next] = [stretch[0][0], stretch[1][0]];
        if op != 0 && pv == 0 && is_of_stiction(op, next) {
            rests += stretch[0].len();
        }
    }
    (!moving.is_empty()).then(|| rests as f64 / moving.len() as f64)
}

/// Whether a rest of PV while OP moves by `op` ends as with a sticking valve: PV slips in OP's direction while OP continues or
/// stops.
const fn is_of_stiction(op: i8, next: Moves) -> bool {
    next.1 == op && (next.0 == op || next.0 == 0)
}
