//! Parses one cell of a time column without deciding its meaning: 05/01/26 keeps all its readings until the whole column
//! has been seen.

use jiff::civil::{DateTime, Time};
use jiff::fmt::strtime;
use jiff::tz::Offset;

use super::clock::TimeFormat;
use super::zone::{Letters, letters_of, offset_of};
use crate::conventions::{HALF_DAYS, MONTHS, WEEKDAYS, WRITTEN, is_one_of};
use stiction::core::units::NS_PER_S;

/// Nanoseconds in an hour.
pub(super) const HOUR_NS: i64 = 3600 * NS_PER_S;

/// In place of a date that does not exist.
const NO_DATE: i32 = i32::MIN;
const DAY_NS: i64 = 24 * HOUR_NS;

/// A cell of a time column.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Stamp {
    /// A number: seconds, ms, µs, ns or days.
    Number(Number),
    /// A date in figures, and a time of day.
    Civil(Civil),
    /// A local time of an unknown zone, ns as if it were UTC.
    Local(i64),
    /// Nanoseconds since 1970 UTC.
    Instant(i64),
}

/// A number, exact in its decimals.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Number {
    /// Part before the decimal point.
    pub whole: i64,
    /// Billionths, with the sign of the number.
    pub billionths: i64,
    /// Rounded to an integer.
    pub value: f64,
}

/// A date whose fields are not yet identified.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Civil {
    /// Days since 1970 for each order of the fields; [`NO_DATE`] where there is no such date.
    days: [i32; 3],
    /// Whether the month is a word.
    pub named: bool,
    /// Time of day, ns; a full day for 24:00.
    pub clock_ns: i64,
    /// Offset from UTC, s, if given.
    pub offset_s: Option<i32>,
    /// Letters such as CEST after the time.
    pub letters: Option<Letters>,
}

/// Order of the date fields.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Order {
    /// 2026-01-05.
    Ymd,
    /// 05.01.2026, 05-Jan-26.
    Dmy,
    /// 01/05/2026, Jan 5 2026.
    Mdy,
}

impl Order {
    /// Every order.
    pub(super) const ALL: [Self; 3] = [Self::Ymd, Self::Dmy, Self::Mdy];

    /// Its word in --time-format.
    pub(super) const fn word(self) -> &'static str {
        ["ymd", "dmy", "mdy"][self as usize]
    }
}

impl Number {
    /// A number of a typed table.
    pub(super) fn of_f64(value: f64) -> Option<Self> {
        let whole = value.trunc();
        let billionths = ((value - whole) * 1e9).round() as i64;
        (value.abs() < 9e18).then_some(Self { whole: whole as i64, billionths, value })
    }

    /// A whole number.
    pub(super) fn of_i64(value: i64) -> Self {
        Self { whole: value, billionths: 0, value: value as f64 }
    }

    fn read(text: &str) -> Option<Self> {
        let digits = text.strip_prefix(['+', '-']).unwrap_or(text);
        if !digits.starts_with(|c: char| c.is_ascii_digit() || c == '.') {
            return None;
        }
        let value: f64 = text.parse().ok()?;
        if digits.contains(['e', 'E']) {
            return Self::of_f64(value);
        }
        let (whole, fraction) = digits.split_once('.').unwrap_or((digits, ""));
        let whole: i64 = if whole.is_empty() { 0 } else { whole.parse().ok()? };
        let sign = if text.starts_with('-') { -1 } else { 1 };
        Some(Self { whole: sign * whole, billionths: sign * billionths(fraction), value })
    }

    /// This many units of `unit_ns` in ns; `None` on overflow of 64 bits.
    pub(super) fn in_ns(self, unit_ns: i64) -> Option<i64> {
        let ns = i128::from(self.whole) * i128::from(unit_ns)
            + (i128::from(self.billionths) * i128::from(unit_ns)).div_euclid(1_000_000_000);
        i64::try_from(ns).ok()
    }
}

