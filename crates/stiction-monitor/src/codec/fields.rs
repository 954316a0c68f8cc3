//! Named values of payloads with several signals.

use std::collections::HashMap;

use stiction_core::record::{Mode, Sample, Signal, Value};

use super::CodecError;

/// A received payload that may have several signals.
#[derive(Debug, Clone, Copy)]
pub struct Bundle<'a> {
    /// Its key, which names the sender for Sparkplug B.
    pub key: &'a str,
    /// Its bytes.
    pub payload: &'a [u8],
    /// Time for values without their own, ns since 1970.
    pub fallback_t_ns: i64,
}

/// Most names kept in [`Memory`].
const MAX_NAMES: usize = 1_000_000;

/// State kept between payloads: the names of Sparkplug B's aliases, by device.
#[derive(Debug, Default)]
pub struct Memory {
    devices: HashMap<String, HashMap<u64, AliasedMetric>>,
    names: usize,
}

/// Meaning of an alias, from a birth message.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct AliasedMetric {
    /// The metric's name.
    pub name: String,
    /// Its data type, which later messages may omit.
    pub kind: u32,
}

impl Memory {
    /// Keeps a name; returns false if there are too many.
    pub(super) fn learn(&mut self, device: &str, alias: u64, named: AliasedMetric) -> bool {
        if self.names >= MAX_NAMES {
            return false;
        }
        if !self.devices.contains_key(device) {
            self.devices.insert(device.to_owned(), HashMap::new());
        }
        if self.devices.get_mut(device).is_some_and(|table| table.insert(alias, named).is_none()) {
            self.names += 1;
        }
        true
    }

    /// Meaning of an alias of a device.
    pub(super) fn named(&self, device: &str, alias: u64) -> Option<&AliasedMetric> {
        self.devices.get(device)?.get(&alias)
    }

    /// Forgets a device; for a node also its devices.
    pub(super) fn forget(&mut self, device: &str) {
        let below = |name: &str| name.strip_prefix(device).is_some_and(|rest| rest.is_empty() || rest.starts_with('/'));
        self.devices.retain(|name, _| !below(name));
        self.names = self.devices.values().map(HashMap::len).sum();
    }
}

/// The code of an OPC UA status, such that `[input] quality` reads it correctly under either convention: none for good, else
/// the upper half, whose lower bits never equal a good classic code.
pub(super) const fn ua_quality(status: u32) -> Option<u32> {
    if status >> 30 == 0 { None } else { Some(status & 0xFFFF_0000) }
}

/// The same for Sparkplug B's quality, where 192 is good, 0 bad and 500 stale.
pub(super) fn sparkplug_quality(code: u32) -> Option<u32> {
    const BAD: u32 = 0x8000_0000;
    (!(192..256).contains(&code)).then_some(BAD)
}

/// A value whose signal is not yet known.
#[derive(Debug, Clone, PartialEq)]
pub enum Scalar {
    /// A number; not finite if the sender has no value.
    Number(f64),
    /// A text, which may be a mode.
    Text(String),
    /// An explicit null.
    Missing,
}

/// One named value of a payload.
#[derive(Debug, Clone, PartialEq)]
pub struct Field {
    /// Full name: the sender's prefix, a dot, and its own name.
    pub name: String,
    /// Start of its own name in the full name.
    pub own: usize,
    /// Its owner if its own name only names a signal: device, writer or measurement. Empty: the key names the owner.
    pub of: String,
    /// Source time, ns since 1970.
    pub t_ns: i64,
    /// The value.
    pub value: Scalar,
    /// Quality code.
    pub quality: Option<u32>,
}

impl Field {
    /// A value with a name; `head` is its owner's name and may be empty.
    #[must_use]
    pub fn new(head: &str, own: &str, t_ns: i64, value: Scalar, quality: Option<u32>) -> Self {
        let (name, start) =
            if head.is_empty() { (own.to_owned(), 0) } else { (format!("{head}.{own}"), head.len() + 1) };
        Self { name, own: start, of: head.to_owned(), t_ns, value, quality }
    }

    /// Its own name without prefix.
    #[must_use]
    pub fn own_name(&self) -> &str {
        self.name.get(self.own..).unwrap_or(&self.name)
    }

    /// As a sample of a signal. A text that is not a mode is a missing value.
    #[must_use]
    pub fn sample(&self, signal: Signal) -> Sample {
        let value = match &self.value {
            Scalar::Number(number) => Value::number(*number),
            Scalar::Text(word) if signal == Signal::Mode => Value::Mode(Mode::from_word(word)),
            Scalar::Text(_) | Scalar::Missing => Value::Missing,
        };
        Sample { signal, t_ns: self.t_ns, value, quality: self.quality }
    }
}

