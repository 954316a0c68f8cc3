//! Decodes payloads to samples, and encodes samples for recordings.
//!
//! Each wire format is one file and one entry of [`ALL`]. [`decode`] chooses the format by the message's encoding if it names
//! one, else by the configuration, else by the bytes. [`decode_fields`] does the same for payloads with several named
//! signals. No payload can make decoding panic; [`MAX_PAYLOAD`] and [`MAX_SAMPLES`] bound the cost of a payload.

mod cbor;
mod f64le;
mod fields;
mod json;
mod named;
mod pubsub;
mod recorded;
mod samples;
mod sparkplug;
pub mod topic;

pub use cbor::Cbor;
pub use f64le::F64Le;
pub use fields::{Bundle, Field, Memory, Scalar};
pub use json::Json;
pub use pubsub::PubSub;
pub use recorded::{decode_recorded, encode_recorded};
pub use sparkplug::Sparkplug;

use stiction::core::record::{Sample, Signal};
use thiserror::Error;

/// Largest payload decoded, bytes.
pub const MAX_PAYLOAD: usize = 1 << 20;

/// Most samples per payload.
pub const MAX_SAMPLES: usize = 100_000;

/// Word of the configuration for recognising the format by the bytes.
const AUTO: &str = "auto";

/// One wire format.
pub trait Codec: Sync {
    /// Name in the configuration and in counters.
    fn name(&self) -> &'static str;

    /// Whether a media type (without parameters, lower case) names this format.
    fn speaks(&self, media_type: &str) -> bool;

    /// Whether the bytes look like this format.
    fn sniff(&self, payload: &[u8]) -> bool;

    /// Appends the payload's samples to `out`; samples without a time get `fallback_t_ns`.
    ///
    /// # Errors
    /// [`CodecError`] with what was found and what is accepted; `out` may then contain a part of the payload.
    fn decode(
        &self,
        signal: Signal,
        payload: &[u8],
        fallback_t_ns: i64,
        out: &mut Vec<Sample>,
    ) -> Result<(), CodecError> {
        let mut fields = Vec::new();
        self.fields(&Bundle { key: "", payload, fallback_t_ns }, &mut Memory::default(), &mut fields)?;
        fields::as_one_signal(&fields, signal, out)
    }

    /// Appends every named value of a payload with several signals.
    ///
    /// # Errors
    /// [`CodecError`] as [`Codec::decode`], also for a format without names.
    fn fields(&self, bundle: &Bundle<'_>, memory: &mut Memory, out: &mut Vec<Field>) -> Result<(), CodecError>;
}

impl core::fmt::Debug for dyn Codec {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(self.name())
    }
}

impl PartialEq for dyn Codec {
    fn eq(&self, other: &Self) -> bool {
        self.name() == other.name()
    }
}

/// The format that a configuration names; `None` to recognise it by the bytes.
pub type ConfiguredCodec = Option<&'static dyn Codec>;

/// All formats in the order of recognition: those with distinctive marks first.
pub static ALL: [&dyn Codec; 5] = [&Cbor, &F64Le, &PubSub, &Json, &Sparkplug];

/// What a configuration may choose, the default first.
#[must_use]
pub fn choices() -> Vec<(&'static str, ConfiguredCodec)> {
    core::iter::once((AUTO, None)).chain(ALL.map(|codec| (codec.name(), Some(codec)))).collect()
}

/// Writes the word of a choice, as the configuration has it.
///
/// # Errors
/// Those of the serializer.
#[allow(clippy::trivially_copy_pass_by_ref, reason = "serde passes a reference")]
pub fn serialize_choice<S: serde::Serializer>(choice: &ConfiguredCodec, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(choice.map_or(AUTO, Codec::name))
}

fn names() -> String {
    ALL.map(Codec::name).join(", ")
}

