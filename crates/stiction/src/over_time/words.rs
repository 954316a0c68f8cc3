//! Sentences from the numbers.

use super::window::{History, WindowResult};
use super::{Change, ChangeKind, OverTime, Pooled, Trend};
use crate::core::units::{duration, format_rfc3339, is_date, number, s_from_ns};

/// Below this many independent windows a stretch is called young.
const FEW: f64 = 3.0;

/// All sentences of the report.
pub(super) fn sentences(told: &OverTime, history: &History<'_>) -> Vec<String> {
    if told.windows == 0 {
        return vec!["No window has given an answer yet.".to_owned()];
    }
    let mut out: Vec<String> = told.changes.iter().map(change).collect();
    if out.is_empty() {
        let stretch = history.points.iter().map(|p| (p.result.start_ns, p.result.end_ns));
        let [from, to] = stretch.fold([i64::MAX, i64::MIN], |[f, t], (start, end)| [f.min(start), t.max(end)]);
        let span = duration(s_from_ns(to - from));
        out.push(format!("No change of the valve found in {} over {span}.", windows(told.windows)));
    }
    out.push(told.pooled.as_ref().map_or_else(|| nothing(told, history), |p| pooled(p, told.since_ns)));
    if let Some(p) = &told.pooled {
        out.extend(jump(p));
    }
    out.extend(told.trend.as_ref().map(trend));
    match told.contradicting.len() {
        0 => {}
        1 => out.push("One window contradicts the others of its time: check it before relying on either.".to_owned()),
        n => out.push(format!("{n} windows contradict the others of their time: check them before relying on either.")),
    }
    out
}

/// Why a window whose verdict is the opposite of its stretch's contradicts it.
pub(super) fn opposite(sticks: bool, p: f64, agree: usize, of: usize) -> String {
    let (it, they) = if sticks { ("finds stiction", "find none") } else { ("finds no stiction", "find it") };
    format!("it {it} (calibrated p = {}), while {agree} of the {of} windows of its time {they}", number(p))
}

/// Why a window whose size differs contradicts its stretch.
pub(super) fn off(w: &WindowResult, expected: f64, of: usize) -> String {
    let s = w.s.map_or_else(|| "unknown".to_owned(), number);
    let interval = w.s_interval.map_or_else(String::new, |[l, h]| format!(" ({} to {})", number(l), number(h)));
    let other = number(expected);
    format!(
        "its s of {s}{interval} differs from {other}, the size in the {of} windows of this period, by more than chance explains"
    )
}

/// The reason why a window contradicts, with the checks that limit the window.
pub(super) fn with_gates(why: String, gates: &[String]) -> String {
    if gates.is_empty() { why } else { format!("{why}; it is limited by {}", gates.join(", ")) }
}

fn windows(n: usize) -> String {
    if n == 1 { "one window".to_owned() } else { format!("{n} windows") }
}

/// A date to the minute, or a time on the record's own clock.
fn date(ns: i64) -> String {
    if !is_date(ns) {
        return format!("{} on the record's own clock", duration(s_from_ns(ns)));
    }
    let text = format_rfc3339(ns);
    let minute: String = text.chars().take(16).collect();
    format!("{} UTC", minute.replace('T', " "))
}

fn change(c: &Change) -> String {
    let sized = |s: Option<f64>| s.map_or_else(|| "unknown".to_owned(), number);
    let what = match (c.kind, c.s_before) {
        (ChangeKind::Repaired, None) => "Stiction is no longer detected".to_owned(),
        (ChangeKind::Repaired, Some(s)) => format!("Stiction (s = {} OP units) is no longer detected", number(s)),
        (ChangeKind::Worse, None) => format!("The valve began to stick (s = {} OP units)", sized(c.s_after)),
        (kind, _) => {
            let word = if kind == ChangeKind::Better { "better" } else { "worse" };
            format!("The valve became {word} (s from {} to {} OP units)", sized(c.s_before), sized(c.s_after))
        }
    };
    let sure = match 1.0 - c.p {
        rest if rest < 1e-6 => "practically never by chance".to_owned(),
        rest => format!("such a step occurs by chance in {} % of histories", number(100.0 * rest)),
    };
    let (at, from, to) = (date(c.at_ns), date(c.from_ns), date(c.to_ns));
    if c.kind == ChangeKind::Repaired {
        return format!("{what} since about {at} (between {from} and {to}); {sure}.");
    }
    format!("{what} around {at}, between {from} and {to}; {sure}.")
}

fn pooled(p: &Pooled, since_ns: Option<i64>) -> String {
    let since = since_ns.map_or_else(String::new, |at| format!(" since {}", date(at)));
    let overlap = if p.independent_windows < 0.9 * p.windows as f64 {
        format!(" (overlapping; equivalent to {} independent ones)", number(p.independent_windows))
    } else {
        String::new()
    };
    let [low, high] = p.s_interval.map(number);
    let young = if p.independent_windows < FEW { " Based on few independent windows so far." } else { "" };
    let all = windows(p.windows);
    format!("From {all}{since}{overlap}: s is {} OP units, 90 % interval {low} to {high}.{young}", number(p.s))
}

fn jump(p: &Pooled) -> Option<String> {
    let (j, [low, high]) = (p.j?, p.j_interval?.map(number));
    Some(if p.j_identifiable {
        format!("The slip jump j is {} OP units, 90 % interval {low} to {high}.", number(j))
    } else {
        format!(
            "The slip jump j cannot be determined from these records: most of them allow any value from {low} to {high} OP units."
        )
    })
}

/// Why there is no size since the last change.
fn nothing(told: &OverTime, history: &History<'_>) -> String {
    let since = told.since_ns.unwrap_or(i64::MIN);
    let later: Vec<_> = history.points.iter().filter(|p| p.middle_ns() > since).collect();
    let sticking = later.iter().filter(|p| p.sticks).count();
    let span = told.since_ns.map_or_else(String::new, |at| format!(" since {}", date(at)));
    match sticking {
        0 => format!("No sign of stiction in {}{span}.", windows(later.len())),
        n if 2 * n < later.len() => {
            format!("Stiction found in {n} of {}{span}: too few to call the valve sticking.", windows(later.len()))
        }
        n => format!("Stiction found in {n} of {}{span}, but none gives its size.", windows(later.len())),
    }
}

fn trend(t: &Trend) -> String {
    let word = if t.s_per_month > 0.0 { "grows" } else { "falls" };
    let [a, b] = t.s_per_month_interval.map(f64::abs);
    format!(
        "s {word} by {} OP units per month (90 % interval {} to {}) since {}.",
        number(t.s_per_month.abs()),
        number(a.min(b)),
        number(a.max(b)),
        date(t.since_ns)
    )
}
