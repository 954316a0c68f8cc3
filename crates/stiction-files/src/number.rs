//! Numbers in exports: decimal points and commas, thousands separators, per cent signs, and words for missing values.

use clap::ValueEnum;

use crate::conventions::{MISSING, NO_VALUE, SENTINELS, SIGNS, STARTS, UNITS, is_one_of};

/// Decimal separator.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Decimal {
    /// `1.5`, and `1,234.5` with thousands.
    Point,
    /// `1,5`, and `1.234,5` with thousands.
    Comma,
}

/// What one cell shows about the decimal separator.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Hint {
    /// Nothing: no separator, or not a number.
    None,
    /// Certainly this one.
    Sure(Decimal),
    /// `1,234` or `1.234`: decimals, or thousands; carries the separator as [`Decimal::Comma`] or [`Decimal::Point`].
    Either(Decimal),
}

/// A number that loggers write for a missing value, in a column whose other values, if it has any, are far from it.
pub(super) fn sentinel(values: impl Iterator<Item = f64> + Clone) -> Option<f64> {
    let is = |v: f64| v.abs() >= NO_VALUE || SENTINELS.iter().any(|s| (v - s).abs() <= 1e-6 * s.abs());
    let found = values.clone().find(|v| is(*v))?;
    let (low, high) =
        values.filter(|v| !is(*v)).fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)));
    let span = high - low;
    let alone = low > high && (found < 0.0 || found.abs() >= NO_VALUE);
    (alone || (low <= high && (found > high + span || found < low - span))).then_some(found)
}

/// Whether a text is one that systems write in place of a value.
pub(super) fn is_missing_word(text: &str) -> bool {
    let lower = text.trim().to_lowercase();
    // A word may be followed by another, as in "Bad Input", not by more of its letters.
    let longer = |word: &str| word.len() > 3 && lower.strip_prefix(word).is_some_and(|rest| !rest.starts_with('_'));
    lower.is_empty()
        || is_one_of(&lower, SIGNS)
        || MISSING.split('|').any(|word| lower == word || longer(word))
        || STARTS.split('|').any(|word| lower.starts_with(word))
}

/// A number, and the unit behind it; Excel's `="1.5"` and `'1.5` are numbers.
pub(super) fn with_unit(text: &str) -> (&str, Option<&str>) {
    let text = text.strip_prefix("=\"").and_then(|t| t.strip_suffix('"')).unwrap_or(text);
    let text = text.strip_prefix('\'').unwrap_or(text).trim();
    if text.ends_with(|c: char| c.is_ascii_digit() || c == '.' || c == ',') {
        return (text, None);
    }
    let number = text.rfind(|c: char| c.is_ascii_digit() || c == '.').map_or(0, |at| at + 1);
    // A superscript or a figure of the unit itself, as in m3/h.
    let starts = (1..=number).rev().filter(|at| text.is_char_boundary(*at) && text.as_bytes()[at - 1].is_ascii_digit());
    for at in starts {
        let unit = text[at..].trim();
        if is_one_of(&unit.to_lowercase(), UNITS) {
            return (&text[..at], Some(unit));
        }
    }
    (text, None)
}

/// Strips spaces of all widths, apostrophes between thousands and a per cent sign from a number.
fn bare(text: &str) -> Option<std::borrow::Cow<'_, str>> {
    let text = text.trim().trim_end_matches('%').trim_end();
    let first = text.trim_start_matches(['+', '-', '\u{2212}']).chars().next()?;
    if !(first.is_ascii_digit() || first == '.' || first == ',') {
        return None;
    }
    let grouping = |c: char| c == '\'' || c == '\u{2019}' || c.is_whitespace();
    if !text.contains(|c: char| grouping(c) || c == '\u{2212}') {
        return Some(text.into());
    }
    // A blank inside a number stands before three digits.
    let chars: Vec<char> = text.chars().collect();
    let fits = |at: usize| {
        chars[at + 1..].iter().take_while(|c| c.is_ascii_digit()).count() == 3
            && at > 0
            && chars[at - 1].is_ascii_digit()
    };
    if chars.iter().enumerate().any(|(at, c)| grouping(*c) && !fits(at)) {
        return None;
    }
    let kept = chars.into_iter().filter(|c| !grouping(*c)).map(|c| if c == '\u{2212}' { '-' } else { c });
    Some(kept.collect::<String>().into())
}

/// Whether the first group has one to three digits and all others have three.
fn in_groups(whole: &str, separator: char) -> bool {
    let mut groups = whole.trim_start_matches(['+', '-']).split(separator);
    let digits = |g: &str| g.bytes().all(|b| b.is_ascii_digit());
    groups.next().is_some_and(|g| (1..=3).contains(&g.len()) && digits(g)) && groups.all(|g| g.len() == 3 && digits(g))
}

