//! One valve over many windows: its size since the last change, the date of that change, windows that disagree.
//!
//! [`over_time`] fits stretches between changes to the results of the windows. In a stretch the share of windows with
//! stiction is constant, and so is ln s, apart from its interval and a variance between windows (random effects); s may also
//! drift linearly. `docs/plant.md` has the formulas and error rates.

mod changes;
mod level;
mod scatter;
mod stretch;
mod window;
mod words;

use serde::Serialize;

pub use window::WindowResult;

use stretch::Told;

/// Combined result of many windows of one valve. Sizes in OP units, 90 % intervals, times in ns since 1970.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct OverTime {
    /// Number of windows with an answer; others are not used.
    pub windows: usize,
    /// Size since the last change; `None` if no stiction was found since then, or no window gives a size.
    pub pooled: Option<Pooled>,
    /// Time of the last change; `None` without a change.
    pub since_ns: Option<i64>,
    /// Changes, oldest first.
    pub changes: Vec<Change>,
    /// Windows that contradict their stretch, oldest first.
    pub contradicting: Vec<Contradicting>,
    /// Growth of s since the last change; `None` if not significant or over less than a week.
    pub trend: Option<Trend>,
    /// The same in words.
    pub sentences: Vec<String>,
}

/// A size that many windows agree on.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Pooled {
    /// Dead band plus stick band: the weighted geometric mean or, if s drifts, its value at the last window.
    pub s: f64,
    /// Interval of `s`.
    pub s_interval: [f64; 2],
    /// Slip jump; `None` if no window gives one.
    pub j: Option<f64>,
    /// Interval of `j`; the values compatible with most windows if it is not identifiable.
    pub j_interval: Option<[f64; 2]>,
    /// Whether any window identifies j.
    pub j_identifiable: bool,
    /// Number of windows that give a size.
    pub windows: usize,
    /// Equivalent number of windows without overlap and correlation.
    pub independent_windows: f64,
    /// Standard deviation of s between windows beyond the windows' own intervals, % of s.
    pub between_windows_pct: f64,
}

/// Kind of change.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum ChangeKind {
    /// Stiction before, none found afterwards.
    Repaired,
    /// It sticks less than before.
    Better,
    /// It sticks more than before, or has begun to.
    Worse,
}

/// A change of the valve.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Change {
    /// Most likely date.
    pub at_ns: i64,
    /// Start of the interval of the date.
    pub from_ns: i64,
    /// End of it.
    pub to_ns: i64,
    /// What changed.
    pub kind: ChangeKind,
    /// s before; `None` where no stiction was found.
    pub s_before: Option<f64>,
    /// s after; `None` if no stiction was found.
    pub s_after: Option<f64>,
    /// Share of histories of 500 windows without any change that have no step as clear as this one.
    pub p: f64,
}

/// A window that contradicts its stretch.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Contradicting {
    /// End of the window, which is its name.
    pub end_ns: i64,
    /// Its s.
    pub s: Option<f64>,
    /// Interval of `s`.
    pub s_interval: Option<[f64; 2]>,
    /// Why, in words.
    pub why: String,
}

/// Steady growth of s, by a straight line through ln s.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Trend {
    /// Growth, OP units per month (30.44 days) at the current s.
    pub s_per_month: f64,
    /// Interval of `s_per_month`.
    pub s_per_month_interval: [f64; 2],
    /// Growth, % per month.
    pub pct_per_month: f64,
    /// Start of the growth, ns.
    pub since_ns: i64,
}

/// Combines the windows of one valve, given in any order.
///
/// A window counts if it has an answer (`stiction` is not `None`) and a positive duration; of windows with the same end the
/// last one given counts. Overlapping windows share the weight of the overlap, so a shorter hop does not add confidence.
#[must_use]
pub fn over_time(windows: &[WindowResult]) -> OverTime {
    let history = window::History::of(windows);
    let told = Told::of(&history);
    let mut out = OverTime {
        windows: history.points.len(),
        pooled: told.pooled(&history),
        since_ns: told.changes.last().map(|c| c.at_ns),
        contradicting: told.contradicting(&history),
        trend: told.trend(&history),
        changes: told.changes,
        sentences: Vec::new(),
    };
    out.sentences = words::sentences(&out, &history);
    out
}
