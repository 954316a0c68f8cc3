//! Bytes to text: byte order marks, UTF-16 and UTF-32 with and without one, UTF-8, legacy encodings, ends of lines, and what a
//! power cut or DOS leaves at the end of a file.

use std::borrow::Cow;

use encoding_rs::{Encoding, UTF_8, UTF_16BE, UTF_16LE, WINDOWS_1252};

use super::ExportError;

/// Bytes examined to recognise wide characters without a mark.
const HEAD: usize = 4096;
/// Byte order marks of UTF-32, little and big endian.
const UTF_32: [&[u8]; 2] = [b"\xff\xfe\0\0", b"\0\0\xfe\xff"];

/// A file's text, and its encoding if worth mentioning.
#[derive(Debug)]
pub(super) struct Text<'b> {
    /// The text, without byte order marks; lines end with `\n`.
    pub text: Cow<'b, str>,
    /// For example `UTF-16LE`; `None` for plain UTF-8.
    pub encoding: Option<String>,
    /// What was left out.
    pub warning: Option<String>,
}

/// How many bytes a character of wide text has, and whether the lowest comes first; `None` for other text.
pub(crate) fn wide(bytes: &[u8]) -> Option<(usize, bool)> {
    let head = &bytes[..bytes.len().min(HEAD)];
    let fits = |size: usize, little: bool| {
        let chars = head.chunks_exact(size).count();
        let at = if little { 0 } else { size - 1 };
        let plain = |c: &&[u8]| {
            (c[at].is_ascii_graphic() || c[at].is_ascii_whitespace())
                && c.iter().enumerate().all(|(k, b)| k == at || *b == 0)
        };
        chars >= 4 && head.chunks_exact(size).filter(plain).count() * 10 >= chars * 8
    };
    [(4, true), (4, false), (2, true), (2, false)].into_iter().find(|(size, little)| fits(*size, *little))
}

/// Decodes a file. `wanted` overrides what the bytes look like; a byte order mark overrides both.
///
/// # Errors
/// NUL bytes inside the text.
pub(super) fn decode<'b>(bytes: &'b [u8], wanted: Option<&'static Encoding>) -> Result<Text<'b>, ExportError> {
    // A file that was set up in advance, or cut by a loss of power, ends with zeros.
    let written = bytes.iter().rposition(|b| *b != 0).map_or(0, |at| at + 1);
    let (text, encoding, step) = characters(bytes, written, wanted);
    let end = text.trim_end_matches(['\0', '\u{1a}', '\n', '\r']).len();
    // The end of the last line shows that it is whole.
    let end = end + usize::from(text[end..].starts_with(['\n', '\r']));
    let zeros = bytes.len() - written.next_multiple_of(step).min(bytes.len()) + text[end..].matches('\0').count();
    let warning = (zeros > 0).then(|| format!("{zeros} NUL bytes at the end are left out: the file was not closed"));
    let text = match text {
        Cow::Borrowed(text) if zeros > 0 || text.ends_with('\u{1a}') => Cow::Borrowed(&text[..end]),
        Cow::Owned(mut text) if zeros > 0 || text.ends_with('\u{1a}') => {
            text.truncate(end);
            Cow::Owned(text)
        }
        whole => whole,
    };
    let text = if text.contains('\r') { Cow::Owned(text.replace("\r\n", "\n").replace('\r', "\n")) } else { text };
    if let Some(at) = text.find('\0') {
        let line = text[..at].matches('\n').count() as u64 + 1;
        let what = "contains NUL bytes: the file is damaged here";
        return Err(ExportError::at(line, what, "remove this line"));
    }
    // Files that were joined bring their marks along.
    let text = if text.contains("\n\u{feff}") { Cow::Owned(text.replace("\n\u{feff}", "\n")) } else { text };
    Ok(Text { text, encoding, warning })
}

