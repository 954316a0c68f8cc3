//! A raw little-endian f64: 8 bytes, no time, no quality.

use super::{Bundle, Codec, CodecError, Field, Memory};
use stiction::core::record::{Sample, Signal, Value};

/// The format `f64le`.
#[derive(Debug, Clone, Copy)]
pub struct F64Le;

impl Codec for F64Le {
    fn name(&self) -> &'static str {
        "f64le"
    }

    fn speaks(&self, media_type: &str) -> bool {
        matches!(media_type, "application/x-f64le" | "application/vnd.stictiond.f64le")
    }

    /// Eight bytes that are not text. By chance, one value in three hundred looks like text; it counts as a value if it is
    /// plausible for a plant and not JSON.
    fn sniff(&self, payload: &[u8]) -> bool {
        let Ok(bytes) = <[u8; 8]>::try_from(payload) else { return false };
        let text = payload.iter().all(|b| b.is_ascii_graphic() || b.is_ascii_whitespace());
        let sent = (1e-6..1e12).contains(&f64::from_le_bytes(bytes).abs());
        !text || sent && serde_json::from_slice::<serde::de::IgnoredAny>(payload).is_err()
    }

    fn decode(
        &self,
        signal: Signal,
        payload: &[u8],
        fallback_t_ns: i64,
        out: &mut Vec<Sample>,
    ) -> Result<(), CodecError> {
        let bytes: [u8; 8] = payload.try_into().map_err(|_| CodecError::Length { bytes: payload.len() })?;
        let value = Value::number(f64::from_le_bytes(bytes));
        out.push(Sample { signal, t_ns: fallback_t_ns, value, quality: None });
        Ok(())
    }

    fn fields(&self, _: &Bundle<'_>, _: &mut Memory, _: &mut Vec<Field>) -> Result<(), CodecError> {
        Err(CodecError::NoNames)
    }
}
