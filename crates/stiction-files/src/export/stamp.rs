//! Parses one cell of a time column without deciding its meaning: 05/01/26 keeps all its readings until the whole column
//! has been seen.

use std::borrow::Cow;

use jiff::civil::Date;
use jiff::tz::Offset;

use crate::conventions::{HALF_DAYS, MONTHS};
use stiction::core::units::NS_PER_S;

/// Nanoseconds in an hour.
pub(super) const HOUR_NS: i64 = 3600 * NS_PER_S;

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
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Civil {
    fields: [Field; 3],
    separator: u8,
    /// Time of day, ns; a full day for 24:00.
    pub clock_ns: i64,
    /// Offset from UTC, s, if given.
    pub offset_s: Option<i32>,
    /// Letters such as CEST after the time.
    pub zone: Option<[u8; 5]>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
struct Field {
    value: i16,
    digits: u8,
    named: bool,
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
        match self {
            Self::Ymd => "ymd",
            Self::Dmy => "dmy",
            Self::Mdy => "mdy",
        }
    }
}

fn month(word: &str) -> Option<i16> {
    let lower = word.trim_end_matches('.').to_lowercase();
    if lower.chars().count() < 3 {
        return None;
    }
    // "juin" and "juil" share their first three letters with nothing else here, but not with each other.
    let exact = ["juin", "juil"].iter().position(|m| lower.starts_with(m));
    if let Some(at) = exact {
        return Some(6 + at as i16);
    }
    MONTHS.iter().position(|names| names.iter().any(|n| lower.starts_with(n))).map(|at| at as i16 + 1)
}

impl Number {
    /// A number of a typed table.
    pub(super) fn of_f64(value: f64) -> Option<Self> {
        if !value.is_finite() || value.abs() >= 9e18 {
            return None;
        }
        let whole = value.trunc();
        Some(Self { whole: whole as i64, billionths: ((value - whole) * 1e9).round() as i64, value })
    }

    /// A whole number.
    pub(super) fn of_i64(value: i64) -> Self {
        Self { whole: value, billionths: 0, value: value as f64 }
    }

    fn read(text: &str) -> Option<Self> {
        let digits = text.trim_start_matches(['+', '-']);
        if digits.is_empty()
            || text.len() > digits.len() + 1
            || !digits.starts_with(|c: char| c.is_ascii_digit() || c == '.')
        {
            return None;
        }
        let value: f64 = text.parse().ok().filter(|v: &f64| v.is_finite())?;
        if digits.contains(['e', 'E']) {
            return Self::of_f64(value);
        }
        let (whole, fraction) = digits.split_once('.').unwrap_or((digits, ""));
        let whole: i64 = if whole.is_empty() { 0 } else { whole.parse().ok()? };
        let mut billionths = 0;
        for (place, digit) in fraction.bytes().take(9).enumerate() {
            billionths += i64::from(digit.wrapping_sub(b'0')) * 10_i64.pow(8 - place as u32);
        }
        // A tenth digit rounds half up, as in the program's own tables.
        billionths += i64::from(fraction.as_bytes().get(9).is_some_and(|d| *d >= b'5'));
        let sign = if text.starts_with('-') { -1 } else { 1 };
        Some(Self { whole: sign * whole, billionths: sign * billionths, value })
    }

    /// This many units of `unit_ns` in ns; `None` on overflow of 64 bits.
    pub(super) fn in_ns(self, unit_ns: i64) -> Option<i64> {
        let ns = i128::from(self.whole) * i128::from(unit_ns)
            + (i128::from(self.billionths) * i128::from(unit_ns)).div_euclid(1_000_000_000);
        i64::try_from(ns).ok()
    }
}

impl Stamp {
    /// Parses a text; `None` if it is not a time.
    pub(super) fn read(text: &str) -> Option<Self> {
        let text = text.trim().trim_matches('\'');
        if text.is_empty() || text.len() > 64 {
            return None;
        }
        if let Some(number) = Number::read(text) {
            // yyyymmddhhmmss is no number of anything else since 1990.
            let figures = text.len() == 14 && text.bytes().all(|b| b.is_ascii_digit());
            if let Some(civil) = figures.then(|| compact(text)).flatten() {
                return Some(Self::Civil(civil));
            }
            return Some(Self::Number(number));
        }
        if let Some(number) = decimal_comma(text) {
            return Some(Self::Number(number));
        }
        civil(text).map(Self::Civil)
    }