/// The characters, the encoding in words, and the bytes of its smallest character.
fn characters<'b>(
    bytes: &'b [u8],
    written: usize,
    wanted: Option<&'static Encoding>,
) -> (Cow<'b, str>, Option<String>, usize) {
    let of = |size: usize| &bytes[..written.next_multiple_of(size).min(bytes.len())];
    let found = wide(of(4));
    let mark = UTF_32.iter().position(|mark| bytes.starts_with(mark) && wanted.is_none());
    if let Some(little) = mark.map(|at| at == 0).or(found.filter(|(size, _)| *size == 4).map(|(_, little)| little)) {
        let number = |c: &[u8]| {
            let c = [c[0], c[1], c[2], c[3]];
            char::from_u32(if little { u32::from_le_bytes(c) } else { u32::from_be_bytes(c) })
        };
        let chars = of(4).chunks_exact(4).map(|c| number(c).unwrap_or(char::REPLACEMENT_CHARACTER));
        let text: String = chars.skip(usize::from(mark.is_some())).collect();
        return (text.into(), Some("UTF-32".to_owned()), 4);
    }
    let marked = Encoding::for_bom(bytes);
    let (encoding, skip) = match (marked, wanted, found) {
        (Some((encoding, length)), ..) => (encoding, length),
        (None, Some(encoding), _) => (encoding, 0),
        (None, None, Some((_, little))) => (if little { UTF_16LE } else { UTF_16BE }, 0),
        (None, None, None) if std::str::from_utf8(&bytes[..written]).is_ok() => (UTF_8, 0),
        _ => (WINDOWS_1252, 0),
    };
    let step = if encoding == UTF_16LE || encoding == UTF_16BE { 2 } else { 1 };
    let (text, _) = encoding.decode_without_bom_handling(of(step).get(skip..).unwrap_or_default());
    let name = match (encoding == UTF_8, marked.is_some()) {
        (true, true) => Some("UTF-8 with byte order mark".to_owned()),
        (true, false) => None,
        (false, true) => Some(format!("{} with byte order mark", encoding.name())),
        // Latin-1 is the part of Windows-1252 that exports hold.
        (false, false) if encoding == WINDOWS_1252 => Some("Latin-1 (Windows-1252)".to_owned()),
        (false, false) => Some(encoding.name().to_owned()),
    };
    (text, name, step)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn encodings_are_told_by_mark_and_by_content() {
        let text = "Zeit;Durchfluss [m³/h]\n1;2\n";
        let utf16 = |unit: fn(u16) -> [u8; 2]| text.encode_utf16().flat_map(unit).collect::<Vec<u8>>();
        let utf32 = |unit: fn(u32) -> [u8; 4]| text.chars().flat_map(|c| unit(c.into())).collect::<Vec<u8>>();
        let latin: Vec<u8> = text.chars().map(|c| u32::from(c) as u8).collect();
        let marked = |mark: &[u8], body: Vec<u8>| [mark, &body].concat();
        for (bytes, name) in [
            (text.as_bytes().to_vec(), None),
            (marked(b"\xef\xbb\xbf", text.as_bytes().to_vec()), Some("UTF-8 with")),
            (utf16(u16::to_le_bytes), Some("UTF-16LE")),
            (utf16(u16::to_be_bytes), Some("UTF-16BE")),
            (marked(b"\xff\xfe", utf16(u16::to_le_bytes)), Some("UTF-16LE with")),
            (utf32(u32::to_le_bytes), Some("UTF-32")),
            (utf32(u32::to_be_bytes), Some("UTF-32")),
            (marked(UTF_32[0], utf32(u32::to_le_bytes)), Some("UTF-32")),
            (marked(UTF_32[1], utf32(u32::to_be_bytes)), Some("UTF-32")),
            (latin, Some("Latin-1")),
        ] {
            let found = decode(&bytes, None).unwrap();
            assert_eq!(found.text, text, "{name:?}");
            assert_eq!((found.encoding.is_some(), found.warning), (name.is_some(), None));
            assert!(found.encoding.unwrap_or_default().starts_with(name.unwrap_or_default()));
        }
    }

    #[test]
    fn ends_of_lines_and_of_files_are_those_of_any_system() {
        for text in ["a,b\r\n1,2\r\n", "a,b\r1,2\r", "\u{feff}a,b\n\u{feff}1,2\n"] {
            assert_eq!(decode(text.as_bytes(), None).unwrap().text, "a,b\n1,2\n", "{text:?}");
        }
        assert_eq!(decode(b"a,b\n1,2\n\x1a", None).unwrap().text, "a,b\n1,2\n");
        let cut = [b"a,b\n1,2\n".to_vec(), vec![0; 9000]].concat();
        let found = decode(&cut, None).unwrap();
        assert_eq!(found.text, "a,b\n1,2\n");
        assert!(found.warning.unwrap().contains("9000 NUL bytes"));
        let inside = decode(b"a,b\n1,2\n\0\0\0\n3,4\n", None).unwrap_err().to_string();
        assert!(inside.contains("line 3") && inside.contains("NUL"), "{inside}");
    }
}
