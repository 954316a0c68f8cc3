//! Times, names and numbers, used by all modules.
//!
//! Time is `i64` nanoseconds since 1970 UTC in the plant's source time. Text times are parsed without floating point, so a
//! written timestamp reads back equal.

use serde::{Deserialize, Deserializer, Serialize, Serializer};
use thiserror::Error;
use time::{OffsetDateTime, format_description::well_known::Rfc3339};

/// Nanoseconds in a second.
pub const NS_PER_S: i64 = 1_000_000_000;

/// A text that is not a time.
#[derive(Debug, Error, Clone, PartialEq, Eq)]
pub enum TimeError {
    /// Neither decimal seconds nor RFC 3339.
    #[error("{0:?} is not a time; write seconds since 1970 (12.5) or RFC 3339 (2026-01-31T08:00:00Z)")]
    Unreadable(String),
    /// Outside the range of 64-bit nanoseconds.
    #[error("{0:?} is outside the years 1678 to 2261, the range of nanoseconds in 64 bits")]
    OutOfRange(String),
}

/// Seconds to nanoseconds, rounded. Saturates at the ends of the range; NaN gives 0.
#[must_use]
pub fn ns_from_s(seconds: f64) -> i64 {
    (seconds * NS_PER_S as f64).round() as i64
}

/// Nanoseconds to seconds.
#[must_use]
pub fn s_from_ns(ns: i64) -> f64 {
    ns as f64 / NS_PER_S as f64
}

/// Milliseconds from nanoseconds, as in browsers; exact to a quarter of a microsecond for this century.
#[must_use]
pub fn ms_from_ns(ns: i64) -> f64 {
    ns as f64 * 1e-6
}

/// Nanoseconds from milliseconds, saturating.
#[must_use]
pub fn ns_from_ms(ms: f64) -> i64 {
    ns_from_s(ms * 1e-3)
}

/// Parses decimal seconds since 1970 (exactly, to the nanosecond) or an RFC 3339 timestamp.
///
/// # Errors
/// [`TimeError`] with the text and the valid forms.
pub fn parse_time(text: &str) -> Result<i64, TimeError> {
    let text = text.trim();
    if text.len() > 10 && text.as_bytes()[4] == b'-' && text.as_bytes()[7] == b'-' {
        let normal = text.replacen(' ', "T", 1);
        let stamp = OffsetDateTime::parse(&normal, &Rfc3339).map_err(|_| TimeError::Unreadable(text.into()))?;
        return i64::try_from(stamp.unix_timestamp_nanos()).map_err(|_| TimeError::OutOfRange(text.into()));
    }
    parse_seconds(text)
}

/// Decimal seconds to nanoseconds without rounding through `f64`; text with an exponent goes through `f64`.
fn parse_seconds(text: &str) -> Result<i64, TimeError> {
    let unreadable = || TimeError::Unreadable(text.into());
    let range = || TimeError::OutOfRange(text.into());
    if text.contains(['e', 'E']) {
        let seconds: f64 = text.parse().map_err(|_| unreadable())?;
        if !seconds.is_finite() || seconds.abs() > 9.2e9 {
            return Err(range());
        }
        return Ok(ns_from_s(seconds));
    }
    let (negative, digits) = match text.strip_prefix('-') {
        Some(rest) => (true, rest),
        None => (false, text.strip_prefix('+').unwrap_or(text)),
    };
    let (whole, fraction) = digits.split_once('.').unwrap_or((digits, ""));
    let numeric = |s: &str| s.bytes().all(|b| b.is_ascii_digit());
    if (whole.is_empty() && fraction.is_empty()) || !numeric(whole) || !numeric(fraction) {
        return Err(unreadable());
    }
    let whole: i64 = if whole.is_empty() { 0 } else { whole.parse().map_err(|_| range())? };
    let mut nanos: i64 = 0;
    for (place, digit) in fraction.bytes().take(9).enumerate() {
        nanos += i64::from(digit - b'0') * 10_i64.pow(8 - place as u32);
    }
    // Digits past the ninth round half up; a carry is fine because the sum is checked.
    if fraction.as_bytes().get(9).is_some_and(|d| *d >= b'5') {
        nanos += 1;
    }
    let ns = whole.checked_mul(NS_PER_S).and_then(|w| w.checked_add(nanos)).ok_or_else(range)?;
    Ok(if negative { -ns } else { ns })
}

