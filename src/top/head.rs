//! The lines above the table: daemon, number of loops per verdict, losses, faults.

use ratatui::style::{Color, Modifier, Style};
use ratatui::text::Line;
use serde_json::Value;

use super::board::{LoopTable, Now};
use super::cells::{self, TerminalStyle};
use stiction_core::units::duration;
use stiction_core::verdict::Verdict;

/// Verdicts, worst first.
const VERDICTS: [Verdict; 7] = [
    Verdict::Stiction,
    Verdict::Deadband,
    Verdict::Tuning,
    Verdict::Disturbance,
    Verdict::CauseUnknown,
    Verdict::NotOscillating,
    Verdict::Inconclusive,
];
/// Loss counters.
const LOSSES: [(&str, &str); 4] = [
    ("dropped_input", "messages dropped"),
    ("fits_skipped", "fits skipped"),
    ("dropped_output", "documents not published"),
    ("recording_lost", "messages not recorded"),
];
/// Most faults shown.
const FAULTS: usize = 3;

/// The lines as text; the first of the pair is true for a fault.
#[must_use]
pub fn texts(board: &LoopTable, now: Now) -> Vec<(bool, String)> {
    let mut lines = vec![(false, daemon(board, now)), (false, counts(board)), (false, data(board, now))];
    lines.extend(board.stale(now).map(|text| (true, format!("STALE: {text}"))));
    lines.extend(faults(board).into_iter().map(|text| (true, format!("FAULT: {text}"))));
    lines
}

/// The lines with styles.
#[must_use]
pub fn lines(board: &LoopTable, width: usize, look: TerminalStyle, now: Now) -> Vec<Line<'static>> {
    let fault = Style::new().add_modifier(Modifier::BOLD);
    let fault = if look.colour { fault.fg(Color::Red) } else { fault };
    let drawn = |(index, (wrong, text)): (usize, (bool, String))| {
        let style = match (wrong, index) {
            (true, _) => fault,
            (false, 0) => Style::new().add_modifier(Modifier::BOLD),
            _ => Style::new(),
        };
        Line::styled(cells::cut(&text, width, look), style)
    };
    texts(board, now).into_iter().enumerate().map(drawn).collect()
}

fn daemon(board: &LoopTable, now: Now) -> String {
    let mut here: Vec<_> = board.daemons.iter().filter(|(_, d)| !d.gone).collect();
    here.sort_by_key(|(_, d)| std::cmp::Reverse(d.at));
    let Some((id, heard)) = here.first() else {
        return format!("stictiond  {}  no daemon", board.prefix());
    };
    let more = if here.len() > 1 { format!(" and {} more", here.len() - 1) } else { String::new() };
    let version = heard.health["version"].as_str().unwrap_or("?");
    let up = heard.health["uptime_s"].as_f64().map_or_else(
        || "up ?".to_owned(),
        |s| format!("up {}", duration((s + now.at.saturating_duration_since(heard.at).as_secs_f64()).round())),
    );
    let id: String = id.chars().take(8).collect();
    format!("stictiond {version}  {}  daemon {id}{more}  {up}  {} loops", board.prefix(), board.rows().count())
}

fn counts(board: &LoopTable) -> String {
    let of = |verdict: Verdict| board.rows().filter(|row| row.verdict == Some(verdict)).count();
    let counted = VERDICTS.into_iter().map(|v| (v, of(v))).filter(|(_, n)| *n > 0);
    let mut parts: Vec<String> = counted.map(|(v, n)| format!("{n} {}", v.name().replace('_', " "))).collect();
    let without = board.rows().filter(|row| row.verdict.is_none()).count();
    if without > 0 {
        parts.push(format!("{without} not judged yet"));
    }
    let active = board.rows().filter(|row| row.active).count();
    let waiting = board.rows().filter(|row| row.unacknowledged).count();
    let told = if parts.is_empty() { "no loops yet".to_owned() } else { parts.join(", ") };
    format!("{told}; alarms {active} active, {waiting} to acknowledge")
}

fn data(board: &LoopTable, now: Now) -> String {
    let sum = |of: fn(&stiction_runtime::overview::Row) -> u64| board.rows().map(of).sum::<u64>();
    let silent = board.rows().filter(|row| row.silent).count();
    let aged = board.rows().filter_map(|row| Some((board.age_s(&row.name, now)?, &row.name)));
    let oldest = aged.max_by(|a, b| a.0.total_cmp(&b.0));
    let mut parts = vec![format!("{silent} silent")];
    parts.extend(oldest.map(|(age_s, name)| match cells::age(Some(age_s)).strip_prefix('+') {
        Some(ahead) => format!("all data ahead of this clock by at least {ahead}"),
        None => format!("oldest data {} ({name})", cells::age(Some(age_s))),
    }));
    parts.push(format!("gaps {}, dropped {}", sum(|row| row.data_gaps), sum(|row| row.dropped)));
    let healths = || board.daemons.values().filter(|d| !d.gone).map(|d| &d.health);
    let lost = LOSSES.map(|(name, words)| (healths().filter_map(|h| h["counters"][name].as_u64()).sum::<u64>(), words));
    let lost: Vec<String> = lost.into_iter().filter(|(n, _)| *n > 0).map(|(n, words)| format!("{n} {words}")).collect();
    let lost = if lost.is_empty() { "nothing lost".to_owned() } else { lost.join(", ") };
    format!("data: {}; {lost}", parts.join(", "))
}

fn faults(board: &LoopTable) -> Vec<String> {
    let here = board.daemons.values().filter(|d| !d.gone);
    let all = here.filter_map(|d| d.health["faults"].as_array()).flatten().filter_map(Value::as_str);
    let mut faults: Vec<String> = all.map(str::to_owned).collect();
    let more = faults.len().saturating_sub(FAULTS);
    faults.truncate(FAULTS);
    if let (Some(last), true) = (faults.last_mut(), more > 0) {
        last.push_str(&format!(" (and {more} more)"));
    }
    if board.unread > 0 {
        faults.push(format!(
            "{} documents could not be parsed: from another version, or not from a daemon",
            board.unread
        ));
    }
    faults
}
