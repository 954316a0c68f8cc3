//! CBOR (RFC 8949) with the structure of [`super::json`].

use cbor4ii::core::dec::Read;
use cbor4ii::core::utils::SliceReader;
use cbor4ii::serde::Deserializer;
use serde::Deserialize;
use serde::de::IgnoredAny;

use super::fields::{Bundle, Field, Memory};
use super::samples::read_samples;
use super::{Codec, CodecError, MAX_SAMPLES, named};
use stiction::core::record::{Sample, Signal};

/// The format `cbor`.
#[derive(Debug, Clone, Copy)]
pub struct Cbor;

impl Codec for Cbor {
    fn name(&self) -> &'static str {
        "cbor"
    }

    fn speaks(&self, media_type: &str) -> bool {
        media_type == "application/cbor" || media_type.ends_with("+cbor")
    }

    /// A tagged float, or a map or array that spans all bytes. Eight bytes may also be a raw f64, so they must be a map whose
    /// first key is text. Integers look like anything; they need an encoding or a configured codec.
    fn sniff(&self, payload: &[u8]) -> bool {
        match payload {
            [0xfb, ..] => payload.len() == 9,
            [0xfa, ..] => payload.len() == 5,
            [0xf9, ..] => payload.len() == 3,
            [0xa1..=0xb7, 0x61..=0x77, ..] => is_whole(payload),
            // Text cannot begin like this: these bytes only follow others in UTF-8.
            [0x80..=0xbf, ..] => payload.len() != 8 && is_whole(payload),
            _ => false,
        }
    }

    fn decode(
        &self,
        signal: Signal,
        payload: &[u8],
        fallback_t_ns: i64,
        out: &mut Vec<Sample>,
    ) -> Result<(), CodecError> {
        let mut crowded = false;
        let mut cbor = Deserializer::new(SliceReader::new(payload));
        match read_samples(&mut cbor, signal, fallback_t_ns, out, &mut crowded) {
            Err(_) if crowded => Err(CodecError::TooMany { limit: MAX_SAMPLES }),
            Err(error) => Err(wrong(error.to_string())),
            Ok(()) => ended(cbor),
        }
    }

    fn fields(&self, bundle: &Bundle<'_>, _: &mut Memory, out: &mut Vec<Field>) -> Result<(), CodecError> {
        let mut cbor = Deserializer::new(SliceReader::new(bundle.payload));
        let tree = serde_json::Value::deserialize(&mut cbor).map_err(|e| wrong(e.to_string()))?;
        ended(cbor)?;
        named::read(&tree, bundle.fallback_t_ns, out).map_err(wrong)
    }
}

fn wrong(why: String) -> CodecError {
    CodecError::Format { format: "CBOR", why }
}

/// Whether the bytes are exactly one item.
fn is_whole(payload: &[u8]) -> bool {
    let mut cbor = Deserializer::new(SliceReader::new(payload));
    IgnoredAny::deserialize(&mut cbor).is_ok() && ended(cbor).is_ok()
}

/// Checks that nothing follows the item.
fn ended(cbor: Deserializer<SliceReader<'_>>) -> Result<(), CodecError> {
    match cbor.into_inner().fill(1) {
        Ok(rest) if rest.as_ref().is_empty() => Ok(()),
        _ => Err(wrong("extra bytes after the item".to_owned())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::codec::decode;
    use stiction::core::record::Value;

    fn read(payload: &[u8]) -> Vec<(i64, Value, Option<u32>)> {
        let mut out = Vec::new();
        assert_eq!(decode(Signal::Pv, payload, Some("application/cbor"), None, 5, &mut out).unwrap(), "cbor");
        out.iter().map(|s| (s.t_ns, s.value, s.quality)).collect()
    }

    /// The examples are encoded as in RFC 8949, appendix A, and by Python's cbor2.
    #[test]
    fn every_shape_of_json_is_read() {
        assert_eq!(read(&[0xfb, 0x3f, 0xf1, 0x99, 0x99, 0x99, 0x99, 0x99, 0x9a]), [(5, Value::Number(1.1), None)]);
        assert_eq!(read(&[0xf9, 0x3e, 0x00]), [(5, Value::Number(1.5), None)]);
        assert_eq!(read(&[0x39, 0x03, 0xe7]), [(5, Value::Number(-1000.0), None)]);
        assert_eq!(read(&[0xf6]), [(5, Value::Missing, None)]);
        assert_eq!(read(&[0xf9, 0x7e, 0x00]), [(5, Value::Missing, None)]);
        // {"t": 9, "v": 2, "q": 0}, and an indefinite array of it and 3.
        let object = b"\xa3\x61t\x09\x61v\x02\x61q\x00";
        assert_eq!(read(object), [(9, Value::Number(2.0), Some(0))]);
        let array = [b"\x9f".as_slice(), object, b"\x03\xff"].concat();
        assert_eq!(read(&array), [(9, Value::Number(2.0), Some(0)), (5, Value::Number(3.0), None)]);
    }

    #[test]
    fn what_is_no_sample_is_refused() {
        let mut out = Vec::new();
        for bad in
            [&b"\xa1\x61t\x09"[..], b"\x9f", b"\x81\x81\x01", b"\xbf\x61v", b"\x5b\xff\xff\xff\xff\xff\xff\xff\xff"]
        {
            let said = decode(Signal::Pv, bad, Some("application/cbor"), None, 0, &mut out);
            assert!(matches!(said, Err(CodecError::Format { .. })), "{bad:x?}: {said:?}");
        }
        let deep = vec![0x81; 100_000];
        assert!(!Cbor.sniff(&deep));
        assert!(decode(Signal::Pv, &deep, Some("application/cbor"), None, 0, &mut out).is_err());
        assert!(out.is_empty());
    }

    #[test]
    fn raw_numbers_are_not_taken_for_it() {
        for number in [0.0, 1.0, 50.25, -3.5e-3, 1e9, f64::NAN] {
            assert!(!Cbor.sniff(&f64::to_le_bytes(number)), "{number}");
        }
        // {"q": 0, "v": 200} has eight bytes too.
        let mut out = Vec::new();
        assert_eq!(decode(Signal::Pv, b"\xa2\x61q\x00\x61v\x18\xc8", None, None, 0, &mut out).unwrap(), "cbor");
        assert_eq!(out[0].value, Value::Number(200.0));
    }
}
