//! Bytes to text: byte order marks, UTF-16 with and without one, UTF-8, and legacy encodings.

use std::borrow::Cow;

use encoding_rs::{Encoding, UTF_8, UTF_16BE, UTF_16LE, WINDOWS_1252};

/// Bytes examined to recognise UTF-16 without a mark.
const HEAD: usize = 4096;

/// A file's text, and its encoding if worth mentioning.
pub(super) struct Text<'b> {
    /// The text, without a byte order mark.
    pub text: Cow<'b, str>,
    /// For example `UTF-16LE`; `None` for plain UTF-8.
    pub encoding: Option<String>,
}

/// Decodes a file. `wanted` overrides what the bytes look like; a byte order mark overrides both.
pub(super) fn decode<'b>(bytes: &'b [u8], wanted: Option<&'static Encoding>) -> Text<'b> {
    let marked = Encoding::for_bom(bytes);
    let (encoding, skip) = match (marked, wanted) {
        (Some((encoding, length)), _) => (encoding, length),
        (None, Some(encoding)) => (encoding, 0),
        (None, None) => (guess(bytes), 0),
    };
    let (text, _) = encoding.decode_without_bom_handling(&bytes[skip..]);
    let name = match (encoding == UTF_8, marked.is_some()) {
        (true, true) => Some("UTF-8 with byte order mark".to_owned()),
        (true, false) => None,
        (false, true) => Some(format!("{} with byte order mark", encoding.name())),
        // Latin-1 is the part of Windows-1252 that exports hold.
        (false, false) if encoding == WINDOWS_1252 => Some("Latin-1 (Windows-1252)".to_owned()),
        (false, false) => Some(encoding.name().to_owned()),
    };
    Text { text, encoding: name }
}

/// Western text in UTF-16 has a zero in every other byte.
fn guess(bytes: &[u8]) -> &'static Encoding {
    let head = &bytes[..bytes.len().min(HEAD)];
    let zeros = |odd: usize| head.iter().skip(odd).step_by(2).filter(|b| **b == 0).count();
    let many = |count: usize| count * 5 > head.len();
    if many(zeros(1)) {
        UTF_16LE
    } else if many(zeros(0)) {
        UTF_16BE
    } else if std::str::from_utf8(bytes).is_ok() {
        UTF_8
    } else {
        WINDOWS_1252
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn encodings_are_told_by_mark_and_by_content() {
        let text = "Zeit;Durchfluss [m³/h]\n1;2\n";
        let utf16 = |unit: fn(u16) -> [u8; 2]| text.encode_utf16().flat_map(unit).collect::<Vec<u8>>();
        let latin: Vec<u8> = text.chars().map(|c| u32::from(c) as u8).collect();
        let marked = |mark: &[u8], body: Vec<u8>| [mark, &body].concat();
        for (bytes, name) in [
            (text.as_bytes().to_vec(), None),
            (marked(b"\xef\xbb\xbf", text.as_bytes().to_vec()), Some("UTF-8 with")),
            (utf16(u16::to_le_bytes), Some("UTF-16LE")),
            (utf16(u16::to_be_bytes), Some("UTF-16BE")),
            (marked(b"\xff\xfe", utf16(u16::to_le_bytes)), Some("UTF-16LE with")),
            (latin, Some("Latin-1")),
        ] {
            let found = decode(&bytes, None);
            assert_eq!(found.text, text);
            assert_eq!(found.encoding.is_some(), name.is_some());
            assert!(found.encoding.unwrap_or_default().starts_with(name.unwrap_or_default()));
        }
    }
}