/// Nanoseconds as decimal seconds with the digits needed; [`parse_time`] reads it back equal.
#[must_use]
pub fn format_seconds(ns: i64) -> String {
    let (sign, magnitude) = if ns < 0 { ("-", ns.unsigned_abs()) } else { ("", ns as u64) };
    let (whole, nanos) = (magnitude / 1_000_000_000, magnitude % 1_000_000_000);
    if nanos == 0 {
        return format!("{sign}{whole}");
    }
    let fraction = format!("{nanos:09}");
    format!("{sign}{whole}.{}", fraction.trim_end_matches('0'))
}

/// RFC 3339 in UTC, for display.
#[must_use]
pub fn format_rfc3339(ns: i64) -> String {
    OffsetDateTime::from_unix_timestamp_nanos(i128::from(ns))
        .ok()
        .and_then(|t| t.format(&Rfc3339).ok())
        .unwrap_or_else(|| format!("{} s", format_seconds(ns)))
}

/// A number with three significant digits and all digits before the decimal point.
#[must_use]
pub fn number(value: f64) -> String {
    significant(value, 3)
}

/// A number with this many significant digits, without trailing zeros; with an exponent below 1e-4 and from 1e6.
#[must_use]
pub fn significant(value: f64, digits: usize) -> String {
    let size = value.abs();
    if !value.is_finite() {
        return "unknown".to_owned();
    }
    if size != 0.0 && !(1e-4..1e6).contains(&size) {
        return format!("{value:.*e}", digits.saturating_sub(1));
    }
    let mut decimals = digits.saturating_sub(1);
    let mut rest = size;
    while rest >= 10.0 && decimals > 0 {
        (rest, decimals) = (rest / 10.0, decimals - 1);
    }
    while rest < 1.0 && rest > 0.0 {
        (rest, decimals) = (rest * 10.0, decimals + 1);
    }
    to_decimals(value, decimals)
}

/// A number with at most this many decimals, without trailing zeros.
#[must_use]
pub fn to_decimals(value: f64, decimals: usize) -> String {
    let text = format!("{value:.decimals$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

/// A probability with two digits; never 0 or 1, which would mean certainty.
#[must_use]
pub fn probability(p: f64) -> String {
    match p {
        p if p > 0.99 => "> 0.99".to_owned(),
        p if p < 0.01 => "< 0.01".to_owned(),
        p => format!("{p:.2}"),
    }
}

/// As [`number`], or `-` for none.
#[must_use]
pub fn optional(value: Option<f64>) -> String {
    value.map_or_else(|| "-".to_owned(), number)
}

/// Whether a timestamp is a date; otherwise the record's clock starts at zero, as in many exports.
#[must_use]
pub fn is_date(ns: i64) -> bool {
    const YEAR_S: f64 = 365.0 * 86_400.0;
    s_from_ns(ns).abs() >= YEAR_S
}

/// A time range: both ends and the duration.
#[must_use]
pub fn from_to(start_ns: i64, end_ns: i64) -> String {
    let [start_s, end_s] = [start_ns, end_ns].map(s_from_ns);
    if !is_date(start_ns) && !is_date(end_ns) {
        return format!("{} to {} on the record's own clock", duration(start_s), duration(end_s));
    }
    format!("{} to {} ({})", format_rfc3339(start_ns), format_rfc3339(end_ns), duration(end_s - start_s))
}

/// A duration in words.
#[must_use]
pub fn duration(seconds: f64) -> String {
    match seconds.abs() {
        s if s < 120.0 => format!("{} s", number(seconds)),
        s if s < 7_200.0 => format!("{} min", number(seconds / 60.0)),
        s if s < 172_800.0 => format!("{} h", number(seconds / 3_600.0)),
        _ => format!("{} days", number(seconds / 86_400.0)),
    }
}

/// A time in ns since 1970 that documents write as RFC 3339, because JSON readers with f64 numbers, such as JavaScript, lose
/// the last digits of the integer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Moment(pub i64);

impl Serialize for Moment {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(&format_rfc3339(self.0))
    }
}

impl<'de> Deserialize<'de> for Moment {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = String::deserialize(deserializer)?;
        parse_time(&text).map(Self).map_err(serde::de::Error::custom)
    }
}

