//! One valve over many windows: how far it sticks since it last changed, when that was, and which windows disagree.
//!
//! [`over_time`] takes what each window said and fits stretches between changes. In a stretch the share of windows that
//! find stiction is constant, and so is ln s, apart from what its interval and a variance between windows let it scatter
//! (random effects); s may also drift along a line. `docs/over-time.md` has the formulas and how often this is wrong.

mod changes;
mod level;
mod scatter;
mod stretch;
mod window;
mod words;

use serde::Serialize;

pub use window::WindowResult;

use stretch::Told;

/// What many windows of one valve say together. Sizes in OP units, intervals of 90 %, times in ns since 1970.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct OverTime {
    /// Windows that gave an answer; the others are left aside.
    pub windows: usize,
    /// Size since the last change; `None` where no stiction is found since then, or no window gives a size.
    pub pooled: Option<Pooled>,
    /// When the last change was; `None` where nothing changed.
    pub since_ns: Option<i64>,
    /// Changes, oldest first.
    pub changes: Vec<Change>,
    /// Windows that contradict their stretch, oldest first.
    pub contradicting: Vec<Contradicting>,
    /// Growth of s since the last change; `None` where none shows, or where that is less than a week.
    pub trend: Option<Trend>,
    /// The same in words.
    pub sentences: Vec<String>,
}

/// A size that many windows agree on.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Pooled {
    /// Dead band plus stick band: the weighted geometric mean, or where s drifts, its value at the last window.
    pub s: f64,
    /// Interval of `s`.
    pub s_interval: [f64; 2],
    /// Slip jump; `None` where no window gives one.
    pub j: Option<f64>,
    /// Interval of `j`; where it is not identifiable, what most windows allow.
    pub j_interval: Option<[f64; 2]>,
    /// Whether a window identifies j.
    pub j_identifiable: bool,
    /// Windows that give a size.
    pub windows: usize,
    /// As many windows would tell as much if they neither overlapped nor resembled the ones before.
    pub independent_windows: f64,
    /// Standard deviation of s from window to window beyond what the windows' own intervals explain, % of s.
    pub between_windows_pct: f64,
}

/// What changed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum ChangeKind {
    /// It stuck before, and afterwards no stiction is found.
    Repaired,
    /// It sticks less than before.
    Better,
    /// It sticks more than before, or began to.
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
    /// s after.
    pub s_after: Option<f64>,
    /// Share of histories of 500 windows without any change that show no step as clear as this one.
    pub p: f64,
}

/// A window that contradicts its stretch.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Contradicting {
    /// The window's name: its end.
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
    /// Growth, OP units a month (30.44 days) at today's s.
    pub s_per_month: f64,
    /// Interval of `s_per_month`.
    pub s_per_month_interval: [f64; 2],
    /// Growth, % a month.
    pub pct_per_month: f64,
    /// Since when, ns.
    pub since_ns: i64,
}

/// Takes the windows of one valve together, in any order.
///
/// A window counts once it answers (`stiction` is not `None`) and lasts longer than nothing. Overlapping windows share what
/// they overlap in, so a shorter hop does not make anything surer.
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
