//! A raw little-endian f64: 8 bytes, no time, no quality.

use super::{Codec, CodecError};
use crate::record::{Sample, Signal, Value};

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

    /// Eight bytes of plain text are text: read as f64 they would be a value no plant sends.
    fn sniff(&self, payload: &[u8]) -> bool {
        payload.len() == 8 && !payload.iter().all(|b| b.is_ascii_graphic() || b.is_ascii_whitespace())
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
}
