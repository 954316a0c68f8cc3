//! What raises an alarm: how many windows, and from which size on a window counts.

use serde::Serialize;

/// What raises an alarm. A window counts from the lesser of its two limits on; a limit of 0 is none.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct AlarmParams {
    /// Raise when m of the last n windows say stiction.
    pub raise: [u8; 2],
    /// Least s that counts, OP units.
    pub s_limit_op: f64,
    /// Least s that counts, as a share of OP's span in the window.
    pub s_limit_span: f64,
}

impl Default for AlarmParams {
    /// A tenth of OP's span is half of what the verdict itself calls weak: whatever the loop's size, the controller then
    /// spends a tenth or more of its effort on the valve. Where the span is wide for other reasons, as with set-point
    /// moves, one unit of OP (1 % where OP is in %) counts by itself: from there on valves are repaired.
    fn default() -> Self {
        Self { raise: [3, 4], s_limit_op: 1.0, s_limit_span: 0.1 }
    }
}