/// A payload without samples.
#[derive(Debug, Error, Clone, PartialEq, Eq)]
pub enum CodecError {
    /// Empty payload.
    #[error("the payload is empty; send a JSON number, an object {{\"t\":…,\"v\":…}} or 8 bytes of little-endian f64")]
    Empty,
    /// Payload too large.
    #[error("the payload has {bytes} bytes, the limit is {limit}; send smaller batches")]
    TooLarge {
        /// Size of the payload, bytes.
        bytes: usize,
        /// [`MAX_PAYLOAD`].
        limit: usize,
    },
    /// Too many samples.
    #[error("the payload has more than {limit} samples; send smaller batches")]
    TooMany {
        /// [`MAX_SAMPLES`].
        limit: usize,
    },
    /// Invalid JSON; the text says where and what.
    #[error("not a JSON sample: {0}; send a number, {{\"t\":ns,\"v\":number}} or an array of these")]
    Json(String),
    /// A raw value of the wrong size.
    #[error("a raw f64 has 8 bytes, this payload has {bytes}; check the publisher's data type")]
    Length {
        /// Size of the payload, bytes.
        bytes: usize,
    },
    /// An invalid payload of a format other than JSON; the text says where and what.
    #[error("not {format}: {why}")]
    Format {
        /// Name of the format.
        format: &'static str,
        /// What is wrong.
        why: String,
    },
    /// Several names on a key of one signal.
    #[error(
        "the payload has several values ({first:?}, {other:?}), but the key is mapped to one signal; \
         configure the key as a [[bundle]], or map KEY#{first} in [[loop]]"
    )]
    Several {
        /// The first name.
        first: String,
        /// A different name.
        other: String,
    },
    /// Values without names in a bundle.
    #[error("the values have no names; a [[bundle]] needs a format with names, such as {{\"FIC101.OP\": 42.5}}")]
    NoNames,
    /// The message names an encoding that is not supported.
    #[error("the encoding {0:?} is not read; send one of {all}, or set codec in the configuration if it is one of these", all = names())]
    Encoding(String),
    /// No format recognises the bytes.
    #[error("unknown format ({bytes} bytes, first byte 0x{first:02x}); set codec in the configuration")]
    Unrecognised {
        /// Size of the payload, bytes.
        bytes: usize,
        /// Its first byte.
        first: u8,
    },
    /// A recorded payload that is not exactly one sample with its time.
    #[error("a recorded payload must have exactly one sample with its time, this one has {0}; the file is damaged")]
    NotOneSample(usize),
}

/// The format named by a message's encoding, if any: `application/json;schema` is JSON; `application/octet-stream` and a
/// bus's default for bytes name none.
#[must_use]
pub fn by_encoding(encoding: &str) -> Option<&'static dyn Codec> {
    let media_type = encoding.split(';').next().unwrap_or("").trim().to_ascii_lowercase();
    ALL.into_iter().find(|codec| codec.speaks(&media_type))
}

/// Whether an encoding names no format: bytes of any kind.
fn is_unnamed(encoding: &str) -> bool {
    let media_type = encoding.split(';').next().unwrap_or("").trim().to_ascii_lowercase();
    matches!(media_type.as_str(), "" | "zenoh/bytes" | "application/octet-stream" | "bytes" | "raw")
}

/// Appends the samples of one payload to `out`. Returns the name of the format.
///
/// `encoding` is the message's encoding. Samples without a time get `fallback_t_ns`.
///
/// # Errors
/// [`CodecError`]; `out` is then unchanged.
pub fn decode(
    signal: Signal,
    payload: &[u8],
    encoding: Option<&str>,
    configured: ConfiguredCodec,
    fallback_t_ns: i64,
    out: &mut Vec<Sample>,
) -> Result<&'static str, CodecError> {
    let codec = choose(payload, encoding, configured)?;
    let before = out.len();
    match codec.decode(signal, payload, fallback_t_ns, out) {
        Ok(()) => Ok(codec.name()),
        Err(error) => {
            out.truncate(before);
            Err(error)
        }
    }
}

/// Appends the named values of one payload to `out`. Returns the name of the format, chosen as in [`decode`].
///
/// # Errors
/// [`CodecError`]; `out` is then unchanged.
pub fn decode_fields(
    bundle: &Bundle<'_>,
    encoding: Option<&str>,
    configured: ConfiguredCodec,
    memory: &mut Memory,
    out: &mut Vec<Field>,
) -> Result<&'static str, CodecError> {
    let codec = choose(bundle.payload, encoding, configured)?;
    let before = out.len();
    let read = codec.fields(bundle, memory, out).and_then(|()| match out.len() - before {
        count if count > MAX_SAMPLES => Err(CodecError::TooMany { limit: MAX_SAMPLES }),
        _ => Ok(codec.name()),
    });
    if read.is_err() {
        out.truncate(before);
    }
    read
}

