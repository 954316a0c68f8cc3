//! OPC UA values in the form that the daemon reads: PubSub JSON with one field, source timestamp and status.

use serde_json::json;

use stiction::core::units::format_rfc3339;

/// Encoding of the payloads.
pub const ENCODING: &str = "application/opcua+uajson";

/// One value of one node.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reading {
    /// Its timestamp.
    pub t_ns: i64,
    /// `None` if the server has no value.
    pub value: Option<f64>,
    /// Status code, all 32 bits.
    pub status: u32,
}

/// How far a value can be trusted, from its status code.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Trust {
    /// Use it as it is.
    Good,
    /// Use it with doubt.
    Uncertain,
    /// There is no value.
    Bad,
}

/// The severity: the top two bits; the reserved fourth severity counts as bad.
pub const fn trust(status: u32) -> Trust {
    match status >> 30 {
        0 => Trust::Good,
        1 => Trust::Uncertain,
        _ => Trust::Bad,
    }
}

/// Whether the server dropped values of this node before this one because its queue was full. The bit counts only if the
/// info type says that the info bits belong to a data value.
pub const fn overflowed(status: u32) -> bool {
    (status >> 10) & 0b11 == 0b01 && status & 0x80 != 0
}

/// The payload of one value; a bad one is published as missing, with its code.
pub fn payload(reading: &Reading) -> Vec<u8> {
    let value = reading.value.filter(|_| trust(reading.status) != Trust::Bad);
    let mut field = json!({"Value": value, "SourceTimestamp": format_rfc3339(reading.t_ns)});
    if trust(reading.status) != Trust::Good {
        field["StatusCode"] = json!({"Code": reading.status & 0xFFFF_0000});
    }
    json!({"MessageType": "ua-data", "Messages": [{"Payload": {"value": field}}]}).to_string().into_bytes()
}

#[cfg(feature = "opcua")]
pub use server::reading;

#[cfg(feature = "opcua")]
mod server {
    use opcua::types::{DataValue, DateTime, Variant};

    use super::Reading;

    /// An array, a text or another value that is not a measurement.
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    pub struct NotANumber;

    /// A value from the server, with the source timestamp, else the server's, else the time of arrival.
    ///
    /// # Errors
    /// It is not a number, true or false.
    pub fn reading(data: &DataValue, now_ns: i64) -> Result<Reading, NotANumber> {
        let source = ns_of(data.source_timestamp.as_ref(), data.source_picoseconds);
        let stamp = source.or_else(|| ns_of(data.server_timestamp.as_ref(), data.server_picoseconds));
        let value = data.value.as_ref().map_or(Ok(None), number)?;
        Ok(Reading { t_ns: stamp.unwrap_or(now_ns), value, status: data.status.map_or(0, |status| status.bits()) })
    }

    /// A timestamp; `None` if absent, or if it is a sender's placeholder for none (the year 1601).
    fn ns_of(stamp: Option<&DateTime>, tens_of_picoseconds: Option<u16>) -> Option<i64> {
        let ns = stamp.filter(|stamp| !stamp.is_null())?.as_chrono().timestamp_nanos_opt()?;
        Some(ns + i64::from(tens_of_picoseconds.unwrap_or(0).min(9999) / 100))
    }

    fn number(value: &Variant) -> Result<Option<f64>, NotANumber> {
        let number = match value {
            Variant::Empty => return Ok(None),
            Variant::Boolean(on) => f64::from(u8::from(*on)),
            Variant::SByte(v) => f64::from(*v),
            Variant::Byte(v) => f64::from(*v),
            Variant::Int16(v) => f64::from(*v),
            Variant::UInt16(v) => f64::from(*v),
            Variant::Int32(v) => f64::from(*v),
            Variant::UInt32(v) => f64::from(*v),
            Variant::Int64(v) => *v as f64,
            Variant::UInt64(v) => *v as f64,
            Variant::Float(v) => f64::from(*v),
            Variant::Double(v) => *v,
            _ => return Err(NotANumber),
        };
        Ok(Some(number))
    }