    /// Whether it is a written date.
    pub(super) const fn is_dated(self) -> bool {
        !matches!(self, Self::Number(_))
    }
}

fn decimal_comma(text: &str) -> Option<Number> {
    let (whole, fraction) = text.split_once(',')?;
    let digits = |s: &str| !s.is_empty() && s.bytes().all(|b| b.is_ascii_digit());
    (digits(whole) && digits(fraction)).then(|| Number::read(&format!("{whole}.{fraction}"))).flatten()
}

/// yyyymmdd\[hhmmss\].
fn compact(text: &str) -> Option<Civil> {
    let part = |from: usize, to: usize| text.get(from..to)?.parse::<i16>().ok();
    let field = |value, digits| Field { value, digits, named: false };
    let fields = [field(part(0, 4)?, 4), field(part(4, 6)?, 2), field(part(6, 8)?, 2)];
    let clock_ns = match text.len() {
        8 => 0,
        14 => clock(part(8, 10)?, part(10, 12)?, part(12, 14)?, 0)?,
        _ => return None,
    };
    let civil = Civil { fields, separator: b'-', clock_ns, offset_s: None, zone: None };
    civil.date(Order::Ymd).is_some().then_some(civil)
}

fn clock(hour: i16, minute: i16, second: i16, fraction_ns: i64) -> Option<i64> {
    let within = (0..60).contains(&minute) && (0..60).contains(&second);
    let last = hour == 24 && minute == 0 && second == 0 && fraction_ns == 0;
    (within && ((0..24).contains(&hour) || last))
        .then(|| ((i64::from(hour) * 60 + i64::from(minute)) * 60 + i64::from(second)) * NS_PER_S + fraction_ns)
}

/// A leading part of a text, and the rest.
fn take(text: &str, part: impl Fn(char) -> bool) -> (&str, &str) {
    text.split_at(text.find(|c| !part(c)).unwrap_or(text.len()))
}

fn field(word: &str) -> Option<Field> {
    if word.bytes().all(|b| b.is_ascii_digit()) && (1..=4).contains(&word.len()) {
        return Some(Field { value: word.parse().ok()?, digits: word.len() as u8, named: false });
    }
    month(word).map(|value| Field { value, digits: 0, named: true })
}

/// A time with AM or PM for such words of any language, which stand behind or before the time of day.
fn in_english(text: &str) -> Cow<'_, str> {
    let plain = |c: char| c.is_ascii_digit() || " -/.:,+TZ".contains(c);
    let letters = |c: char| c.is_alphabetic() || ". \u{a0}\u{202f}\u{3000}".contains(c);
    if text.chars().all(plain) || !text.contains(':') {
        return text.into();
    }
    // AM, PM and their like are next to the time of day, before the hour or after the last digit.
    let colon = text.find(':').unwrap_or(0);
    let hour = text[..colon].trim_end_matches(|c: char| c.is_ascii_digit()).len();
    let before = text[..hour].trim_end_matches(letters).len();
    let last = text.rfind(|c: char| c.is_ascii_digit()).map_or(text.len(), |at| at + 1);
    let half = |word: &str| {
        let word: String = word.to_lowercase().chars().filter(|c| c.is_alphabetic()).collect();
        let found =
            HALF_DAYS.iter().find_map(|(am, pm)| [(am, "AM"), (pm, "PM")].into_iter().find(|(w, _)| **w == word));
        found.map(|(_, english)| english)
    };
    if let Some(half) = half(&text[last..]) {
        return format!("{} {half}", &text[..last]).into();
    }
    match half(&text[before..hour]) {
        Some(half) => format!("{} {} {half}", &text[..before], &text[hour..]).into(),
        None => text.into(),
    }
}

