//! Whether work on a valve helped: its windows before and after a review.

use serde::Serialize;

use stiction::core::signal::stats::median;
use stiction::core::units::{number, probability};

/// Fewest windows with an answer on each side.
const LEAST: usize = 3;
/// s counts as smaller below this fraction of its earlier value.
const SMALLER: f64 = 0.8;

/// The compared values of one window.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Measured {
    /// Whether it finds stiction.
    pub stiction: Option<bool>,
    /// Probability that the valve sticks.
    pub p: Option<f64>,
    /// Dead band plus stick band, OP units.
    pub s: Option<f64>,
    /// Standard deviation of PV.
    pub pv_sd: Option<f64>,
}

/// Windows before or after a date.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, schemars::JsonSchema)]
pub struct Side {
    /// Number of windows with an answer.
    pub windows: usize,
    /// Number of those that find stiction.
    pub sticking: usize,
    /// Median probability that the valve sticks.
    pub p: Option<f64>,
    /// Median s of the windows that find stiction, OP units.
    pub s: Option<f64>,
    /// Median standard deviation of PV, PV units.
    pub pv_sd: Option<f64>,
}

/// Whether the work helped.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, schemars::JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Helped {
    /// No window finds stiction any longer.
    Yes,
    /// Fewer windows find it, or s is smaller.
    Partly,
    /// It sticks as much as before.
    No,
    /// The windows do not show whether it helped.
    Unknown,
}

/// Comparison before and after a date.
#[derive(Debug, Clone, PartialEq, Serialize, schemars::JsonSchema)]
pub struct Outcome {
    /// The windows before.
    pub before: Side,
    /// The windows after.
    pub after: Side,
    /// Whether the work helped.
    pub helped: Helped,
    /// The same in a sentence.
    pub words: String,
}

impl Side {
    fn of(windows: &[Measured]) -> Self {
        let answered: Vec<&Measured> = windows.iter().filter(|w| w.stiction.is_some()).collect();
        let sticking: Vec<&Measured> = answered.iter().copied().filter(|w| w.stiction == Some(true)).collect();
        let middle = |of: &[&Measured], value: fn(&Measured) -> Option<f64>| {
            let values: Vec<f64> = of.iter().filter_map(|w| value(w)).collect();
            (!values.is_empty()).then(|| median(&values))
        };
        Self {
            windows: answered.len(),
            sticking: sticking.len(),
            p: middle(&answered, |w| w.p),
            s: middle(&sticking, |w| w.s),
            pv_sd: middle(&answered, |w| w.pv_sd),
        }
    }

    /// Whether most of the windows find stiction.
    const fn sticks(&self) -> bool {
        2 * self.sticking > self.windows
    }
}

/// Event at the date that divides the windows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Done {
    /// The valve was found to be sticking.
    Found,
    /// It was found not to stick.
    Nothing,
    /// It was repaired.
    Repaired,
}

impl Done {
    /// Name of the date.
    const fn name(self) -> &'static str {
        if matches!(self, Self::Repaired) { "repair" } else { "review" }
    }
}

/// Compares the windows before a date with those after it.
#[must_use]
pub fn compare(before: &[Measured], after: &[Measured], done: Done) -> Outcome {
    let (before, after) = (Side::of(before), Side::of(after));
    let (helped, claim) = judge(&before, &after, done);
    let spread = before.pv_sd.zip(after.pv_sd).filter(|_| helped != Helped::Unknown);
    let spread = spread.map_or_else(String::new, |(from, to)| {
        format!("; the standard deviation of PV was {} and is {}", number(from), number(to))
    });
    Outcome { before, after, helped, words: format!("{claim}{spread}.") }
}

fn judge(before: &Side, after: &Side, done: Done) -> (Helped, String) {
    let date = done.name();
    if done == Done::Nothing {
        return (Helped::Unknown, "The valve was found not to stick, so there is no repair to judge".to_owned());
    }
    for (side, name) in [(before, "before"), (after, "after")] {
        if side.windows < LEAST {
            let why = format!("Too few windows {name} the {date} gave an answer ({} of {LEAST})", side.windows);
            return (Helped::Unknown, why);
        }
    }
    if !before.sticks() {
        let why = format!("Most windows before the {date} find no stiction, so they cannot show whether it helped");
        return (Helped::Unknown, why);
    }
    if after.sticking == 0 {
        let p = |side: &Side| side.p.map_or_else(|| "unknown".to_owned(), probability);
        let (then, now) = (p(before), p(after));
        return (
            Helped::Yes,
            format!("Stiction was seen before the {date} (p {then}) and is not seen since (p {now})"),
        );
    }
    if !after.sticks() {
        let share = |side: &Side| format!("{} of {}", side.sticking, side.windows);
        let (then, now) = (share(before), share(after));
        return (Helped::Partly, format!("{now} windows since the {date} find stiction, before it {then}"));
    }
    match before.s.zip(after.s) {
        Some((from, to)) if to < SMALLER * from => {
            let (from, to) = (number(from), number(to));
            (Helped::Partly, format!("The valve still sticks; s fell from {from} to {to} OP units since the {date}"))
        }
        Some((from, to)) => {
            let (from, to) = (number(from), number(to));
            (Helped::No, format!("The valve still sticks, with s {from} OP units before the {date} and {to} since"))
        }
        None => (Helped::No, "The valve still sticks".to_owned()),
    }
}
