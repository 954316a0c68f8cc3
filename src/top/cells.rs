//! The table's cells as text, for screen and plain text, at every width.

use stiction_core::units::{duration, number};
use stiction_monitor::alarm::State;
use stiction_runtime::overview::Row;

/// Most windows in a sparkline.
pub const SPARK: usize = 10;

/// Drawing capabilities of the terminal.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TerminalStyle {
    /// Whether the terminal shows Unicode.
    pub unicode: bool,
    /// Whether colour is allowed.
    pub colour: bool,
}

impl TerminalStyle {
    /// From the environment: a UTF-8 locale, and no `NO_COLOR`.
    pub fn of_environment() -> Self {
        let said = |name: &str| std::env::var(name).ok().filter(|value| !value.is_empty());
        let locale = said("LC_ALL").or_else(|| said("LC_CTYPE")).or_else(|| said("LANG")).unwrap_or_default();
        let locale = locale.to_ascii_lowercase();
        let dumb = said("TERM").is_some_and(|term| term == "dumb");
        Self {
            unicode: locale.contains("utf-8") || locale.contains("utf8"),
            colour: said("NO_COLOR").is_none() && !dumb,
        }
    }
}

/// What a sparkline shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Figure {
    /// Probability that the valve sticks.
    #[default]
    P,
    /// Dead band plus stick band, OP units.
    S,
}

/// NE 107 category with letter and shape, so that colour is not needed.
#[must_use]
pub fn category(row: &Row, look: TerminalStyle) -> &'static str {
    match (row.ne107, look.unicode) {
        (Some("F"), true) => "F ✖",
        (Some("C"), true) => "C ▼",
        (Some("S"), true) => "S ▲",
        (Some("M"), true) => "M ◆",
        (Some(_), true) => "ok ✓",
        (None, true) => "·",
        (Some("F"), false) => "F x",
        (Some("C"), false) => "C v",
        (Some("S"), false) => "S ^",
        (Some("M"), false) => "M #",
        (Some(_), false) => "ok",
        (None, false) => ".",
    }
}

/// Sort key by severity: alarms first, then failures, then other deviations.
#[must_use]
pub fn severity(row: &Row) -> (u8, u8) {
    let category = match row.ne107 {
        Some("M") => 5,
        Some("F") => 4,
        Some("S") => 3,
        Some("C") => 2,
        None => 1,
        Some(_) => 0,
    };
    let priority = row.priority.map_or(0, |p| 1 + p as u8);
    (category, 2 * priority + u8::from(row.unacknowledged))
}

/// A number with this many decimals, or a dash.
fn places(value: Option<f64>, digits: usize) -> String {
    value.map_or_else(|| "-".to_owned(), |x| format!("{x:.digits$}"))
}

/// A text truncated to this many characters.
#[must_use]
pub fn cut(text: &str, width: usize, look: TerminalStyle) -> String {
    if text.chars().count() <= width {
        return text.to_owned();
    }
    let mark = if look.unicode { "…" } else { "~" };
    let mut short: String = text.chars().take(width.saturating_sub(1)).collect();
    short.push_str(mark);
    short
}

/// One character per window, oldest first; a dot where there is no figure.
#[must_use]
pub fn sparkline(row: &Row, figure: Figure, look: TerminalStyle) -> String {
    const FINE: [char; 8] = ['▁', '▂', '▃', '▄', '▅', '▆', '▇', '█'];
    const COARSE: [char; 4] = ['_', '-', '=', '#'];
    let steps: &[char] = if look.unicode { &FINE } else { &COARSE };
    let of = |window: &stiction_runtime::overview::Recent| match figure {
        Figure::P => window.p,
        Figure::S => window.s,
    };
    let newest = &row.recent[row.recent.len().saturating_sub(SPARK)..];
    let largest = match figure {
        Figure::P => 1.0,
        Figure::S => newest.iter().filter_map(of).fold(0.0, f64::max),
    };
    let sign = |value: Option<f64>| match value {
        Some(v) if largest > 0.0 => {
            let step = (v / largest * steps.len() as f64).clamp(0.0, steps.len() as f64 - 1.0);
            steps[step as usize]
        }
        Some(_) => steps[0],
        None if look.unicode => '·',
        None => '.',
    };
    newest.iter().map(|window| sign(of(window))).collect()
}

/// The verdict in words, or why there is none.
fn short_verdict(row: &Row) -> String {
    match row.verdict {
        _ if row.silent => "no new data".to_owned(),
        Some(verdict) => verdict.name().replace('_', " "),
        None => "no window".to_owned(),
    }
}

/// The age in words; negative if the data are ahead of this machine's clock.
#[must_use]
pub fn age(age_s: Option<f64>) -> String {
    match age_s {
        None => "-".to_owned(),
        Some(s) if s < -1.0 => format!("+{}", brief(-s)),
        Some(s) => brief(s.max(0.0)),
    }
}

