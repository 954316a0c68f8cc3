//! The table's cells as text: the same on a screen, in plain text, and at every width.

use stiction::units::{duration, number};
use stiction_monitor::alarm::State;
use stictiond::daemon::overview::Row;

/// Windows that a sparkline shows at most.
pub const SPARK: usize = 10;

/// What may be drawn with.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Look {
    /// Whether the terminal shows more than ASCII.
    pub unicode: bool,
    /// Whether it may be coloured.
    pub colour: bool,
}

impl Look {
    /// As the environment says: a locale of UTF-8, and no `NO_COLOR`.
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

/// What a sparkline is of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Figure {
    /// Probability that the valve sticks.
    #[default]
    P,
    /// Dead band plus stick band, OP units.
    S,
}

/// Category of NE 107 with its shape: the letter and the shape say without colour what it is.
#[must_use]
pub fn category(row: &Row, look: Look) -> &'static str {
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

/// A place of a sort by severity: an alarm first, then what fails, then what is not as it should be.
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

/// A number with so many places, or a dash.
fn places(value: Option<f64>, digits: usize) -> String {
    value.map_or_else(|| "-".to_owned(), |x| format!("{x:.digits$}"))
}

/// A text of at most so many characters, cut where it is longer.
#[must_use]
pub fn cut(text: &str, width: usize, look: Look) -> String {
    if text.chars().count() <= width {
        return text.to_owned();
    }
    let mark = if look.unicode { "…" } else { "~" };
    let mut short: String = text.chars().take(width.saturating_sub(1)).collect();
    short.push_str(mark);
    short
}

/// One character for each of the newest windows, oldest first; a dot where it has no figure.
#[must_use]
pub fn sparkline(row: &Row, figure: Figure, look: Look) -> String {
    const FINE: [char; 8] = ['▁', '▂', '▃', '▄', '▅', '▆', '▇', '█'];
    const COARSE: [char; 4] = ['_', '-', '=', '#'];
    let steps: &[char] = if look.unicode { &FINE } else { &COARSE };
    let of = |window: &stictiond::daemon::overview::Recent| match figure {
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

/// A verdict's word with spaces, or why there is none.
fn short_verdict(row: &Row) -> String {
    match row.verdict {
        _ if row.silent => "no new data".to_owned(),
        Some(verdict) => verdict.name().replace('_', " "),
        None => "no window".to_owned(),
    }
}

/// Age as people say it; data may be ahead of this machine's clock.
#[must_use]
pub fn age(age_s: Option<f64>) -> String {
    match age_s {
        None => "-".to_owned(),
        Some(s) if s < -1.0 => format!("+{}", brief(-s)),
        Some(s) => brief(s.max(0.0)),
    }
}

/// A time in at most four characters or so: a number and a letter.
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
    /// Category of NE 107.
    Category,
    /// The loop's name.
    Name,
    /// The verdict: in words where there is room.
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
    /// The newest windows.
    Recent,
    /// Age of the data.
    Age,
}

/// Narrowest verdict in words; below it stands the verdict's name.
const IN_WORDS: usize = 28;
/// Narrowest verdict.
const VERDICT: usize = 14;
/// Names are cut beyond this.
const NAME: usize = 28;

/// The columns that fit a width, with their widths; what can be spared goes first where it is narrow.
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
    /// What stands above it.
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
                Figure::P => "p before",
                Figure::S => "s before",
            },
            Self::Age => "age",
        }
    }

    /// Whether it is a number, which stands to the right.
    #[must_use]
    pub const fn right(self) -> bool {
        matches!(self, Self::P | Self::S | Self::Period | Self::Age | Self::Interval)
    }

    /// A loop's cell.
    #[must_use]
    pub fn cell(self, row: &Row, width: usize, figure: Figure, age_s: Option<f64>, look: Look) -> String {
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

/// The interval with as many digits as there is room for.
fn interval(interval: Option<[f64; 2]>, width: usize) -> String {
    let Some([low, high]) = interval else { return "-".to_owned() };
    let full = format!("{}..{}", number(low), number(high));
    if full.chars().count() <= width { full } else { format!("{low:.1}..{high:.1}") }
}

/// A state of the alarm, in at most nine characters.
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