/// The samples of a payload on the key of one signal; all values must have the same name.
pub(super) fn as_one_signal(fields: &[Field], signal: Signal, out: &mut Vec<Sample>) -> Result<(), CodecError> {
    if let (Some(first), Some(other)) = (fields.first(), fields.iter().find(|f| f.name != fields[0].name)) {
        return Err(CodecError::Several { first: short(&first.name), other: short(&other.name) });
    }
    out.extend(fields.iter().map(|field| field.sample(signal)));
    Ok(())
}

fn short(name: &str) -> String {
    name.chars().take(60).collect()
}

/// A timestamp in s, ms, us or ns since 1970, recognised by its size. Between 1975 and 2128 this is unambiguous; other times
/// are rejected.
pub(super) fn stamp_ns(number: f64) -> Option<i64> {
    let per_unit = match number {
        n if (1.5e8..5e9).contains(&n) => 1e9,
        n if (1.5e11..5e12).contains(&n) => 1e6,
        n if (1.5e14..5e15).contains(&n) => 1e3,
        n if (1.5e17..5e18).contains(&n) => 1.0,
        _ => return None,
    };
    // Whole numbers up to 2^53 stay exact; what is larger is in ns already, and was never more exact than its sender.
    Some((number * per_unit).round() as i64)
}

/// The same for an integer, exactly.
pub(super) fn stamp_ns_of(number: i64) -> Option<i64> {
    let per_unit = match number {
        150_000_000..5_000_000_000 => 1_000_000_000,
        150_000_000_000..5_000_000_000_000 => 1_000_000,
        150_000_000_000_000..5_000_000_000_000_000 => 1_000,
        150_000_000_000_000_000..5_000_000_000_000_000_000 => 1,
        _ => return None,
    };
    Some(number * per_unit)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stamps_tell_their_unit_by_their_size() {
        for (number, ns) in [
            (1_546_300_800, 1_546_300_800_000_000_000),
            (1_546_300_800_250, 1_546_300_800_250_000_000),
            (1_546_300_800_250_001, 1_546_300_800_250_001_000),
            (1_546_300_800_250_001_003, 1_546_300_800_250_001_003),
        ] {
            assert_eq!(stamp_ns_of(number), Some(ns));
        }
        assert_eq!(stamp_ns(1_546_300_800.5), Some(1_546_300_800_500_000_000));
        assert!([0, 43_466, 60_000_000_000, -5, i64::MAX].iter().all(|n| stamp_ns_of(*n).is_none()));
        assert!(stamp_ns(f64::NAN).is_none());
    }

    #[test]
    fn statuses_read_the_same_under_both_conventions() {
        assert_eq!([0, 0x0040_0000, 0x0000_0400].map(ua_quality), [None; 3]);
        assert_eq!([0x808c_0000, 0x4090_00ff].map(ua_quality), [Some(0x808c_0000), Some(0x4090_0000)]);
        assert_eq!([192, 216].map(sparkplug_quality), [None; 2]);
        assert!([0, 24, 500].into_iter().all(|code| sparkplug_quality(code) == Some(0x8000_0000)));
    }

    #[test]
    fn names_are_kept_by_device_and_within_bounds() {
        let (mut memory, named) = (Memory::default(), |name: &str| AliasedMetric { name: name.to_owned(), kind: 10 });
        for device in ["g/n", "g/n/d", "g/n2"] {
            assert!(memory.learn(device, 1, named(device)));
        }
        memory.forget("g/n");
        assert_eq!((memory.named("g/n/d", 1), memory.names), (None, 1));
        assert_eq!(memory.named("g/n2", 1), Some(&named("g/n2")));
        memory.names = MAX_NAMES;
        assert!(!memory.learn("g/n3", 1, named("x")));
    }

    #[test]
    fn one_signal_takes_one_name() {
        let field = |head: &str, own: &str| Field::new(head, own, 5, Scalar::Text("AUTO".into()), None);
        let mut out = Vec::new();
        as_one_signal(&[field("a", "x"), field("a", "x")], Signal::Mode, &mut out).unwrap();
        assert_eq!(out.iter().map(|s| s.value).collect::<Vec<_>>(), [Value::Mode(Mode::Auto); 2]);
        assert_eq!((field("a", "x").own_name(), field("", "x").own_name()), ("x", "x"));
        let error = as_one_signal(&[field("a", "x"), field("a", "y")], Signal::Pv, &mut out).unwrap_err();
        assert!(error.to_string().contains("KEY#a.x"), "{error}");
    }
}
