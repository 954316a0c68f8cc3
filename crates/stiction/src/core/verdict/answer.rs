//! Where an estimate stands, its grade and its size, in the unit in which sizes are reported.

use serde::{Deserialize, Serialize};

use super::Assessment;
use super::assess::WHOLE_SWING;
use crate::core::people;

/// Calibrated probability from which a valve below the decision threshold is reported as open instead of not seen.
pub const OPEN_FROM: f64 = 0.3;

/// Where an estimate stands on the question whether the valve sticks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum Standing {
    /// It sticks, surely enough to count towards an alarm.
    Sticks,
    /// It sticks, but not surely enough to count towards an alarm.
    Suspected,
    /// Neither found nor unseen: the calibrated probability is from 0.3 up to the decision threshold.
    Open,
    /// No sign of it was found.
    NotSeen,
    /// The window cannot answer.
    NoAnswer,
}

impl Standing {
    /// Standing of an estimate.
    #[must_use]
    pub fn of(a: &Assessment) -> Self {
        let p = a.p_calibrated.or_else(|| a.explanation.map(|opinion| opinion.p()));
        let is_sure = a.explanation.zip(p).is_none_or(|(opinion, p)| p >= opinion.cuts.alarm);
        match a.stiction {
            Some(true) if is_sure => Self::Sticks,
            Some(true) => Self::Suspected,
            Some(false) if p.is_some_and(|p| p >= OPEN_FROM) => Self::Open,
            Some(false) => Self::NotSeen,
            None => Self::NoAnswer,
        }
    }

    /// Whether stiction was found.
    #[must_use]
    pub const fn is_found(self) -> bool {
        matches!(self, Self::Sticks | Self::Suspected)
    }
}

/// The unit in which sizes are reported: % of travel if OP's range is known, else OP's unit.
#[derive(Debug, Clone, PartialEq)]
pub struct Scale<'a> {
    /// OP units of 1 % of travel.
    percent: Option<f64>,
    op_unit: &'a str,
}

impl<'a> Scale<'a> {
    /// Scale for an estimate.
    #[must_use]
    pub fn of(a: &'a Assessment) -> Self {
        let width = a.op_range.map(|[low, high]| 0.01 * (high - low).abs()).filter(|width| *width > 0.0);
        Self { percent: width, op_unit: a.op_unit.as_deref().unwrap_or("OP units") }
    }

    /// The unit.
    #[must_use]
    pub const fn unit(&self) -> &str {
        if self.percent.is_some() { "% of travel" } else { self.op_unit }
    }

    /// Converts a size from OP units.
    #[must_use]
    pub fn value(&self, op: f64) -> f64 {
        self.percent.map_or(op, |percent| op / percent)
    }

    /// Converts a size back to OP units.
    #[must_use]
    pub fn op_units(&self, told: f64) -> f64 {
        self.percent.map_or(told, |percent| told * percent)
    }

    /// A size with its unit; % of travel is followed by OP's unit where the two differ.
    #[must_use]
    pub fn told(&self, op: f64) -> String {
        let text = format!("{} {}", people::size(self.value(op)), self.unit());
        match self.percent {
            Some(percent) if percent != 1.0 => format!("{text} ({} {})", people::size(op), self.op_unit),
            _ => text,
        }
    }
}

/// The grade if stiction was found; it has no meaning for other answers. Documents of earlier builds always have one.
#[must_use]
pub fn grade(a: &Assessment) -> Option<char> {
    a.grade.filter(|_| Standing::of(a).is_found())
}

/// Whether the estimate or its interval reaches OP's span: then s has no measured upper bound.
#[must_use]
pub fn at_bound(a: &Assessment) -> bool {
    let Some((s, share)) = a.s.zip(a.s_over_span).filter(|(_, share)| *share > 0.0) else { return false };
    let highest = a.s_interval.map_or(s, |[_, high]| high.max(s));
    highest >= WHOLE_SWING * s / share
}

/// s with its interval and unit in a few words; `None` if no stiction was found.
#[must_use]
pub fn size(a: &Assessment) -> Option<String> {
    let s = a.s.filter(|_| Standing::of(a).is_found())?;
    let scale = Scale::of(a);
    let [value, unit] = [people::size(scale.value(s)), scale.unit().to_owned()];
    let interval = a.s_interval.map(|ends| people::interval(ends.map(|end| scale.value(end))));
    Some(match interval {
        Some([least, _]) if at_bound(a) => format!("{value}, at least {least} {unit}"),
        Some([low, high]) => format!("{value} ({low} to {high}) {unit}"),
        None => format!("{value} {unit}"),
    })
}