/// Figures behind a decimal point. A tenth one rounds half up, as in the program's own tables.
fn billionths(fraction: &str) -> i64 {
    let digit = |at: usize| i64::from(fraction.as_bytes().get(at).map_or(0, |d| d.wrapping_sub(b'0')));
    (0..9).fold(0, |sum, at| 10 * sum + digit(at)) + i64::from(digit(9) >= 5)
}

impl Stamp {
    /// Parses a text by a format, if one is asked for; `None` if it is not a time.
    pub(super) fn by(form: Option<&TimeFormat>, text: &str) -> Option<Self> {
        let Some(TimeFormat::Pattern(pattern)) = form else { return Self::read(text) };
        let parsed = strtime::parse(pattern, text).ok()?;
        if parsed.offset().is_some() {
            return i64::try_from(parsed.to_timestamp().ok()?.as_nanosecond()).ok().map(Self::Instant);
        }
        let midnight = || parsed.to_date().map(|date| date.to_datetime(Time::midnight()));
        local_ns(parsed.to_datetime().or_else(|_| midnight()).ok()?).map(Self::Local)
    }

    /// Parses a text; `None` if it is not a time.
    pub(super) fn read(text: &str) -> Option<Self> {
        let text = text.trim().trim_matches('\'');
        if text.is_empty() || text.len() > 64 {
            return None;
        }
        // yyyymmddhhmmss is no number of anything else since 1990.
        if text.len() == 14
            && text.bytes().all(|b| b.is_ascii_digit())
            && let Some(civil) = civil(&format!("{} {}", &text[..8], &text[8..]))
        {
            return Some(Self::Civil(civil));
        }
        let decimals = || text.split_once(',').filter(|(_, rest)| rest.bytes().all(|b| b.is_ascii_digit()));
        let comma = || decimals().and_then(|(whole, rest)| Number::read(&format!("{whole}.{rest}")));
        Number::read(text).or_else(comma).map(Self::Number).or_else(|| civil(text).map(Self::Civil))
    }

    /// Whether it is a written date.
    pub(super) const fn is_dated(self) -> bool {
        !matches!(self, Self::Number(_))
    }
}

/// ns since 1970 as if a local time were UTC.
pub(super) fn local_ns(time: DateTime) -> Option<i64> {
    i64::try_from(Offset::UTC.to_timestamp(time).ok()?.as_nanosecond()).ok()
}

/// A leading part of a text, and the rest.
fn take(text: &str, part: impl Fn(char) -> bool) -> (&str, &str) {
    text.split_at(text.find(|c| !part(c)).unwrap_or(text.len()))
}

/// A month by its English letters; a field in figures as it is.
fn field(word: &str) -> Option<(&str, bool)> {
    if (1..=4).contains(&word.len()) && word.bytes().all(|b| b.is_ascii_digit()) {
        return Some((word, false));
    }
    let lower = word.to_lowercase();
    MONTHS.iter().find(|names| names.iter().any(|name| lower.starts_with(name))).map(|names| (names[0], true))
}

/// The text without the name of the day before it; the year stands behind the time as Java and C write it.
fn in_order(text: &str) -> String {
    let (word, rest) = take(text, char::is_alphabetic);
    let is_day = word.len() >= 3 && is_one_of(&word.to_lowercase().chars().take(3).collect::<String>(), WEEKDAYS);
    let text = if is_day { rest.trim_start_matches([',', ' ', '.']) } else { text };
    let mut words = text.splitn(3, ' ');
    let late =
        |rest: &str| rest.rsplit_once(' ').is_some_and(|(_, y)| y.len() == 4 && y.bytes().all(|b| b.is_ascii_digit()));
    match (words.next(), words.next(), words.next()) {
        (Some(month), Some(day), Some(rest)) if is_day && rest.contains(':') && late(rest) => {
            let (clock, year) = rest.rsplit_once(' ').unwrap_or_default();
            format!("{month} {day} {year} {clock}")
        }
        _ => text.to_owned(),
    }
}