/// A duration in about four characters: number and unit.
fn brief(s: f64) -> String {
    match s {
        s if s < 99.5 => format!("{s:.0}s"),
        s if s < 99.5 * 60.0 => format!("{:.0}m", s / 60.0),
        s if s < 99.5 * 3_600.0 => format!("{:.0}h", s / 3_600.0),
        s => format!("{:.0}d", s / 86_400.0),
    }
}

/// A column of the table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Column {
    /// NE 107 category.
    Category,
    /// The loop's name.
    Name,
    /// The verdict, in words if there is room.
    Verdict,
    /// Probability that the valve sticks.
    P,
    /// Dead band plus stick band.
    S,
    /// Its 90 % interval.
    Interval,
    /// Grade of the answer.
    Grade,
    /// Period of the oscillation.
    Period,
    /// State of the alarm.
    Alarm,
    /// Sparkline of the newest windows.
    Recent,
    /// Age of the data.
    Age,
}

/// Narrowest width of a verdict in words; below it the verdict's name is shown.
const IN_WORDS: usize = 28;
/// Narrowest width of a verdict.
const VERDICT: usize = 14;
/// Longest loop name.
const NAME: usize = 28;

/// The columns that fit a width, with their widths; less important ones are dropped first.
#[must_use]
pub fn layout(width: usize, longest_name: usize) -> Vec<(Column, usize)> {
    use Column::{Age, Alarm, Category, Grade, Interval, Name, P, Period, Recent, S, Verdict};
    let name = longest_name.clamp(4, NAME);
    let mut columns = vec![
        (Category, 4),
        (Name, name),
        (Verdict, VERDICT),
        (P, 4),
        (S, 5),
        (Interval, 9),
        (Grade, 1),
        (Period, 8),
        (Alarm, 9),
        (Recent, SPARK),
        (Age, 5),
    ];
    let needed = |columns: &[(Column, usize)]| columns.iter().map(|(_, w)| w + 1).sum::<usize>() - 1;
    for spared in [Age, Grade, Interval, Period, S, Recent, Alarm] {
        if needed(&columns) > width {
            columns.retain(|(column, _)| *column != spared);
        }
    }
    if needed(&columns) > width {
        let over = needed(&columns) - width;
        columns[1].1 = name.saturating_sub(over).max(4);
    }
    let left = width.saturating_sub(needed(&columns));
    if let Some(verdict) = columns.iter_mut().find(|(column, _)| *column == Verdict) {
        verdict.1 += left;
    }
    columns
}

impl Column {
    /// Column heading.
    #[must_use]
    pub const fn head(self, figure: Figure) -> &'static str {
        match self {
            Self::Category => "107",
            Self::Name => "loop",
            Self::Verdict => "verdict",
            Self::P => "p",
            Self::S => "s",
            Self::Interval => "90 %",
            Self::Grade => "g",
            Self::Period => "period",
            Self::Alarm => "alarm",
            Self::Recent => match figure {
                Figure::P => "p trend",
                Figure::S => "s trend",
            },
            Self::Age => "age",
        }
    }

    /// Whether the column is numeric and right-aligned.
    #[must_use]
    pub const fn right(self) -> bool {
        matches!(self, Self::P | Self::S | Self::Period | Self::Age | Self::Interval)
    }

    /// The cell of a loop.
    #[must_use]
    pub fn cell(self, row: &Row, width: usize, figure: Figure, age_s: Option<f64>, look: TerminalStyle) -> String {
        let text = match self {
            Self::Category => category(row, look).to_owned(),
            Self::Name => row.name.clone(),
            Self::Verdict if width >= IN_WORDS => row.status.clone(),
            Self::Verdict => short_verdict(row),
            Self::P => places(row.p_stiction, 2),
            Self::S => row.s.map_or_else(|| "-".to_owned(), number),
            Self::Interval => interval(row.s_interval, width),
            Self::Grade => row.grade.map_or('-', |g| g).to_string(),
            Self::Period => row.period_s.map_or_else(|| "-".to_owned(), duration),
            Self::Alarm => alarm(row.alarm_state).to_owned(),
            Self::Recent => sparkline(row, figure, look),
            Self::Age => age(age_s),
        };
        cut(&text, width, look)
    }
}

/// The interval with as many digits as fit.
fn interval(interval: Option<[f64; 2]>, width: usize) -> String {
    let Some([low, high]) = interval else { return "-".to_owned() };
    let full = format!("{}..{}", number(low), number(high));
    if full.chars().count() <= width { full } else { format!("{low:.1}..{high:.1}") }
}

/// An alarm state in at most nine characters.
#[must_use]
pub const fn alarm(state: State) -> &'static str {
    match state {
        State::Normal => "-",
        State::Unack => "UNACK",
        State::Acked => "acked",
        State::RtnUnack => "rtn unack",
        State::Shelved => "shelved",
        State::Suppressed => "suppress.",
        State::OutOfService => "out",
    }
}