/// Whether a loop name is a valid key: non-empty parts, none of `* $ ? #`, no part starting with `@`.
#[must_use]
pub fn is_loop_name(name: &str) -> bool {
    !name.is_empty()
        && name.len() <= 200
        && name.split('/').all(|chunk| !chunk.is_empty() && !chunk.starts_with('@'))
        && !name.contains(['*', '$', '?', '#'])
        && !name.chars().any(char::is_control)
}

/// Makes a valid loop name of any text: invalid characters become `_`.
#[must_use]
pub fn loop_name_from(text: &str) -> String {
    let cleaned: String =
        text.trim().chars().map(|c| if c.is_control() || "*$?#@/ ".contains(c) { '_' } else { c }).take(200).collect();
    if cleaned.is_empty() { "loop".to_owned() } else { cleaned }
}

/// A file stem from a loop name that cannot lead to another folder or hide the file.
#[must_use]
pub fn file_stem_of(name: &str) -> String {
    let stem = loop_name_from(name).replace(['\\', ':'], "_");
    if stem.starts_with('.') { format!("_{stem}") } else { stem }
}

/// Controlled quantity of a loop, from the first letter of its tag (ISA 5.1).
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum LoopKind {
    /// F.
    Flow,
    /// L.
    Level,
    /// P.
    Pressure,
    /// T.
    Temperature,
    /// A: concentration, pH, any analyser.
    Analysis,
    /// Unknown.
    #[default]
    Other,
}

/// The final element that a controller's output moves.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FinalElement {
    /// A control valve.
    #[default]
    Valve,
    /// A drive with a variable speed.
    Drive,
    /// A damper.
    Damper,
    /// The set point of another controller, the slave of a cascade.
    Cascade,
}

impl FinalElement {
    /// Every kind.
    pub const ALL: [Self; 4] = [Self::Valve, Self::Drive, Self::Damper, Self::Cascade];

    /// Its word in configurations.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Valve => "valve",
            Self::Drive => "drive",
            Self::Damper => "damper",
            Self::Cascade => "cascade",
        }
    }
}

impl LoopKind {
    /// Every kind.
    pub const ALL: [Self; 6] =
        [Self::Flow, Self::Level, Self::Pressure, Self::Temperature, Self::Analysis, Self::Other];

