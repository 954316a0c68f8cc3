//! Limits of a test on a running loop; every proposed test uses them.

use serde::{Deserialize, Serialize};

use crate::core::people::{about, size};

/// Longest test that operations can spare a loop for, s: a shift.
pub const SHIFT_S: f64 = 8.0 * 3_600.0;
/// Farthest that a test may move PV, in spans of PV in the record.
pub const PV_SPANS: f64 = 2.0;

/// PV counts as moved when its mean changes by this many standard errors of the model's residual.
const ERRORS: f64 = 4.0;
/// Most samples of a mean that count as independent: the residual is not white.
pub(crate) const INDEPENDENT: f64 = 9.0;

/// Smallest move of PV that a mean over `samples` reveals above a residual with mean square `mse`, PV units.
#[must_use]
pub(crate) fn hidden_below(mse: f64, samples: f64) -> f64 {
    ERRORS * (2.0 * mse / samples.clamp(1.0, INDEPENDENT)).sqrt()
}

/// Why a test is too much for the loop.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Excess {
    /// PV would move too far: its travel, and its span in the record, PV units.
    Travel(f64, f64),
    /// The test takes longer than a shift, s.
    Duration(f64),
}

/// Why a test that moves PV by `travel_pv` and takes `total_s` must not be proposed for a loop whose PV had the span `pv_span`
/// in the record; both in the same unit.
#[must_use]
pub(crate) fn excess(travel_pv: f64, pv_span: f64, total_s: f64) -> Option<Excess> {
    if travel_pv > PV_SPANS * pv_span {
        return Some(Excess::Travel(travel_pv, pv_span));
    }
    (total_s > SHIFT_S).then_some(Excess::Duration(total_s))
}

impl Excess {
    /// The reason in words.
    #[must_use]
    pub fn words(&self) -> String {
        match self {
            Self::Travel(travel, span) => format!(
                "it would move PV by {} PV units, and PV moved over {} in this record",
                size(*travel),
                size(*span)
            ),
            Self::Duration(total_s) => format!("it would take {}, longer than a shift", about(*total_s)),
        }
    }
}
