//! OP since the last point of a loop: provides its value where a sample of OP or PV was lost.

use serde::{Deserialize, Serialize};

/// Values kept between two points.
const LIMIT: usize = 64;
/// Regularity score: a point with a new OP adds one, a point without subtracts [`ABSENT`]. At [`REGULAR`] or more, a missing OP
/// was lost. OP that is sent on change reaches this only if it changes at more than four of five points.
const MOST_REGULAR: u8 = 32;
const REGULAR: u8 = 12;
const ABSENT: u8 = 4;

/// OP since the last point, by timestamp, ns.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct OpTrail {
    /// The latest value.
    op: Option<(i64, f64)>,
    /// OP of the last point and all values since.
    op_trail: Vec<(i64, f64)>,
    /// Latest timestamp at which OP came without a value.
    #[serde(default)]
    op_lost_ns: Option<i64>,
    /// The regularity score, at most [`MOST_REGULAR`].
    #[serde(default)]
    op_regular: u8,
}

impl OpTrail {
    pub const fn new() -> Self {
        Self { op: None, op_trail: Vec::new(), op_lost_ns: None, op_regular: 0 }
    }

    pub const fn latest(&self) -> Option<(i64, f64)> {
        self.op
    }

    pub fn push(&mut self, t_ns: i64, op: f64) {
        self.op = Some((t_ns, op));
        if self.op_trail.len() < LIMIT {
            self.op_trail.push((t_ns, op));
        }
    }

    pub const fn note_lost(&mut self, t_ns: i64) {
        self.op_lost_ns = Some(t_ns);
    }

    /// Whether OP came at this timestamp without a value.
    pub fn is_empty_at(&self, t_ns: i64) -> bool {
        self.op_lost_ns == Some(t_ns)
    }

    /// Registers a point; returns true if its OP was lost: OP came without a value, or a regular OP did not come.
    pub fn check_point(&mut self, t_ns: i64) -> bool {
        let is_new = |(t_op, _): (i64, f64)| self.op_trail.first().is_none_or(|(before_ns, _)| t_op > *before_ns);
        if self.op.is_some_and(is_new) {
            self.op_regular = (self.op_regular + 1).min(MOST_REGULAR);
            return false;
        }
        let is_lost = self.is_empty_at(t_ns) || self.op_regular >= REGULAR;
        self.op_regular = self.op_regular.saturating_sub(ABSENT);
        is_lost
    }

    /// Restarts from a point.
    pub fn restart(&mut self) {
        self.op_trail.clear();
        self.op_trail.extend(self.op);
    }

    /// OP held at a time since the last point.
    pub fn held_at(&self, t_ns: i64) -> Option<f64> {
        let after = self.op_trail.partition_point(|(t, _)| *t <= t_ns);
        self.op_trail.get(after.saturating_sub(1)).map(|(_, op)| *op)
    }

    /// OP at a time since the last point, interpolated to a value that came after `since_ns`, else held.
    pub fn interpolated_at(&self, t_ns: i64, since_ns: i64) -> Option<f64> {
        let after = self.op_trail.partition_point(|(t, _)| *t <= t_ns);
        let ends = after.checked_sub(1).and_then(|before| Some((self.op_trail[before], *self.op_trail.get(after)?)));
        match ends {
            Some(((t0, before), (t1, next))) if t0 > since_ns => {
                Some(before + (next - before) * ((t_ns - t0) as f64 / (t1 - t0) as f64))
            }
            _ => self.held_at(t_ns),
        }
    }

    pub const fn bytes(&self) -> usize {
        self.op_trail.capacity() * size_of::<(i64, f64)>()
    }
}