/// The format of a payload.
fn choose(
    payload: &[u8],
    encoding: Option<&str>,
    configured: ConfiguredCodec,
) -> Result<&'static dyn Codec, CodecError> {
    let Some(&first) = payload.first() else { return Err(CodecError::Empty) };
    if payload.len() > MAX_PAYLOAD {
        return Err(CodecError::TooLarge { bytes: payload.len(), limit: MAX_PAYLOAD });
    }
    match (encoding.and_then(by_encoding), configured) {
        (Some(codec), _) | (None, Some(codec)) => Ok(codec),
        // With an unknown encoding, eight bytes would be taken for a number.
        _ if encoding.is_some_and(|named| !is_unnamed(named)) => {
            Err(CodecError::Encoding(encoding.unwrap_or_default().chars().take(60).collect()))
        }
        _ => ALL
            .into_iter()
            .find(|codec| codec.sniff(payload))
            .ok_or(CodecError::Unrecognised { bytes: payload.len(), first }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use stiction::core::record::Value;

    fn one(payload: &[u8], encoding: Option<&str>, configured: ConfiguredCodec) -> (&'static str, Value) {
        let mut out = Vec::new();
        let name = decode(Signal::Pv, payload, encoding, configured, 7, &mut out).unwrap();
        assert_eq!(out.len(), 1);
        assert_eq!(out[0].t_ns, 7);
        (name, out[0].value)
    }

    #[test]
    fn the_encoding_decides_then_the_configuration_then_the_bytes() {
        let raw = 12.5_f64.to_le_bytes();
        assert_eq!(one(&raw, None, None), ("f64le", Value::Number(12.5)));
        assert_eq!(one(&raw, Some("zenoh/bytes"), None), ("f64le", Value::Number(12.5)));
        assert_eq!(one(b"12.5", Some("application/json;x"), Some(&F64Le)), ("json", Value::Number(12.5)));
        assert_eq!(one(b"12.50000", None, None), ("json", Value::Number(12.5)));
        assert_eq!(one(&[0; 8], None, None), ("f64le", Value::Number(0.0)));
        let ascii = *b"12.50000";
        assert_eq!(one(&ascii, None, Some(&F64Le)).0, "f64le");
        assert_eq!(one(&f64::NAN.to_le_bytes(), None, None), ("f64le", Value::Missing));
        // 50.something whose bytes all happen to be printable.
        let printable = *b"#)9k3.I@";
        assert_eq!(one(&printable, None, None).0, "f64le");
    }

    #[test]
    fn refusals_name_the_remedy() {
        let mut out = Vec::new();
        let mut refuse = |payload: &[u8], encoding, configured: ConfiguredCodec| {
            decode(Signal::Op, payload, encoding, configured, 0, &mut out).unwrap_err()
        };
        assert_eq!(refuse(b"", None, None), CodecError::Empty);
        assert_eq!(refuse(b"\x01\x02", None, None), CodecError::Unrecognised { bytes: 2, first: 1 });
        assert_eq!(refuse(b"\x01\x02", None, Some(&F64Le)), CodecError::Length { bytes: 2 });
        for encoding in ["cdr", "ros1", "protobuf", "image/png", "zenoh/serialized"] {
            let told = refuse(&12.5_f64.to_le_bytes(), Some(encoding), None).to_string();
            assert!(told.contains(encoding) && told.contains("codec"), "{told}");
            assert_eq!(one(&12.5_f64.to_le_bytes(), Some(encoding), Some(&F64Le)).1, Value::Number(12.5));
        }
        assert!(matches!(refuse(&vec![b' '; MAX_PAYLOAD + 1], None, None), CodecError::TooLarge { .. }));
        let crowd = format!("[{}1]", "1,".repeat(MAX_SAMPLES));
        assert_eq!(refuse(crowd.as_bytes(), None, None), CodecError::TooMany { limit: MAX_SAMPLES });
        assert!(out.is_empty());
    }

    #[test]
    fn choices_have_different_words() {
        let words: std::collections::HashSet<_> = choices().into_iter().map(|(word, _)| word).collect();
        assert_eq!(words.len(), ALL.len() + 1);
    }

    proptest! {
        #[test]
        fn no_bytes_panic(payload in proptest::collection::vec(any::<u8>(), 0..200), pick in 0..ALL.len() + 1) {
            let configured = ALL.get(pick).copied();
            let mut out = Vec::new();
            let result = decode(Signal::Mode, &payload, None, configured, 0, &mut out);
            prop_assert!(result.is_ok() || out.is_empty());
            let (mut fields, bundle) = (Vec::new(), Bundle { key: "k", payload: &payload, fallback_t_ns: 0 });
            let result = decode_fields(&bundle, None, configured, &mut Memory::default(), &mut fields);
            prop_assert!(result.is_ok() || fields.is_empty());
        }

        #[test]
        fn nothing_like_json_panics(payload in "[\\[\\]{}\",:tvqeE+.0-9nulNaIfiy \\\\-]{0,60}") {
            let mut out = Vec::new();
            let _ = decode(Signal::Op, payload.as_bytes(), Some("application/json"), None, 0, &mut out);
            prop_assert!(out.iter().all(|s| s.value.as_number().is_none_or(f64::is_finite)));
        }
    }
}
