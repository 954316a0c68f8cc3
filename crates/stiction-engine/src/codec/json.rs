//! JSON: a number, an object `{"t", "v", "q"}`, or an array of these.
//!
//! `v` is a number, true or false (1 or 0), null for a missing value, or a mode's word. `NaN`, `Infinity` and numbers beyond
//! f64, which are not JSON, also count as missing. `t` is integer nanoseconds since 1970 or RFC 3339; `q` an integer.

use super::samples::read_samples;
use super::{Bundle, Codec, CodecError, Field, MAX_SAMPLES, Memory, named};
use stiction::core::record::{Sample, Signal};

/// The format `json`.
#[derive(Debug, Clone, Copy)]
pub struct Json;

impl Codec for Json {
    fn name(&self) -> &'static str {
        "json"
    }

    fn speaks(&self, media_type: &str) -> bool {
        matches!(media_type, "json" | "application/json" | "text/json" | "text/plain" | "zenoh/string")
            || media_type.ends_with("+json")
    }

    fn sniff(&self, payload: &[u8]) -> bool {
        payload.iter().find(|b| !b.is_ascii_whitespace()).is_some_and(|b| b"[{\"-+.0123456789tfnNI".contains(b))
    }

    fn decode(
        &self,
        signal: Signal,
        payload: &[u8],
        fallback_t_ns: i64,
        out: &mut Vec<Sample>,
    ) -> Result<(), CodecError> {
        let before = out.len();
        let Err(error) = parse(signal, payload, fallback_t_ns, out) else { return Ok(()) };
        out.truncate(before);
        if let CodecError::Json(_) = error
            && let Some(quoted) = quote_non_finite(payload)
        {
            return parse(signal, &quoted, fallback_t_ns, out);
        }
        Err(error)
    }

    fn fields(&self, bundle: &Bundle<'_>, _: &mut Memory, out: &mut Vec<Field>) -> Result<(), CodecError> {
        named::read(&tree(bundle.payload)?, bundle.fallback_t_ns, out).map_err(CodecError::Json)
    }
}

/// A payload as a tree of values; tokens that are not finite numbers become text.
pub(super) fn tree(payload: &[u8]) -> Result<serde_json::Value, CodecError> {
    let error = match serde_json::from_slice(payload) {
        Ok(tree) => return Ok(tree),
        Err(error) => CodecError::Json(error.to_string()),
    };
    quote_non_finite(payload).and_then(|quoted| serde_json::from_slice(&quoted).ok()).ok_or(error)
}

fn parse(signal: Signal, payload: &[u8], fallback_t_ns: i64, out: &mut Vec<Sample>) -> Result<(), CodecError> {
    let mut crowded = false;
    let mut json = serde_json::Deserializer::from_slice(payload);
    let read = read_samples(&mut json, signal, fallback_t_ns, out, &mut crowded);
    let result = read.and_then(|()| json.end());
    match result {
        Err(_) if crowded => Err(CodecError::TooMany { limit: MAX_SAMPLES }),
        other => other.map_err(|error| CodecError::Json(error.to_string())),
    }
}

/// Quotes the tokens that are not finite numbers; `None` if there are none.
fn quote_non_finite(payload: &[u8]) -> Option<Vec<u8>> {
    let mut out = Vec::with_capacity(payload.len() + 16);
    let mut changed = false;
    let mut at = 0;
    while at < payload.len() {
        let end = match payload[at] {
            b'"' => string_end(payload, at),
            b if is_word(b) => at + payload[at..].iter().take_while(|b| is_word(**b)).count(),
            _ => at + 1,
        };
        let token = &payload[at..end];
        if is_non_finite(token) {
            changed = true;
            out.push(b'"');
            out.extend_from_slice(b"NaN");
            out.push(b'"');
        } else {
            out.extend_from_slice(token);
        }
        at = end;
    }
    changed.then_some(out)
}

fn is_word(byte: u8) -> bool {
    byte.is_ascii_alphanumeric() || matches!(byte, b'+' | b'-' | b'.')
}

fn is_non_finite(token: &[u8]) -> bool {
    is_word(token[0])
        && std::str::from_utf8(token).is_ok_and(|text| text.parse::<f64>().is_ok_and(|number| !number.is_finite()))
}

/// The index after the string that starts at `start`.
fn string_end(payload: &[u8], start: usize) -> usize {
    let mut at = start + 1;
    while at < payload.len() {
        match payload[at] {
            b'\\' => at += 2,
            b'"' => return at + 1,
            _ => at += 1,
        }
    }
    payload.len()
}

