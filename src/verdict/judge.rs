//! From figures to a word.
//!
//! Provisional: thresholds on the figures of one fit, until they are replaced by calibrated probabilities. What they
//! rest on is said at each.

use super::document::Verdict;
use crate::detect::oscillation::Oscillates;
use crate::ident::Estimate;
use crate::ident::region;

/// Least share of the free-run error that the valve law must remove.
pub const MIN_INDEX: f64 = 0.5;
/// Least s over OP's span: smaller bands are within what noise and rounding imitate.
pub const MIN_S_OVER_SPAN: f64 = 0.2;
/// Fewest changes of the stem's direction: fewer are an accident, not a habit.
pub const MIN_REVERSALS: usize = 3;
/// Autocorrelation a period later above which an oscillation is driven from outside: a loop that rings by itself
/// under random load loses its phase.
const DRIVEN: f64 = 0.7;
/// The same below which it rings by itself.
const RINGING: f64 = 0.4;

/// The verdict on a window that could be fitted (`estimate` is `None` where the stem never moves).
#[must_use]
pub fn judge(estimate: Option<&Estimate>, oscillation: Option<&Oscillates>) -> Verdict {
    if let Some(e) = estimate {
        let sticks = e.index >= MIN_INDEX && e.s > MIN_S_OVER_SPAN * e.span && e.reversals >= MIN_REVERSALS;
        if sticks {
            return match region::region(e.s, e.j, e.span) {
                "deadband" => Verdict::Deadband,
                _ => Verdict::Stiction,
            };
        }
    }
    match oscillation {
        Some(o) if o.oscillating && o.persistence > DRIVEN => Verdict::Disturbance,
        Some(o) if o.oscillating && o.persistence < RINGING => Verdict::Tuning,
        Some(o) if o.oscillating => Verdict::NoStiction,
        _ => Verdict::NoOscillation,
    }
}