    /// Word of the kind in configurations.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Flow => "flow",
            Self::Level => "level",
            Self::Pressure => "pressure",
            Self::Temperature => "temperature",
            Self::Analysis => "analysis",
            Self::Other => "other",
        }
    }

    /// The kind for a word.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.name() == name)
    }

    /// The kind given by a tag's letters: the first group of letters that looks like a controller's, such as FIC in
    /// `10FIC2101`, LC in `area_3LC` or PDIC in `PDIC-7`.
    #[must_use]
    pub fn of_tag(tag: &str) -> Self {
        let groups = tag.split(|c: char| !c.is_ascii_alphabetic());
        groups
            .map(|letters| Self::of_letters(&letters.to_ascii_uppercase()))
            .find(|k| *k != Self::Other)
            .unwrap_or_default()
    }

    fn of_letters(letters: &str) -> Self {
        let mut rest = letters.chars();
        let kind = match rest.next() {
            Some('F') => Self::Flow,
            Some('L') => Self::Level,
            Some('P') => Self::Pressure,
            Some('T') => Self::Temperature,
            Some('A') => Self::Analysis,
            _ => Self::Other,
        };
        // A modifier (difference, ratio, total), indicator or recorder, then the controller.
        let rest = rest.as_str();
        let rest = rest.strip_prefix(['D', 'F', 'Q']).unwrap_or(rest);
        let rest = rest.strip_prefix(['I', 'R']).unwrap_or(rest);
        if matches!(rest, "C" | "CA" | "CV" | "CS") { kind } else { Self::Other }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn times_are_read_without_rounding() {
        assert_eq!(parse_time("0.1").unwrap(), 100_000_000);
        assert_eq!(parse_time("1700000000.123456789").unwrap(), 1_700_000_000_123_456_789);
        assert_eq!(parse_time("-2.5").unwrap(), -2_500_000_000);
        assert_eq!(parse_time("1e3").unwrap(), 1_000_000_000_000);
        assert_eq!(parse_time("2020-01-01T00:00:00Z").unwrap(), 1_577_836_800_000_000_000);
        assert_eq!(parse_time("2020-01-01 01:00:00+01:00").unwrap(), 1_577_836_800_000_000_000);
        for bad in ["", "-", "abc", "1.2.3", "nan", "2020-13-01T00:00:00Z", "99999999999999999999"] {
            assert!(parse_time(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn no_probability_is_certainty() {
        let told = [0.0, 0.004, 0.012, 0.5, 0.99, 0.996, 1.0].map(probability);
        assert_eq!(told, ["< 0.01", "< 0.01", "0.01", "0.50", "0.99", "> 0.99", "> 0.99"]);
    }

    #[test]
    fn numbers_read_as_people_write_them() {
        let said = [8.0052, 0.0, 123.4, 12.34, 0.5, -2.5, 0.001_234_5, 1234.5, 1e-9].map(number).join(" ");
        assert_eq!(said, "8.01 0 123 12.3 0.5 -2.5 0.00123 1234 1.00e-9");
        assert_eq!([1895.31, 0.031_175_2, 1.0].map(|v| significant(v, 5)).join(" "), "1895.3 0.031175 1");
        assert_eq!([12.0, 600.0, 7_200.0, 200_000.0].map(duration).join(", "), "12 s, 10 min, 2 h, 2.31 days");
        assert_eq!(number(f64::NAN), "unknown");
        assert_eq!(from_to(0, 7_200 * NS_PER_S), "0 s to 2 h on the record's own clock");
        let start_ns = 1_767_225_600 * NS_PER_S;
        let said = from_to(start_ns, start_ns + 90 * NS_PER_S);
        assert_eq!(said, "2026-01-01T00:00:00Z to 2026-01-01T00:01:30Z (90 s)");
    }

    #[test]
    fn loop_names_fit_into_keys() {
        assert!(is_loop_name("FIC101") && is_loop_name("unit1/FIC101"));
        assert!(!is_loop_name("") && !is_loop_name("a//b") && !is_loop_name("@x") && !is_loop_name("a*"));
        assert!(is_loop_name(&loop_name_from("#1 FIC/101")));
    }

    proptest! {
        #[test]
        fn seconds_read_back_equal(ns in any::<i64>().prop_filter("i64::MIN has no mirror", |n| *n != i64::MIN)) {
            prop_assert_eq!(parse_time(&format_seconds(ns)).unwrap(), ns);
        }

        #[test]
        fn any_text_is_answered(text in ".{0,40}") {
            let _ = parse_time(&text);
            prop_assert!(is_loop_name(&loop_name_from(&text)));
        }
    }

    #[test]
    fn a_tag_names_what_its_loop_controls() {
        for (tag, kind) in [
            ("FIC101", LoopKind::Flow),
            ("10FIC2101_0001", LoopKind::Flow),
            ("AREA.7-3_LIC101", LoopKind::Level),
            ("PDIC-7", LoopKind::Pressure),
            ("tc1", LoopKind::Temperature),
            ("AIC3", LoopKind::Analysis),
            ("PAPER1", LoopKind::Other),
            ("LIFT", LoopKind::Other),
            ("loop4", LoopKind::Other),
        ] {
            assert_eq!(LoopKind::of_tag(tag), kind, "{tag}");
            assert_eq!(LoopKind::from_name(kind.name()), Some(kind));
            assert_eq!(serde_json::to_value(kind).unwrap(), kind.name());
        }
    }
}
