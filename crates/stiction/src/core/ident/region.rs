//! Regions of the fs-fd plane by kind of sticking.
//!
//! The plane's triangle has pure dead band on the ray `fs = fd` (j = 0), pure stick-slip on the axis `fd = 0`
//! (j = s), both in between, and strong cases towards its far side `s = S0` (after Lee, Ren and Huang 2008).

use serde::{Deserialize, Serialize};

/// What kind of sticking a pair of bands is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum Region {
    /// None that could be seen.
    None,
    /// The stem follows behind a dead band, without a jump.
    Deadband,
    /// It jumps as far as it stuck.
    StickSlip,
    /// Both.
    DeadbandStickSlip,
}

/// How much a valve sticks, in a word.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum Size {
    /// Negligible.
    None,
    /// Small.
    Weak,
    /// Worth watching.
    Moderate,
    /// In need of repair.
    Strong,
}

impl Region {
    /// Its word in documents.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Deadband => "deadband",
            Self::StickSlip => "stick_slip",
            Self::DeadbandStickSlip => "deadband_stick_slip",
        }
    }
}

impl Size {
    /// Its word in documents.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Weak => "weak",
            Self::Moderate => "moderate",
            Self::Strong => "strong",
        }
    }
}

/// Boundaries of the regions: s over OP's span below which no kind is named, j/s up to which the valve has a dead band, and j/s
/// from which it is stick-slip.
pub const BOUNDS: [f64; 3] = [0.1, 0.15, 0.85];
/// s over OP's span from which stiction is moderate, and above which it is strong.
pub const STRENGTHS: [f64; 2] = [0.2, 0.6];

/// Kind of sticking by j/s, if s is large enough to be seen at all.
///
/// `none` below a tenth of OP's span; `deadband` below j/s = 0.15; `stick_slip` above 0.85.
#[must_use]
pub(crate) fn region(s: f64, j: f64, span: f64) -> Region {
    if s < BOUNDS[0] * span || s <= 0.0 { Region::None } else { kind(s, j) }
}

/// Kind of sticking, however small s is.
#[must_use]
pub(crate) fn kind(s: f64, j: f64) -> Region {
    if j / s < BOUNDS[1] {
        Region::Deadband
    } else if j / s > BOUNDS[2] {
        Region::StickSlip
    } else {
        Region::DeadbandStickSlip
    }
}

/// Strength relative to the loop's own movement: s over OP's span, with limits 0.2 and 0.6.
#[must_use]
pub(crate) fn strength_by_span(s: f64, span: f64) -> Size {
    if s > STRENGTHS[1] * span {
        Size::Strong
    } else if s >= STRENGTHS[0] * span {
        Size::Moderate
    } else {
        Size::Weak
    }
}

/// Severity relative to the valve's travel, % of OP's range, with limits 0.5, 1 and 2 %; `None` for a range without width.
#[must_use]
pub(crate) fn severity_by_range(s: f64, range: [f64; 2]) -> Option<Size> {
    let width = (range[1] - range[0]).abs();
    if width.is_nan() || width <= 0.0 {
        return None;
    }
    let percent = 100.0 * s / width;
    Some(match percent {
        p if p < 0.5 => Size::None,
        p if p < 1.0 => Size::Weak,
        p if p < 2.0 => Size::Moderate,
        _ => Size::Strong,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn corners_of_the_triangle_have_their_names() {
        assert_eq!(region(0.05, 0.0, 1.0), Region::None);
        assert_eq!(region(0.5, 0.0, 1.0), Region::Deadband);
        assert_eq!(region(0.5, 0.5, 1.0), Region::StickSlip);
        assert_eq!(region(0.5, 0.25, 1.0), Region::DeadbandStickSlip);
        assert_eq!(strength_by_span(0.7, 1.0), Size::Strong);
        assert_eq!(strength_by_span(0.2, 1.0), Size::Moderate);
        assert_eq!(strength_by_span(0.1, 1.0), Size::Weak);
        assert_eq!(severity_by_range(1.5, [0.0, 100.0]), Some(Size::Moderate));
        assert_eq!(severity_by_range(1.5, [1.0, 1.0]), None);
    }
}
