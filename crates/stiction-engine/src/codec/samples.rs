//! Samples in a self-describing form: a number, an object of time, value and quality, or an array of these; for JSON and
//! CBOR.

use serde::de::{DeserializeSeed, Deserializer, Error, IgnoredAny, MapAccess, SeqAccess, Visitor};
use std::fmt;
use stiction::core::record::{Mode, Sample, Signal, Value};
use stiction::core::units::parse_time;

use super::MAX_SAMPLES;

/// Reads the samples of one payload; `crowded` is set if there are too many.
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

/// Meaning of a text: not finite, a mode, or an error.
fn word<E: Error>(signal: Signal, text: &str) -> Result<Value, E> {
    let trimmed = text.trim();
    let blank = trimmed.is_empty() || trimmed.parse::<f64>().is_ok_and(|number| !number.is_finite());
    match (blank, signal) {
        (true, _) => Ok(Value::Missing),
        (false, Signal::Mode) => Ok(Value::Mode(Mode::from_word(trimmed))),
        (false, _) => {
            let short: String = trimmed.chars().take(40).collect();
            Err(E::custom(format!("{short:?} is text, but {} needs a number", signal.name())))
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
        let late = || E::custom(format!("t = {v} is after the year 2262, the limit of nanoseconds in 64 bits"));
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

    /// A status code with its highest bit set is negative in languages with signed integers.
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