    #[cfg(test)]
    mod tests {
        use super::*;
        use opcua::types::{StatusCode, UAString};

        const NS: i64 = 1_767_600_000_000_000_000;

        fn at(ns: i64) -> DateTime {
            // 100 ns from the year 1601 on.
            DateTime::from(ns / 100 + 116_444_736_000_000_000)
        }

        #[test]
        fn the_source_stamps_before_the_server() {
            let mut data = DataValue { value: Some(Variant::Int16(-7)), ..DataValue::null() };
            assert_eq!(reading(&data, 5).map(|r| r.t_ns), Ok(5));
            data.server_timestamp = Some(at(NS + 900));
            assert_eq!(reading(&data, 5).map(|r| r.t_ns), Ok(NS + 900));
            data.source_timestamp = Some(at(NS));
            data.source_picoseconds = Some(4200);
            assert_eq!(reading(&data, 5), Ok(Reading { t_ns: NS + 42, value: Some(-7.0), status: 0 }));
            data.source_timestamp = Some(DateTime::from(0_i64));
            assert_eq!(reading(&data, 5).map(|r| r.t_ns), Ok(NS + 900));
        }

        #[test]
        fn numbers_and_switches_pass_and_the_rest_does_not() {
            let of =
                |value: Variant| reading(&DataValue { value: Some(value), ..DataValue::null() }, 0).map(|r| r.value);
            assert_eq!(of(Variant::Boolean(true)), Ok(Some(1.0)));
            assert_eq!(of(Variant::UInt64(1 << 40)), Ok(Some((1_u64 << 40) as f64)));
            assert_eq!(of(Variant::Float(1.5)), Ok(Some(1.5)));
            assert_eq!(of(Variant::Empty), Ok(None));
            assert_eq!(of(Variant::String(UAString::from("7"))), Err(NotANumber));
            assert_eq!(of(Variant::from(vec![1.0_f64, 2.0])), Err(NotANumber));
            let bad = DataValue { status: Some(StatusCode::BadSensorFailure), ..DataValue::null() };
            assert_eq!(reading(&bad, 3), Ok(Reading { t_ns: 3, value: None, status: 0x808C_0000 }));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use stiction::core::record::{Signal, Value};
    use stiction_engine::codec;

    #[test]
    fn status_codes_say_trust_and_overflow() {
        assert_eq!(trust(0), Trust::Good);
        assert_eq!(trust(0x0000_0480), Trust::Good);
        assert_eq!(trust(0x4090_0000), Trust::Uncertain);
        assert_eq!(trust(0x808C_0000), Trust::Bad);
        assert_eq!(trust(0xC000_0000), Trust::Bad);
        assert!(overflowed(0x0000_0480) && overflowed(0x4090_0480));
        // Without the info type of data values the bit means something else.
        assert!(!overflowed(0x0000_0080) && !overflowed(0x0000_0400) && !overflowed(0x0000_0C80));
    }

    #[test]
    fn the_daemon_reads_what_is_sent() {
        let t_ns = 1_767_600_000_123_456_700;
        let read = |status: u32, value: Option<f64>, encoding: Option<&str>| {
            let mut out = Vec::new();
            let payload = payload(&Reading { t_ns, value, status });
            codec::decode(Signal::Pv, &payload, encoding, None, 0, &mut out).unwrap();
            assert_eq!(out.len(), 1);
            (out[0].t_ns, out[0].value, out[0].quality)
        };
        for encoding in [Some(ENCODING), None] {
            assert_eq!(read(0x480, Some(42.5), encoding), (t_ns, Value::Number(42.5), None));
            assert_eq!(read(0x4090_0480, Some(-1e-7), encoding), (t_ns, Value::Number(-1e-7), Some(0x4090_0000)));
            assert_eq!(read(0x808C_0000, Some(1.0), encoding), (t_ns, Value::Missing, Some(0x808C_0000)));
            assert_eq!(read(0, Some(f64::NAN), encoding).1, Value::Missing);
        }
    }
}
