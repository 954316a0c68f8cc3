//! Whether the model is good enough: then what is left of PV asks for no further effect and no test.

use serde::{Deserialize, Serialize};

/// Share of PV's standard deviation up to which what is left needs no explanation: a hundredth of its variance.
pub(crate) const STATED: f64 = 0.1;

/// The answer that the model is good enough.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct EnoughNote {
    /// What the base leaves above the noise, % of PV's standard deviation.
    pub left_pct: f64,
    /// What it stays below, % of PV's standard deviation.
    pub limit_pct: f64,
    /// Whether that is PV's noise floor; else it is the stated limit.
    pub is_noise: bool,
}

impl EnoughNote {
    /// By the gap and the noise floor over PV's standard deviation; `None` where the model is not good enough.
    #[must_use]
    pub(crate) fn of(relative_gap: f64, relative_floor: Option<f64>) -> Option<Self> {
        let is_noise = relative_floor.is_some_and(|floor| relative_gap <= floor);
        let limit = relative_floor.filter(|_| is_noise).unwrap_or(STATED);
        (relative_gap <= limit).then_some(Self { left_pct: 100.0 * relative_gap, limit_pct: 100.0 * limit, is_noise })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_gap_below_the_noise_or_the_stated_limit_is_small_enough() {
        let limit =
            |gap: f64, floor: Option<f64>| EnoughNote::of(gap, floor).map(|e| (e.limit_pct.round(), e.is_noise));
        assert_eq!(limit(0.02, Some(0.03)), Some((3.0, true)));
        assert_eq!(limit(0.04, Some(0.03)), Some((10.0, false)));
        assert_eq!(limit(0.15, Some(0.2)), Some((20.0, true)));
        assert_eq!([limit(0.15, Some(0.05)), limit(0.15, None), limit(f64::NAN, None)], [None; 3]);
    }
}