fn civil(text: &str) -> Option<Civil> {
    let text = in_english(text);
    let text = without_weekday(&text);
    let (head, rest) = take(text, |c| c.is_ascii_digit());
    let (fields, separator, rest) = if head.len() == 8 {
        (compact(head)?.fields, b'-', rest)
    } else {
        let word = |t| take(t, |c: char| c.is_alphanumeric());
        let (first, rest) = word(text);
        let (gap, rest) = take(rest, |c| "-/., ".contains(c));
        let (second, rest) = word(rest);
        let (other_gap, rest) = take(rest, |c| "-/., ".contains(c));
        let (third, rest) = take(rest, |c| c.is_ascii_digit());
        let separator = *gap.trim().as_bytes().first().unwrap_or(&b' ');
        let same = gap.trim_end() == other_gap.trim_end();
        let fields = [field(first)?, field(second)?, field(third)?];
        let named = fields.iter().any(|f| f.named);
        if gap.is_empty() || other_gap.is_empty() || (!same && !named) || (separator == b' ' && !named) {
            return None;
        }
        (fields, separator, rest)
    };
    let (joint, rest) = take(rest, |c| c == ' ' || c == '\u{a0}' || c == ',' || c == '_');
    let rest = if joint.is_empty() { rest.strip_prefix(['T', 't', ':']).unwrap_or(rest) } else { rest };
    let mut civil = Civil { fields, separator, clock_ns: 0, offset_s: None, zone: None };
    if rest.is_empty() {
        return Some(civil);
    }
    let rest = civil.take_clock(rest)?;
    civil.take_zone(rest.trim())?;
    Some(civil)
}

fn without_weekday(text: &str) -> &str {
    let (word, rest) = take(text, char::is_alphabetic);
    let days = ["mon", "tue", "wed", "thu", "fri", "sat", "sun"];
    let is_day = days.iter().any(|d| word.to_lowercase().starts_with(d)) && month(word).is_none();
    if is_day { rest.trim_start_matches([',', ' ', '.']) } else { text }
}

