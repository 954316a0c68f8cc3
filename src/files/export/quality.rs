//! Quality codes and words beside values.

use std::collections::BTreeMap;

use clap::ValueEnum;

use super::ExportError;

/// What quality codes mean.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Codes {
    /// OPC UA status codes: 0 is good.
    Ua,
    /// Classic OPC: 192 to 255 are good.
    Classic,
    /// Per cent of confidence: from 50 on is good.
    Percent,
    /// 1 is good, 0 is not.
    Flag,
    /// They are passed over.
    Ignore,
}

/// A code, or what a word says of the value.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Mark {
    /// No code: nothing is said.
    None,
    /// A number.
    Code(i64),
    /// A word for good.
    Good,
    /// A word for anything else.
    Bad,
}

impl Mark {
    /// Reads a cell.
    pub(super) fn read(text: &str) -> Self {
        let text = text.trim();
        if text.is_empty() {
            return Self::None;
        }
        if let Some(code) = text.strip_prefix("0x").and_then(|hex| i64::from_str_radix(hex, 16).ok()) {
            return Self::Code(code);
        }
        if let Ok(code) = text.parse::<f64>() {
            return Self::Code(code as i64);
        }
        let lower = text.to_lowercase();
        let good = ["good", "ok", "valid", "true", "normal", "gut", "bon", "g"];
        if good.iter().any(|w| lower == *w || (w.len() > 3 && lower.starts_with(w))) { Self::Good } else { Self::Bad }
    }

    /// Whether it calls the value bad.
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

/// The convention of a file's codes, with how often each code stands and the line of the first.
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
    let flag = name.contains("good") && all(|c| c == 0 || c == 1);
    if flag {
        Ok(Codes::Flag)
    } else if all(|c| (0..=255).contains(&c)) && any(|c| c >= 192) {
        Ok(Codes::Classic)
    } else if all(|c| c <= 0 || c >= 1 << 20) {
        Ok(Codes::Ua)
    } else if all(|c| (0..=100).contains(&c)) && any(|c| c == 100) {
        Ok(Codes::Percent)
    } else {
        let seen: Vec<String> = counts.keys().take(6).map(i64::to_string).collect();
        let text = format!("{name:?} holds the codes {}, whose meaning is not plain", seen.join(", "));
        Err(ExportError::at(line, text, "say it by --quality ua, classic, percent, flag or ignore"))
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
        assert!(of(&[0, 1], "status").unwrap_err().contains("--quality"));
        assert!(Mark::read("Bad, Sensor").is_bad(Codes::Classic) && !Mark::read("Good").is_bad(Codes::Classic));
        assert!(Mark::read("0x808C0000").is_bad(Codes::Ua) && !Mark::read("192").is_bad(Codes::Classic));
    }
}