fn civil(text: &str) -> Option<Civil> {
    let text = in_order(text);
    let (head, rest) = take(&text, |c| c.is_ascii_digit());
    let (date, named, rest) = if head.len() == 8 {
        (format!("{}-{}-{}", &head[..4], &head[4..6], &head[6..]), false, rest)
    } else {
        let word = |t| take(t, |c: char| c.is_alphanumeric());
        let (first, rest) = word(&text);
        let (gap, rest) = take(rest, |c| "-/., ".contains(c));
        let (second, rest) = word(rest);
        let (other_gap, rest) = take(rest, |c| "-/., ".contains(c));
        let (third, rest) = take(rest, |c| c.is_ascii_digit());
        let ((a, named), (b, by_name), (c, _)) = (field(first)?, field(second)?, field(third)?);
        let named = named || by_name;
        let alike = gap.trim_end() == other_gap.trim_end() && !gap.trim().is_empty();
        if gap.is_empty() || other_gap.is_empty() || !(alike || named) {
            return None;
        }
        let joint = if gap.starts_with('.') && !named { '.' } else { '-' };
        (format!("{a}{joint}{b}{joint}{c}"), named, rest)
    };
    let (clock_ns, rest) = behind_date(rest, date.split('-').any(|field| field.len() == 4))?;
    // A form that cannot fit is not tried: a file has a million dates.
    let year_first = date.split(['-', '.']).next().is_some_and(|first| first.len() == 4);
    let fits = |form: &&str| form.contains("%b") == named && form.starts_with("%Y") == year_first;
    let reading = |forms: &str| {
        let forms = forms.split('|').filter(fits);
        let dates = forms.filter_map(|form| strtime::parse(form, &date).ok()?.to_date().ok());
        let midnight =
            dates.filter(|date| date.year() >= 1000).map(|date| date.to_datetime(Time::midnight())).next()?;
        let midnight_ns = local_ns(midnight)?;
        midnight_ns.checked_add(clock_ns).and_then(|_| i32::try_from(midnight_ns / DAY_NS).ok())
    };
    let days = WRITTEN.map(|forms| reading(forms).unwrap_or(NO_DATE));
    let mut civil = Civil { days, named, clock_ns, ..Civil::default() };
    civil.take_zone(rest.trim())?;
    days.iter().any(|day| *day != NO_DATE).then_some(civil)
}

/// Parses the time of day after a date, ns, and returns the rest. AM and PM, in any language, may come before or after it.
fn behind_date(text: &str, long: bool) -> Option<(i64, &str)> {
    let (joint, rest) = take(text, |c| " \u{a0},_".contains(c));
    let tight = |text: &'_ str| text.starts_with(|c: char| c.is_ascii_digit());
    // Web servers write a colon behind the year.
    let joined = rest.strip_prefix(['T', 't']).or_else(|| rest.strip_prefix(':').filter(|_| long));
    let rest = if joint.is_empty() { joined.filter(|r| tight(r)).unwrap_or(rest) } else { rest };
    if rest.is_empty() {
        return Some((0, rest));
    }
    let (before, rest) = half_day(rest).unwrap_or((None, rest));
    let (mut ns, rest) = clock(rest)?;
    let (behind, rest) = half_day(rest).unwrap_or((None, rest));
    if let Some(afternoon) = before.or(behind) {
        if !(1..=12).contains(&(ns / HOUR_NS)) {
            return None;
        }
        ns = ns % (12 * HOUR_NS) + if afternoon { 12 * HOUR_NS } else { 0 };
    }
    Some((ns, rest))
}

