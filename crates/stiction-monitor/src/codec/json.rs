//! JSON: a number, an object `{"t", "v", "q"}`, or an array of these.
//!
//! `v` is a number, true or false (1 or 0), null for a missing value, or a mode's word. Publishers that write `NaN`,
//! `Infinity` or numbers beyond f64, which JSON does not know, mean a missing value too. `t` is whole nanoseconds since
//! 1970 or RFC 3339; `q` an integer.

use super::{Bundle, Codec, CodecError, Field, MAX_SAMPLES, Memory, named};
use serde::de::{DeserializeSeed, Deserializer, Error, IgnoredAny, MapAccess, SeqAccess, Visitor};
use std::fmt;
use stiction::record::{Mode, Sample, Signal, Value};
use stiction::units::parse_time;

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

/// A payload as a tree of values; what stands for no finite number is read as a text.
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

/// Puts quotes around the tokens that stand for no finite number; `None` if there are none.
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

/// Reads one payload of samples from any self-describing form; `crowded` says where it holds too many.
pub(super) fn read_samples<'de, D: Deserializer<'de>>(
    deserializer: D,
    signal: Signal,
    fallback_t_ns: i64,
    out: &mut Vec<Sample>,
    crowded: &mut bool,
) -> Result<(), D::Error> {
    Top { signal, fallback_t_ns, out, nested: false, crowded }.deserialize(deserializer)
}

/// A whole payload, or one element of its array.
struct Top<'a> {
    signal: Signal,
    fallback_t_ns: i64,
    out: &'a mut Vec<Sample>,
    nested: bool,
    crowded: &'a mut bool,
}

impl Top<'_> {
    fn push<E>(self, value: Value) -> Result<(), E> {
        let sample = Sample { signal: self.signal, t_ns: self.fallback_t_ns, value, quality: None };
        self.out.push(sample);
        Ok(())
    }
}

impl<'de> DeserializeSeed<'de> for Top<'_> {
    type Value = ();

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        deserializer.deserialize_any(self)
    }
}

impl<'de> Visitor<'de> for Top<'_> {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a number or an object with \"v\"")
    }

    fn visit_bool<E: Error>(self, v: bool) -> Result<(), E> {
        self.push(Value::Number(f64::from(u8::from(v))))
    }

    fn visit_i64<E: Error>(self, v: i64) -> Result<(), E> {
        self.push(Value::number(v as f64))
    }

    fn visit_u64<E: Error>(self, v: u64) -> Result<(), E> {
        self.push(Value::number(v as f64))
    }

    fn visit_f64<E: Error>(self, v: f64) -> Result<(), E> {
        self.push(Value::number(v))
    }

    fn visit_none<E: Error>(self) -> Result<(), E> {
        self.visit_unit()
    }

    fn visit_unit<E: Error>(self) -> Result<(), E> {
        self.push(Value::Missing)
    }

    fn visit_str<E: Error>(self, v: &str) -> Result<(), E> {
        let value = word(self.signal, v)?;
        self.push(value)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<(), A::Error> {
        if self.nested {
            return Err(A::Error::custom("an array inside an array"));
        }
        let mut count = 0_usize;
        loop {
            let (signal, fallback_t_ns) = (self.signal, self.fallback_t_ns);
            let element = Top { signal, fallback_t_ns, out: self.out, nested: true, crowded: self.crowded };
            if seq.next_element_seed(element)?.is_none() {
                return Ok(());
            }
            count += 1;
            if count > MAX_SAMPLES {
                *self.crowded = true;
                return Err(A::Error::custom("too many"));
            }
        }
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<(), A::Error> {
        let (mut t_ns, mut value, mut quality) = (None, None, None);
        while let Some(key) = map.next_key_seed(KeySeed)? {
            match key {
                Key::T => t_ns = map.next_value_seed(TimeSeed)?,
                Key::V => value = Some(map.next_value_seed(ValueSeed(self.signal))?),
                Key::Q => quality = map.next_value_seed(QualitySeed)?,
                Key::Other => {
                    map.next_value::<IgnoredAny>()?;
                }
            }
        }
        let value = value.ok_or_else(|| A::Error::custom("the object has no \"v\""))?;
        self.out.push(Sample { signal: self.signal, t_ns: t_ns.unwrap_or(self.fallback_t_ns), value, quality });
        Ok(())
    }
}

/// What a text stands for: nothing finite, a mode's word, or an error.
fn word<E: Error>(signal: Signal, text: &str) -> Result<Value, E> {
    let trimmed = text.trim();
    let blank = trimmed.is_empty() || trimmed.parse::<f64>().is_ok_and(|number| !number.is_finite());
    match (blank, signal) {
        (true, _) => Ok(Value::Missing),
        (false, Signal::Mode) => Ok(Value::Mode(Mode::from_word(trimmed))),
        (false, _) => {
            let short: String = trimmed.chars().take(40).collect();
            Err(E::custom(format!("{short:?} is a text, {} takes a number", signal.name())))
        }
    }
}

enum Key {
    T,
    V,
    Q,
    Other,
}

struct KeySeed;

impl<'de> DeserializeSeed<'de> for KeySeed {
    type Value = Key;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Key, D::Error> {
        deserializer.deserialize_str(self)
    }
}

impl Visitor<'_> for KeySeed {
    type Value = Key;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a key")
    }

    fn visit_str<E: Error>(self, key: &str) -> Result<Key, E> {
        Ok(match key {
            "t" => Key::T,
            "v" => Key::V,
            "q" => Key::Q,
            _ => Key::Other,
        })
    }
}

