//! Numbers in exports: decimal points and commas, thousands separators, per cent signs, and words for missing values.

use clap::ValueEnum;

use crate::conventions::{MISSING, NO_VALUE, SENTINELS, SIGNS, STARTS, UNITS, is_one_of};

/// A number that is more than this many times as large as all others in its column is none of them.
const FAR: f64 = 4.0;
/// Numbers up to this may be any percentage.
const LARGEST_PERCENT: f64 = 100.0;
/// Most such numbers in a column: one for each reason.
const MOST_GIANTS: usize = 2;
/// Fewer changes of value are those of a set point.
const FEW: usize = 20;

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

/// A number in place of a missing value: one that loggers are known to write, in a column whose other values, if it has any,
/// are far from it; or any that comes again and is more than [`FAR`] times as large as every other value.
pub(super) fn sentinel(values: impl Iterator<Item = f64> + Clone) -> Option<f64> {
    known_sentinel(values.clone()).or_else(|| lone_giant(values))
}

/// The smallest of at most [`MOST_GIANTS`] numbers that come again and are far larger than all others.
fn lone_giant(values: impl Iterator<Item = f64> + Clone) -> Option<f64> {
    // The largest numbers with their counts, the largest first.
    let mut largest: Vec<(f64, usize)> = Vec::new();
    for v in values.clone() {
        match largest.iter_mut().find(|(known, _)| *known == v) {
            Some((_, count)) => *count += 1,
            None => {
                let at = largest.partition_point(|(known, _)| known.abs() >= v.abs());
                if at <= MOST_GIANTS {
                    largest.insert(at, (v, 1));
                    largest.truncate(MOST_GIANTS + 1);
                }
            }
        }
    }
    let at = largest.windows(2).position(|w| w[0].0.abs() > FAR * w[1].0.abs().max(LARGEST_PERCENT / FAR))?;
    let giants = &largest[..=at];
    let others = || values.clone().filter(|v| giants.iter().all(|(giant, _)| giant != v));
    let changes = others().zip(others().skip(1)).filter(|(a, b)| a != b).take(FEW).count();
    (changes == FEW && giants.iter().all(|(_, count)| *count > 1)).then_some(giants[at].0)
}

fn known_sentinel(values: impl Iterator<Item = f64> + Clone) -> Option<f64> {
    let of_sign = |v: f64| !(0.0..=LARGEST_PERCENT).contains(&v);
    let known = |v: f64| of_sign(v) && SENTINELS.iter().any(|s| (v.abs() - s).abs() <= 1e-6 * s);
    let is = |v: f64| v.abs() >= NO_VALUE || known(v);
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
        if is_unit(unit) {
            return (&text[..at], Some(unit));
        }
    }
    (text, None)
}

/// Whether a text is a unit of a signal.
pub(super) fn is_unit(text: &str) -> bool {
    is_one_of(&text.to_lowercase(), UNITS)
}

/// Whether two texts are the same unit: `°C` is `degC`, `m³/hr` is `m3/h`.
pub(super) fn same_unit(one: &str, other: &str) -> bool {
    let plain = |unit: &str| {
        let unit = unit.to_lowercase().replace('°', "deg").replace('³', "3").replace("hr", "h");
        unit.chars().filter(|c| !c.is_whitespace()).collect::<String>()
    };
    one == other || plain(one) == plain(other)
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
        assert_eq!((found(&[-99.99, 1.0, 40.0]), found(&[99.99, 1.0, 40.0])), (Some(-99.99), None));
        // Any number, if it comes again and none is near it: not a set point, a switch, or a start from a still.
        let wave = |at: f64, step: f64| (0..90).map(move |k| at + step * f64::from(k % 11));
        let with = |wave: Vec<f64>, others: &[f64]| {
            let mut all = wave;
            others.iter().for_each(|v| all.extend([*v; 3]));
            found(&all)
        };
        for (others, told) in [
            (&[6999.0][..], Some(6999.0)),
            (&[1e10], Some(1e10)),
            (&[-6999.0, 7000.0], Some(-6999.0)),
            (&[0.0], None),
            (&[3000.0, 3100.0, 3200.0], None),
        ] {
            assert_eq!(with(wave(900.0, 10.0).collect(), others), told, "{others:?}");
        }
        assert_eq!((with(wave(0.0, 0.5).collect(), &[100.0]), with([0.0, 500.0].repeat(40), &[0.0])), (None, None));
        assert_eq!(with([vec![5.0; 50], vec![8.0; 50]].concat(), &[700.0]), None);
        let long = wave(900.0, 10.0).chain([6999.0; 5000]).collect::<Vec<f64>>();
        assert_eq!(found(&long), Some(6999.0));
        let once: Vec<f64> = wave(900.0, 10.0).chain([6999.0]).collect();
        assert_eq!(found(&once), None);
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