impl Civil {
    /// Parses `8:00:00.5 PM` and similar.
    fn take_clock<'t>(&mut self, text: &'t str) -> Option<&'t str> {
        let digits = |t: &'t str| take(t, |c| c.is_ascii_digit());
        let (head, mut rest) = digits(text);
        let (mut parts, mut fraction_ns) = ([0_i16; 3], 0);
        if head.len() == 6 {
            for (at, part) in parts.iter_mut().enumerate() {
                *part = head[2 * at..2 * at + 2].parse().ok()?;
            }
        } else {
            parts[0] = short(head)?;
            let separator = rest.chars().next().filter(|c| *c == ':' || *c == '.')?;
            let (minute, after) = digits(&rest[1..]);
            parts[1] = short(minute)?;
            rest = after;
            if let Some(after) = rest.strip_prefix(separator) {
                let (second, after) = digits(after);
                (parts[2], rest) = (short(second)?, after);
            }
        }
        if let Some(after) = rest.strip_prefix(['.', ',', ':']) {
            let (figures, after) = digits(after);
            if figures.is_empty() {
                return None;
            }
            for (place, digit) in figures.bytes().take(9).enumerate() {
                fraction_ns += i64::from(digit - b'0') * 10_i64.pow(8 - place as u32);
            }
            rest = after;
        }
        let (word, after) = take(rest.trim_start(), |c| c.is_ascii_alphabetic() || c == '.');
        let half = match word.to_ascii_lowercase().replace('.', "").as_str() {
            "am" => Some(0),
            "pm" => Some(12),
            _ => None,
        };
        if let Some(half) = half {
            if !(1..=12).contains(&parts[0]) {
                return None;
            }
            (parts[0], rest) = (parts[0] % 12 + half, after);
        }
        self.clock_ns = clock(parts[0], parts[1], parts[2], fraction_ns)?;
        Some(rest)
    }

    /// Parses `Z`, `+01:00`, `UTC`, `CEST`, and `[Europe/Berlin]` after an offset.
    fn take_zone(&mut self, text: &str) -> Option<()> {
        let text = match (text.find('['), text.ends_with(']')) {
            (Some(at), true) if at > 0 => text[..at].trim_end(),
            _ => text,
        };
        let signed = text.strip_prefix("UTC").or_else(|| text.strip_prefix("GMT")).unwrap_or(text).trim_start();
        if text.is_empty() {
            return Some(());
        }
        if signed.is_empty() || text == "Z" || text == "z" {
            self.offset_s = Some(0);
            return Some(());
        }
        if let Some(figures) = signed.strip_prefix(['+', '-']) {
            let plain = figures.replace(':', "");
            let (hours, minutes) = plain.split_at_checked(2).unwrap_or((&plain, ""));
            let hours: i32 = hours.parse().ok().filter(|h| (0..=15).contains(h))?;
            let minutes: i32 =
                if minutes.is_empty() { 0 } else { minutes.parse().ok().filter(|m| (0..60).contains(m))? };
            let sign = if signed.starts_with('-') { -1 } else { 1 };
            self.offset_s = Some(sign * (hours * 3600 + minutes * 60));
            return Some(());
        }
        if (2..=5).contains(&text.len()) && text.bytes().all(|b| b.is_ascii_alphabetic()) {
            let mut letters = [0; 5];
            letters[..text.len()].copy_from_slice(text.to_ascii_uppercase().as_bytes());
            self.zone = Some(letters);
            return Some(());
        }
        None
    }

    /// The date for an order of its fields; `None` if there is no such date.
    pub(super) fn date(self, order: Order) -> Option<Date> {
        let [a, b, c] = self.fields;
        let (y, m, d) = match order {
            Order::Ymd => (a, b, c),
            Order::Dmy => (c, b, a),
            Order::Mdy => (c, a, b),
        };
        let named = self.fields.iter().any(|f| f.named);
        let two = named && a.digits <= 2 && c.digits == 2;
        let readable = !y.named
            && !d.named
            && (y.digits == 2 || y.digits == 4)
            && d.digits <= 2
            && (m.named || m.digits <= 2)
            && m.named == named
            // 05.01.26 and 05-Jan-26 have the day first wherever they are written.
            && !(order != Order::Dmy && y.digits == 2 && two && b.named)
            && !(self.separator == b'.' && y.digits == 2 && order != Order::Dmy)
            && !(self.separator == b'.' && order == Order::Mdy && !named);
        if !readable {
            return None;
        }
        let year = match (y.digits, y.value) {
            (4, year) => year,
            (_, year) if year >= 70 => 1900 + year,
            (_, year) => 2000 + year,
        };
        Date::new(year, i8::try_from(m.value).ok()?, i8::try_from(d.value).ok()?).ok()
    }

    /// The local time for an order of the fields, ns as if it were UTC.
    pub(super) fn local_ns(self, order: Order) -> Option<i64> {
        let midnight = self.date(order)?.to_datetime(jiff::civil::Time::midnight());
        let ns = Offset::UTC.to_timestamp(midnight).ok()?.as_nanosecond();
        i64::try_from(ns).ok()?.checked_add(self.clock_ns)
    }

    /// Whether two have the same written date.
    pub(super) fn same_date(self, other: Self) -> bool {
        self.fields == other.fields
    }

    /// Whether the month is a word.
    pub(super) fn has_named_month(self) -> bool {
        self.fields.iter().any(|f| f.named)
    }
}

fn short(word: &str) -> Option<i16> {
    if word.is_empty() || word.len() > 2 { None } else { word.parse().ok() }
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
        ] {
            assert_eq!(orders(text), [(order, stamp.to_owned())], "{text}");
        }
        assert_eq!(orders("05/01/2026 08:00").len(), 2);
        assert_eq!(orders("05/01/26 08:00").len(), 3);
        let Some(Stamp::Civil(zoned)) = Stamp::read("2026-01-05 08:00:00 +01:00[Europe/Berlin]") else { panic!() };
        assert_eq!(zoned.offset_s, Some(3600));
        let Some(Stamp::Civil(named)) = Stamp::read("05-Jan-26 08:00:00 CET") else { panic!() };
        assert_eq!(named.zone, Some(*b"CET\0\0"));
        for text in
            ["", "08:00:00", "2026-13-05 08:00", "31.02.2026", "Bad Input", "1/5/2026 13:00 PM", "5 6 7", "FIC-101"]
        {
            let none = match Stamp::read(text) {
                Some(Stamp::Civil(c)) => Order::ALL.iter().all(|o| c.date(*o).is_none()),
                other => other.is_none(),
            };
            assert!(none, "{text}: {:?}", Stamp::read(text));
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