#[cfg(test)]
mod tests {
    use super::*;
    use stiction::core::record::{Mode, Value};

    fn read(signal: Signal, text: &str) -> Result<Vec<Sample>, CodecError> {
        let mut out = Vec::new();
        Json.decode(signal, text.as_bytes(), 5, &mut out).map(|()| out)
    }

    fn sample(t_ns: i64, value: Value, quality: Option<u32>) -> Sample {
        Sample { signal: Signal::Pv, t_ns, value, quality }
    }

    #[test]
    fn every_promised_shape_is_read() {
        for (text, expected) in [
            ("42", vec![sample(5, Value::Number(42.0), None)]),
            (" -0.5e1 ", vec![sample(5, Value::Number(-5.0), None)]),
            ("null", vec![sample(5, Value::Missing, None)]),
            ("true", vec![sample(5, Value::Number(1.0), None)]),
            (r#"{"t":9,"v":1.5,"q":0}"#, vec![sample(9, Value::Number(1.5), Some(0))]),
            (r#"{"v":1,"q":-2147483648,"unit":{"a":[1]}}"#, vec![sample(5, Value::Number(1.0), Some(0x8000_0000))]),
            (r#"{"t":"1970-01-01T00:00:01Z","v":null}"#, vec![sample(1_000_000_000, Value::Missing, None)]),
            (r#"{"t":1.7e18,"v":1}"#, vec![sample(1_700_000_000_000_000_000, Value::Number(1.0), None)]),
            (r#"{"t":null,"v":false,"q":null}"#, vec![sample(5, Value::Number(0.0), None)]),
            (
                r#"[{"t":1,"v":1},2,null,{"v":NaN}]"#,
                vec![
                    sample(1, Value::Number(1.0), None),
                    sample(5, Value::Number(2.0), None),
                    sample(5, Value::Missing, None),
                    sample(5, Value::Missing, None),
                ],
            ),
            ("NaN", vec![sample(5, Value::Missing, None)]),
            ("[-Infinity,1e999]", vec![sample(5, Value::Missing, None), sample(5, Value::Missing, None)]),
            (r#"{"v":"NaN"}"#, vec![sample(5, Value::Missing, None)]),
            ("[]", vec![]),
        ] {
            assert_eq!(read(Signal::Pv, text), Ok(expected), "{text}");
        }
    }

    #[test]
    fn modes_are_words_or_numbers() {
        let mode = |text: &str| read(Signal::Mode, text).unwrap()[0].value;
        assert_eq!(mode("\"AUTO\""), Value::Mode(Mode::Auto));
        assert_eq!(mode(r#"{"v":"Man"}"#), Value::Mode(Mode::Manual));
        assert_eq!(mode(r#"{"v":"LocalOverride"}"#), Value::Mode(Mode::Unknown));
        assert_eq!(mode("3"), Value::Number(3.0));
        assert_eq!(mode("\"\""), Value::Missing);
    }

    #[test]
    fn wrong_shapes_are_named() {
        for (text, part) in [
            ("{}", "no \"v\""),
            (r#"{"v":"open"}"#, "needs a number"),
            (r#"{"t":"12.5","v":1}"#, "not RFC 3339"),
            (r#"{"t":1.5,"v":1}"#, "whole nanoseconds"),
            (r#"{"t":18446744073709551615,"v":1}"#, "2262"),
            (r#"{"t":NaN,"v":1}"#, "not RFC 3339"),
            (r#"{"v":1,"q":4294967296}"#, "32 bits"),
            ("[[1]]", "array inside"),
            ("1 2", "trailing"),
            ("{\"v\":1", "EOF"),
            (r#"{"v":{}}"#, "invalid type"),
        ] {
            let error = read(Signal::Pv, text).unwrap_err().to_string();
            assert!(error.contains(part), "{text}: {error}");
        }
    }

    #[test]
    fn depth_costs_no_stack() {
        let deep = |inner: &str| format!("{}{inner}{}", "[".repeat(200_000), "]".repeat(200_000));
        assert!(read(Signal::Pv, &deep("1")).is_err());
        assert!(read(Signal::Pv, &format!("{{\"v\":{}}}", deep("1"))).is_err());
        assert_eq!(read(Signal::Pv, &format!("{{\"x\":{},\"v\":1}}", deep("1"))).map(|s| s.len()), Ok(1));
    }
}
