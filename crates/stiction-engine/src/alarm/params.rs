//! Conditions of an alarm: how many windows, and the size above which a window counts.

use serde::Serialize;

/// Conditions of an alarm. A window counts if s reaches the smaller of the two limits; a limit of 0 is off.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct AlarmParams {
    /// Raise when m of the last n windows show stiction.
    pub raise: [u8; 2],
    /// Smallest s that counts, % of travel where OP's range is known, else OP units.
    pub s_limit_op: f64,
    /// Smallest s that counts, as a share of OP's span in the window.
    pub s_limit_span: f64,
}

impl Default for AlarmParams {
    /// A tenth of OP's span is half of the size that the verdict calls weak: the valve then takes up a tenth or more of the
    /// controller's effort, whatever the size of the loop. It counts only above half a percent of travel, which even a new
    /// valve may have. If the span is wide for other reasons, such as set-point changes, one unit of OP (1 % if OP is in %)
    /// counts by itself, since valves are repaired above that.
    fn default() -> Self {
        Self { raise: [3, 4], s_limit_op: 1.0, s_limit_span: 0.1 }
    }
}