/// Whether a word for a half of the day, at the start, is one of the afternoon; and the rest.
fn half_day(text: &str) -> Option<(Option<bool>, &str)> {
    let (words, _) = take(text, |c| c.is_alphabetic() || ". \u{a0}\u{202f}\u{3000}".contains(c));
    let first = words.trim_start().find(' ').map_or(words.len(), |at| words.len() - words.trim_start().len() + at);
    [words.len(), first].into_iter().find_map(|end| {
        let word: String = words[..end].to_lowercase().chars().filter(|c| c.is_alphabetic()).collect();
        let half = HALF_DAYS.iter().find(|(am, pm)| word == *am || word == *pm)?;
        Some((Some(half.1 == word), &text[end..]))
    })
}

/// `8:00`, `08:00:00.5`, `08.00.00`, `080000` in ns, and what follows.
fn clock(text: &str) -> Option<(i64, &str)> {
    let (figures, rest) = take(text, |c| c.is_ascii_digit() || ":.,".contains(c));
    let plain = figures.len() >= 6 && figures.as_bytes()[..6].iter().all(u8::is_ascii_digit);
    let joined =
        if plain { format!("{}:{}:{}", &figures[..2], &figures[2..4], &figures[4..]) } else { figures.to_owned() };
    let mark = joined.chars().find(|c| *c == ':' || *c == '.')?;
    let mut parts = joined.splitn(3, mark);
    let short = |part: &str| part.parse::<i64>().ok().filter(|_| part.len() <= 2);
    let (hour, minute) = (short(parts.next()?)?, short(parts.next()?)?);
    let (second, fraction) =
        parts.next().map_or(("0", "0"), |last| last.split_once([':', '.', ',']).unwrap_or((last, "0")));
    let second = short(second)?;
    let ns = ((hour * 60 + minute) * 60 + second) * NS_PER_S + billionths(fraction);
    let whole = !fraction.is_empty() && fraction.bytes().all(|b| b.is_ascii_digit());
    (whole && minute < 60 && second < 60 && ns <= 24 * HOUR_NS).then_some((ns, rest))
}

/// Whether a text is a time of day alone.
pub(super) fn is_clock(text: &str) -> bool {
    text.contains(':') && Stamp::read(text).is_none() && Stamp::read(&format!("2000-01-01 {text}")).is_some()
}

impl Civil {
    /// Parses `Z`, `+01:00`, `UTC`, `CEST`, and `[Europe/Berlin]` after an offset.
    fn take_zone(&mut self, text: &str) -> Option<()> {
        let text = text.find('[').filter(|at| *at > 0 && text.ends_with(']')).map_or(text, |at| text[..at].trim_end());
        if text.is_empty() {
            return Some(());
        }
        if let Some(offset) = offset_of(text) {
            self.offset_s = Some(offset.seconds());
            return Some(());
        }
        let fits = (2..=5).contains(&text.len()) && text.bytes().all(|b| b.is_ascii_alphabetic());
        self.letters = fits.then(|| letters_of(&text.to_ascii_uppercase()));
        self.letters.map(|_| ())
    }