/// What a cell shows about the decimal separator of its file.
pub(super) fn hint(text: &str) -> Hint {
    let Some(text) = bare(text) else { return Hint::None };
    let count = |c: char| text.matches(c).count();
    let found = match (count(','), count('.')) {
        (0, 0) => Hint::None,
        (1, 0) | (0, 1) => {
            let kind = if count(',') == 1 { Decimal::Comma } else { Decimal::Point };
            let separator = if kind == Decimal::Comma { ',' } else { '.' };
            let thousands = in_groups(&text, separator) && !text.trim_start_matches(['+', '-']).starts_with('0');
            if thousands { Hint::Either(kind) } else { Hint::Sure(kind) }
        }
        (_, 0) => Hint::Sure(Decimal::Point),
        (0, _) => Hint::Sure(Decimal::Comma),
        (_, _) => {
            let comma_last = text.rfind(',') > text.rfind('.');
            Hint::Sure(if comma_last { Decimal::Comma } else { Decimal::Point })
        }
    };
    match found {
        // Only what is a number then counts.
        Hint::Sure(kind) if number(&text, kind).is_none() => Hint::None,
        other => other,
    }
}

/// Parses a number; `None` if it is not one, not finite, or uses the other decimal separator.
pub(super) fn number(text: &str, decimal: Decimal) -> Option<f64> {
    let text = bare(text)?;
    let (group, point) = if decimal == Decimal::Point { (',', '.') } else { ('.', ',') };
    let whole = text.split([point, 'e', 'E']).next().unwrap_or_default();
    if text.matches(group).count() != whole.matches(group).count() {
        return None;
    }
    let plain = if whole.contains(group) {
        if !in_groups(whole, group) {
            return None;
        }
        text.replace(group, "").replace(point, ".")
    } else if point == '.' {
        return finite(&text);
    } else {
        text.replace(point, ".")
    };
    finite(&plain)
}

fn finite(text: &str) -> Option<f64> {
    text.parse::<f64>().ok().filter(|v| v.is_finite())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn decimals_and_thousands_are_told_apart() {
        use Decimal::{Comma, Point};
        for (text, expected) in [
            ("12", Hint::None),
            ("1.5", Hint::Sure(Point)),
            ("1,5", Hint::Sure(Comma)),
            ("0,125", Hint::Sure(Comma)),
            ("1,234", Hint::Either(Comma)),
            ("1.234", Hint::Either(Point)),
            ("1,234,567", Hint::Sure(Point)),
            ("1.234,5", Hint::Sure(Comma)),
            ("1,234.5", Hint::Sure(Point)),
            ("1 234,5 %", Hint::Sure(Comma)),
            ("Bad, very", Hint::None),
            ("1,2,3", Hint::None),
        ] {
            assert_eq!(hint(text), expected, "{text}");
        }
        assert_eq!(number("1.234,5", Comma), Some(1234.5));
        assert_eq!(number("1'234.5", Point), Some(1234.5));
        assert_eq!(number("1\u{a0}234,5", Comma), Some(1234.5));
        assert_eq!(number("-4,5E-3", Comma), Some(-4.5e-3));
        assert_eq!(number("45.2 %", Point), Some(45.2));
        for (text, decimal) in [("1,5", Point), ("1.5", Comma), ("12 5", Point), ("nan", Point), ("1e999", Point)] {
            assert_eq!(number(text, decimal), None, "{text}");
        }
    }

    #[test]
    fn words_for_nothing_are_known() {
        for word in ["Bad Input", "I/O Timeout", "No Data", "[-11059] No Good Data For Calculation", "-", "N/A", "NaN"]
        {
            assert!(is_missing_word(word), "{word}");
        }
        assert!(!is_missing_word("Auto") && !is_missing_word("name") && !is_missing_word("12"));
    }

    #[test]
    fn units_and_excels_quotes_are_told_from_numbers() {
        for (text, number, unit) in [
            ("30.97 %", "30.97", Some("%")),
            ("998.5 °C", "998.5", Some("°C")),
            ("12,5 m3/h", "12,5", Some("m3/h")),
            ("=\"40.25\"", "40.25", None),
            ("'40.25", "40.25", None),
            ("40.25", "40.25", None),
            ("12k", "12k", None),
            ("Bad", "Bad", None),
        ] {
            assert_eq!(with_unit(text), (number, unit), "{text}");
        }
    }

    #[test]
    fn a_sentinel_is_far_from_all_other_values() {
        let found = |values: &[f64]| sentinel(values.iter().copied());
        assert_eq!(found(&[1.0, 50.0, -9999.0, 99.0]), Some(-9999.0));
        assert_eq!(found(&[998.5, 999.0, 1002.0]), None);
        assert_eq!(found(&[1.0, 2.0, 3.0]), None);
        assert_eq!((found(&[-9999.0]), found(&[999.0])), (Some(-9999.0), None));
    }

    proptest! {
        #[test]
        fn numbers_read_back_in_both_ways(v in -1e12..1e12_f64) {
            let point = format!("{v}");
            prop_assert_eq!(number(&point, Decimal::Point), Some(v));
            prop_assert_eq!(number(&point.replace('.', ","), Decimal::Comma), Some(v));
        }

        #[test]
        fn no_text_panics(text in ".{0,20}") {
            let _ = (hint(&text), number(&text, Decimal::Comma), is_missing_word(&text), with_unit(&text));
        }
    }
}
