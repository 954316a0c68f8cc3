//! Quality codes and words next to values.

use std::collections::BTreeMap;

use clap::ValueEnum;

use super::ExportError;
use super::cell::Cell;
use crate::conventions::{BAD, GOOD};
use crate::number::is_missing_word;

/// Meaning of the quality codes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Codes {
    /// OPC UA status codes: 0 is good.
    Ua,
    /// Classic OPC: 192 to 255 are good.
    Classic,
    /// Confidence in per cent: 50 and above are good.
    Percent,
    /// 1 is good, 0 is bad.
    Flag,
    /// Ignore the codes.
    Ignore,
}

/// A quality code, or a word for one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Mark {
    /// No code.
    None,
    /// A number.
    Code(i64),
    /// A word for good.
    Good,
    /// A word for bad.
    Bad,
}

impl Mark {
    /// Parses a cell; `None` if it is no known word for a quality.
    pub(super) fn read(text: &str) -> Option<Self> {
        let text = text.trim();
        if text.is_empty() {
            return Some(Self::None);
        }
        if let Some(code) = text.strip_prefix("0x").and_then(|hex| i64::from_str_radix(hex, 16).ok()) {
            return Some(Self::Code(code));
        }
        if let Ok(code) = text.parse::<f64>() {
            return Some(Self::Code(code as i64));
        }
        let lower = text.to_lowercase();
        // OPC and Ignition write `Good_Clamped`, `Bad, Sensor Failure`, `BadNoCommunication`.
        let is = |list: &str| list.split('|').any(|w| lower == w || (w.len() > 2 && lower.starts_with(w)));
        match (is(GOOD), is(BAD) || is_missing_word(text)) {
            (true, _) => Some(Self::Good),
            (_, true) => Some(Self::Bad),
            _ => None,
        }
    }

    /// Whether it marks the value as bad.
    pub(super) const fn is_bad(self, codes: Codes) -> bool {
        match (self, codes) {
            (_, Codes::Ignore) | (Self::None | Self::Good, _) => false,
            (Self::Bad, _) => true,
            (Self::Code(code), Codes::Ua) => (code as u32) >> 30 != 0,
            (Self::Code(code), Codes::Classic) => code & 0xC0 != 0xC0,
            (Self::Code(code), Codes::Percent) => code < 50,
            (Self::Code(code), Codes::Flag) => code == 0,
        }
    }
}

/// Whether one of the flags in these columns is set, which say that a value is bad; `None` if there are none.
pub(super) fn doubt<'c>(
    line: u64,
    flags: &[usize],
    cell: &dyn Fn(usize) -> Cell<'c>,
) -> Result<Option<bool>, ExportError> {
    let mut doubted = (!flags.is_empty()).then_some(false);
    for at in flags {
        let shown = cell(*at).shown().to_lowercase();
        match shown.as_str() {
            "true" | "yes" | "1" => doubted = Some(true),
            "false" | "no" | "0" | "" => {}
            _ => {
                let what = format!("a flag that says whether a value is bad contains {shown:?}, not true or false");
                return Err(ExportError::at(line, what, "if the column is no quality, use --quality ignore"));
            }
        }
    }
    Ok(doubted)
}

/// The convention of a file's codes, from the count of each code and the line of its first occurrence.
pub(super) fn convention(
    counts: &BTreeMap<i64, u64>,
    name: &str,
    line: u64,
    asked: Option<Codes>,
) -> Result<Codes, ExportError> {
    if let Some(codes) = asked {
        return Ok(codes);
    }
    let all = |inside: fn(i64) -> bool| counts.keys().all(|code| inside(*code));
    let any = |inside: fn(i64) -> bool| counts.keys().any(|code| inside(*code));
    let named = |words: [&str; 2]| words.iter().any(|word| name.to_lowercase().contains(word));
    if named(["good", "valid"]) && all(|c| c == 0 || c == 1) {
        Ok(Codes::Flag)
    } else if named(["confidence", "percent"]) && all(|c| (0..=100).contains(&c)) {
        Ok(Codes::Percent)
    } else if all(|c| (0..=255).contains(&c)) && any(|c| c >= 192) {
        Ok(Codes::Classic)
    } else if all(|c| c <= 0 || c >= 1 << 20) {
        Ok(Codes::Ua)
    } else {
        let seen: Vec<String> = counts.keys().take(6).map(i64::to_string).collect();
        let text = format!("{name:?} contains the codes {}, whose meaning is ambiguous", seen.join(", "));
        Err(ExportError::at(line, text, "choose it with --quality ua, classic, percent, flag or ignore"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn conventions_are_told_from_all_codes() {
        let of = |codes: &[i64], name: &str| {
            convention(&codes.iter().map(|c| (*c, 1)).collect(), name, 2, None).map_err(|e| e.to_string())
        };
        assert_eq!(of(&[0, 192, 216], "quality"), Ok(Codes::Classic));
        assert_eq!(of(&[0], "quality"), Ok(Codes::Ua));
        assert_eq!(of(&[0, 0x808c_0000], "quality"), Ok(Codes::Ua));
        assert_eq!(of(&[0, 85, 100], "confidence"), Ok(Codes::Percent));
        assert_eq!(of(&[0, 1], "isgood"), Ok(Codes::Flag));
        assert_eq!(of(&[0], "confidence"), Ok(Codes::Percent));
        assert!(of(&[0, 100], "quality").unwrap_err().contains("--quality"));
        assert!(of(&[0, 1], "status").unwrap_err().contains("--quality"));
        let bad = |text: &str, codes| Mark::read(text).map(|mark| mark.is_bad(codes));
        assert_eq!([bad("Bad, Sensor", Codes::Classic), bad("Good", Codes::Classic)], [Some(true), Some(false)]);
        assert_eq!([bad("0x808C0000", Codes::Ua), bad("192", Codes::Classic)], [Some(true), Some(false)]);
        assert_eq!(Mark::read("Running"), None);
    }
}