    /// The local time for an order of the fields, ns as if it were UTC.
    pub(super) const fn local_ns(self, order: Order) -> Option<i64> {
        match self.days[order as usize] {
            NO_DATE => None,
            day => Some(day as i64 * DAY_NS + self.clock_ns),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use stiction::core::units::format_rfc3339;

    fn orders(text: &str) -> Vec<(&'static str, String)> {
        let Some(Stamp::Civil(civil)) = Stamp::read(text) else { panic!("{text}: {:?}", Stamp::read(text)) };
        let read = |o: &Order| civil.local_ns(*o).map(|ns| (o.word(), format_rfc3339(ns)));
        Order::ALL.iter().filter_map(read).collect()
    }

    #[test]
    fn dates_keep_all_their_readings() {
        for (text, order, stamp) in [
            ("05-Jan-26 08:00:00", "dmy", "2026-01-05T08:00:00Z"),
            ("5-JAN-2026 8:00:00.5", "dmy", "2026-01-05T08:00:00.5Z"),
            ("05-Dez-26 08:00", "dmy", "2026-12-05T08:00:00Z"),
            ("05.01.2026 08:00:00,25", "dmy", "2026-01-05T08:00:00.25Z"),
            ("05.01.26", "dmy", "2026-01-05T00:00:00Z"),
            ("2026-01-05T08:00:00", "ymd", "2026-01-05T08:00:00Z"),
            ("2026/1/5 24:00:00", "ymd", "2026-01-06T00:00:00Z"),
            ("20260105080000", "ymd", "2026-01-05T08:00:00Z"),
            ("20260105T080000Z", "ymd", "2026-01-05T08:00:00Z"),
            ("Jan 5, 2026 8:00:00 PM", "mdy", "2026-01-05T20:00:00Z"),
            ("1/25/2026 12:00:00 am", "mdy", "2026-01-25T00:00:00Z"),
            ("25/1/2026 12:30 p.m.", "dmy", "2026-01-25T12:30:00Z"),
            ("05-JAN-26 08.00.00.500000 PM", "dmy", "2026-01-05T20:00:00.5Z"),
            ("05 juillet 2026 08:00", "dmy", "2026-07-05T08:00:00Z"),
            ("25.01.2026 08:00:00 nachm.", "dmy", "2026-01-25T20:00:00Z"),
            ("25/1/2026 12:00:00 a. m.", "dmy", "2026-01-25T00:00:00Z"),
            ("2026/1/25 下午 8:00:00", "ymd", "2026-01-25T20:00:00Z"),
            ("2026-01-25 오후 8:00:00", "ymd", "2026-01-25T20:00:00Z"),
            ("25/1/2026 8:00:00 μ.μ.", "dmy", "2026-01-25T20:00:00Z"),
            ("Mon Jan 05 08:00:00 UTC 2026", "mdy", "2026-01-05T08:00:00Z"),
            ("05/Jan/2026:08:00:00", "dmy", "2026-01-05T08:00:00Z"),
        ] {
            assert_eq!(orders(text), [(order, stamp.to_owned())], "{text}");
        }
        assert_eq!(orders("05/01/2026 08:00").len(), 2);
        assert_eq!(orders("05/01/26 08:00").len(), 3);
        let Some(Stamp::Civil(zoned)) = Stamp::read("2026-01-05 08:00:00 +01:00[Europe/Berlin]") else { panic!() };
        assert_eq!(zoned.offset_s, Some(3600));
        let Some(Stamp::Civil(named)) = Stamp::read("05-Jan-26 08:00:00 CET") else { panic!() };
        assert_eq!(named.letters, Some(*b"CET\0\0"));
        for text in [
            "",
            "08:00:00",
            "2026-13-05 08:00",
            "31.02.2026",
            "Bad Input",
            "1/5/2026 13:00 PM",
            "5 6 7",
            "FIC-101",
            "05-Jan 08:00:00",
            "2016-12-31 23:59:60",
            "5.1.2026 8:00.5",
        ] {
            assert_eq!(Stamp::read(text), None, "{text}");
        }
    }

    #[test]
    fn numbers_are_exact() {
        let ns = |text: &str, unit| match Stamp::read(text) {
            Some(Stamp::Number(n)) => n.in_ns(unit),
            other => panic!("{text}: {other:?}"),
        };
        assert_eq!(ns("1767600000.123456789", NS_PER_S), Some(1_767_600_000_123_456_789));
        assert_eq!(ns("1767600000123456789", 1), Some(1_767_600_000_123_456_789));
        assert_eq!(ns("1767600000,5", NS_PER_S), Some(1_767_600_000_500_000_000));
        assert_eq!(ns("99999999999999", NS_PER_S), None);
    }

    proptest! {
        #[test]
        fn no_text_panics(text in "[0-9A-Za-zäû:/.,+\\- \\[\\]]{0,40}") {
            if let Some(Stamp::Civil(civil)) = Stamp::read(&text) {
                let _ = Order::ALL.map(|o| civil.local_ns(o));
            }
        }
    }
}
