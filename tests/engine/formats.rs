//! The examples in `docs/formats.md` and those in hex next to the codecs: every format has one, and it is read as stated.

use std::fs;

use stiction::core::units::format_rfc3339;
use stiction_engine::codec::{self, Bundle, Codec, Memory, Scalar};

/// The page, and the examples that are only for programs.
pub fn page() -> String {
    ["docs/formats.md", "crates/stiction-engine/src/codec/examples.md"].map(|p| fs::read_to_string(p).unwrap()).concat()
}

/// The text of a fenced block after a heading.
fn block<'t>(page: &'t str, heading: &str, kind: &str) -> &'t str {
    let (_, after) =
        page.split_once(&format!("\n### {heading}\n")).unwrap_or_else(|| panic!("no example of {heading}"));
    let (_, inside) = after.split_once(&format!("```{kind}\n")).unwrap();
    inside.split_once("\n```").unwrap().0
}

fn payload_of(text: &str) -> Vec<u8> {
    let words: Vec<&str> = text.split_ascii_whitespace().collect();
    let hex: Option<Vec<u8>> =
        words.iter().map(|w| Some(*w).filter(|w| w.len() == 2).and_then(|w| u8::from_str_radix(w, 16).ok())).collect();
    hex.unwrap_or_else(|| text.as_bytes().to_vec())
}

#[test]
fn every_example_of_the_page_is_read_as_it_says() {
    let page = page();
    for codec in codec::ALL.into_iter().filter(|codec| codec.name() != "f64le") {
        let payload = payload_of(block(&page, codec.name(), "payload"));
        // By name, and recognised from the bytes.
        for configured in [Some(codec), None] {
            let (mut fields, bundle) = (Vec::new(), Bundle { key: "gw/x", payload: &payload, fallback_t_ns: 7 });
            let read = codec::decode_fields(&bundle, None, configured, &mut Memory::default(), &mut fields);
            assert_eq!(read, Ok(codec.name()), "{configured:?}");
            let mut lines: Vec<String> = fields
                .iter()
                .map(|field| {
                    let value = match &field.value {
                        Scalar::Number(number) => number.to_string(),
                        Scalar::Text(text) => text.clone(),
                        Scalar::Missing => "-".to_owned(),
                    };
                    let of = if field.of.is_empty() { "-" } else { &field.of };
                    let quality = field.quality.map_or_else(|| "-".to_owned(), |code| format!("0x{code:08x}"));
                    format!("{} {of} {} {value} {quality}", field.name, format_rfc3339(field.t_ns))
                })
                .collect();
            lines.sort();
            let mut wanted: Vec<&str> = block(&page, codec.name(), "values").lines().collect();
            wanted.sort_unstable();
            assert_eq!(lines, wanted, "{codec:?} as {configured:?}");
        }
    }
}

#[test]
fn the_page_names_every_format() {
    let page = page();
    for name in codec::ALL.map(Codec::name) {
        assert!(page.contains(&format!("\n| `{name}` | ")), "{name} has no row in docs/formats.md");
    }
}
