//! The recorded form of a sample: `{"t":<ns>,"v":<number|null|"auto">,"q":<code>}`, with `q` only if sent.

use super::{CodecError, decode};
use std::io::Write;
use stiction::core::record::{Sample, Signal, Value};

/// Appends the sample's recorded form to `out`; [`decode_recorded`] restores it bit for bit.
///
/// A number that is not finite becomes null.
pub fn encode_recorded(sample: &Sample, out: &mut Vec<u8>) {
    // Writing into memory cannot fail. `{:?}` is the shortest text that reads back equal, and always valid JSON.
    let _ = write!(out, "{{\"t\":{},\"v\":", sample.t_ns);
    let _ = match sample.value {
        Value::Number(number) if number.is_finite() => write!(out, "{number:?}"),
        Value::Mode(mode) => write!(out, "\"{}\"", mode.name()),
        Value::Number(_) | Value::Missing => write!(out, "null"),
    };
    let _ = match sample.quality {
        Some(code) => write!(out, ",\"q\":{code}}}"),
        None => write!(out, "}}"),
    };
}

/// Reads one sample from its recorded form.
///
/// # Errors
/// [`CodecError`] for anything that is not exactly one sample with its time.
pub fn decode_recorded(signal: Signal, payload: &[u8]) -> Result<Sample, CodecError> {
    // The earliest time serves as the marker for an absent time.
    let mut out = Vec::with_capacity(1);
    decode(signal, payload, Some("application/json"), None, i64::MIN, &mut out)?;
    let [sample] = out[..] else { return Err(CodecError::NotOneSample(out.len())) };
    if sample.t_ns == i64::MIN && !payload.windows(4).any(|w| w == b"\"t\":") {
        return Err(CodecError::NotOneSample(0));
    }
    Ok(sample)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use stiction::core::record::Mode;

    fn recorded(sample: &Sample) -> String {
        let mut out = Vec::new();
        encode_recorded(sample, &mut out);
        String::from_utf8(out).unwrap()
    }

    #[test]
    fn the_form_is_fixed() {
        let mut sample = Sample { signal: Signal::Op, t_ns: -3, value: Value::Number(0.1), quality: Some(7) };
        assert_eq!(recorded(&sample), r#"{"t":-3,"v":0.1,"q":7}"#);
        sample.value = Value::Missing;
        sample.quality = None;
        assert_eq!(recorded(&sample), r#"{"t":-3,"v":null}"#);
        sample.value = Value::Mode(Mode::Cascade);
        assert_eq!(recorded(&sample), r#"{"t":-3,"v":"cascade"}"#);
        assert!(decode_recorded(Signal::Op, b"1.5").is_err());
        assert!(decode_recorded(Signal::Op, br#"[{"t":1,"v":1},{"t":2,"v":1}]"#).is_err());
    }

    #[test]
    fn the_ends_of_time_and_number_read_back() {
        for value in [-0.0, 0.0, f64::MIN_POSITIVE, 5e-324, f64::MAX, f64::MIN, 0.1 + 0.2, 1e21, 123_456_789.0] {
            for t_ns in [i64::MIN, i64::MAX, 0, -1] {
                let sample = Sample { signal: Signal::Pv, t_ns, value: Value::Number(value), quality: None };
                let back = decode_recorded(Signal::Pv, recorded(&sample).as_bytes()).unwrap();
                assert_eq!(back.t_ns, t_ns);
                assert_eq!(back.value.as_number().map(f64::to_bits), Some(value.to_bits()));
            }
        }
    }

    proptest! {
        #[test]
        fn samples_read_back_equal(bits in any::<u64>(), t_ns in any::<i64>(), quality in any::<Option<u32>>(), pick in 0..6_u8) {
            let (signal, value) = match pick {
                0 => (Signal::Mode, Value::Mode(Mode::Manual)),
                1 => (Signal::Mode, Value::Mode(Mode::Unknown)),
                2 => (Signal::Op, Value::Missing),
                _ => (Signal::Pv, Value::number(f64::from_bits(bits))),
            };
            let sample = Sample { signal, t_ns, value, quality };
            let back = decode_recorded(signal, recorded(&sample).as_bytes()).unwrap();
            prop_assert_eq!(back, sample);
            if let (Some(a), Some(b)) = (back.value.as_number(), sample.value.as_number()) {
                prop_assert_eq!(a.to_bits(), b.to_bits());
            }
        }
    }
}