pub(super) struct TimeSeed;

impl<'de> DeserializeSeed<'de> for TimeSeed {
    type Value = Option<i64>;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Option<i64>, D::Error> {
        deserializer.deserialize_any(self)
    }
}

impl Visitor<'_> for TimeSeed {
    type Value = Option<i64>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("\"t\" as whole nanoseconds since 1970 or RFC 3339")
    }

    fn visit_i64<E: Error>(self, v: i64) -> Result<Option<i64>, E> {
        Ok(Some(v))
    }

    fn visit_u64<E: Error>(self, v: u64) -> Result<Option<i64>, E> {
        let late = || E::custom(format!("t = {v} is past the year 2262, the last that nanoseconds in 64 bits hold"));
        i64::try_from(v).map(Some).map_err(|_| late())
    }

    /// Languages without integers write 1.7e18.
    fn visit_f64<E: Error>(self, v: f64) -> Result<Option<i64>, E> {
        if v.fract() == 0.0 && v.abs() < 9.2e18 {
            return Ok(Some(v as i64));
        }
        Err(E::custom(format!("t = {v} is not whole nanoseconds since 1970")))
    }

    fn visit_none<E: Error>(self) -> Result<Option<i64>, E> {
        self.visit_unit()
    }

    fn visit_unit<E: Error>(self) -> Result<Option<i64>, E> {
        Ok(None)
    }

    fn visit_str<E: Error>(self, v: &str) -> Result<Option<i64>, E> {
        let dated = v.trim().as_bytes().get(4) == Some(&b'-');
        let short: String = v.chars().take(40).collect();
        if !dated {
            return Err(E::custom(format!("t = {short:?} is not RFC 3339 (2026-01-31T08:00:00Z)")));
        }
        parse_time(v).map(Some).map_err(|_| E::custom(format!("t = {short:?} is not RFC 3339 (2026-01-31T08:00:00Z)")))
    }
}

struct ValueSeed(Signal);

impl<'de> DeserializeSeed<'de> for ValueSeed {
    type Value = Value;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Value, D::Error> {
        deserializer.deserialize_any(self)
    }
}

impl Visitor<'_> for ValueSeed {
    type Value = Value;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("\"v\" as a number, null or a mode's word")
    }

    fn visit_bool<E: Error>(self, v: bool) -> Result<Value, E> {
        Ok(Value::Number(f64::from(u8::from(v))))
    }

    fn visit_i64<E: Error>(self, v: i64) -> Result<Value, E> {
        Ok(Value::number(v as f64))
    }

    fn visit_u64<E: Error>(self, v: u64) -> Result<Value, E> {
        Ok(Value::number(v as f64))
    }

    fn visit_f64<E: Error>(self, v: f64) -> Result<Value, E> {
        Ok(Value::number(v))
    }

    fn visit_none<E: Error>(self) -> Result<Value, E> {
        self.visit_unit()
    }

    fn visit_unit<E: Error>(self) -> Result<Value, E> {
        Ok(Value::Missing)
    }

    fn visit_str<E: Error>(self, v: &str) -> Result<Value, E> {
        word(self.0, v)
    }
}

pub(super) struct QualitySeed;

impl<'de> DeserializeSeed<'de> for QualitySeed {
    type Value = Option<u32>;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Option<u32>, D::Error> {
        deserializer.deserialize_any(self)
    }
}

impl Visitor<'_> for QualitySeed {
    type Value = Option<u32>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("\"q\" as an integer of 32 bits")
    }

    /// A status code with its highest bit set is negative where codes are signed.
    fn visit_i64<E: Error>(self, v: i64) -> Result<Option<u32>, E> {
        let wide = || E::custom(format!("q = {v} does not fit into 32 bits"));
        i32::try_from(v).map(|code| Some(code.cast_unsigned())).map_err(|_| wide())
    }

    fn visit_u64<E: Error>(self, v: u64) -> Result<Option<u32>, E> {
        u32::try_from(v).map(Some).map_err(|_| E::custom(format!("q = {v} does not fit into 32 bits")))
    }

    fn visit_f64<E: Error>(self, v: f64) -> Result<Option<u32>, E> {
        if v.fract() == 0.0 && (0.0..=f64::from(u32::MAX)).contains(&v) {
            return Ok(Some(v as u32));
        }
        Err(E::custom(format!("q = {v} is not an integer of 32 bits")))
    }

    fn visit_none<E: Error>(self) -> Result<Option<u32>, E> {
        self.visit_unit()
    }

    fn visit_unit<E: Error>(self) -> Result<Option<u32>, E> {
        Ok(None)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
            (r#"{"v":"open"}"#, "takes a number"),
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
