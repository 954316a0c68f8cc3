//! OPC UA PubSub JSON (Part 14): network messages, single data set messages, and all forms of fields in use.
//!
//! A field is a raw value, a variant (`{"UaType", "Value"}` of 1.05, `{"Type", "Body"}` of 1.04), or a data value with status
//! and timestamps. Its time is its source timestamp, else the message's, else the arrival; its status is its own, else the
//! message's.

use serde_json::{Map, Value as Json};

use super::fields::{Bundle, Field, Memory, Scalar, ua_quality};
use super::json::tree;
use super::{Codec, CodecError, MAX_SAMPLES};
use stiction::core::units::parse_time;

/// Built-in types whose values are text in JSON: 64-bit integers.
const WIDE: [i64; 2] = [8, 9];

/// The format `ua-json`.
#[derive(Debug, Clone, Copy)]
pub struct PubSub;

impl Codec for PubSub {
    fn name(&self) -> &'static str {
        "opcua-pubsub-json"
    }

    fn speaks(&self, media_type: &str) -> bool {
        matches!(media_type, "application/opcua+uajson" | "application/ua+json" | "application/opcua+json")
    }

    fn sniff(&self, payload: &[u8]) -> bool {
        has_names(payload) && (has(payload, b"\"Messages\"") || has(payload, b"\"Payload\""))
    }

    fn fields(&self, bundle: &Bundle<'_>, _: &mut Memory, out: &mut Vec<Field>) -> Result<(), CodecError> {
        let (whole, fallback_t_ns) = (tree(bundle.payload)?, bundle.fallback_t_ns);
        let messages = match &whole {
            Json::Object(network) => network.get("Messages").unwrap_or(&whole),
            other => other,
        };
        match messages {
            Json::Array(all) => all.iter().try_for_each(|message| data_set(message, fallback_t_ns, out)),
            one => data_set(one, fallback_t_ns, out),
        }
    }
}

/// Whether JSON may contain the words of this format as names: not if its first text is a single letter, as in samples.
fn has_names(payload: &[u8]) -> bool {
    let starts = payload.iter().find(|b| !b.is_ascii_whitespace()).is_some_and(|b| b"[{".contains(b));
    let first = payload.iter().position(|b| *b == b'"');
    starts && first.is_some_and(|at| payload.get(at + 2).is_some_and(|b| *b != b'"'))
}

/// Whether a payload contains some bytes.
fn has(payload: &[u8], wanted: &[u8]) -> bool {
    payload.windows(wanted.len()).any(|window| window == wanted)
}

fn wrong(why: &str) -> CodecError {
    CodecError::Format { format: "OPC UA PubSub JSON", why: why.to_owned() }
}

/// One data set message; a keep-alive has no values.
fn data_set(message: &Json, fallback_t_ns: i64, out: &mut Vec<Field>) -> Result<(), CodecError> {
    let message = message.as_object().ok_or_else(|| wrong("a message is not an object"))?;
    let Some(payload) = message.get("Payload") else {
        let silent = message.get("MessageType").and_then(Json::as_str) == Some("ua-keepalive");
        return if silent { Ok(()) } else { Err(wrong("a message has no \"Payload\"")) };
    };
    let payload = payload.as_object().ok_or_else(|| wrong("\"Payload\" is not an object"))?;
    let writer = ["DataSetWriterName", "DataSetWriterId"].into_iter().find_map(|key| match message.get(key)? {
        Json::String(name) => Some(name.clone()),
        Json::Number(id) => Some(id.to_string()),
        _ => None,
    });
    let t_ns = time_of(message, "Timestamp")?.unwrap_or(fallback_t_ns);
    let status = status_of(message.get("Status"))?;
    for (name, field) in payload {
        if out.len() >= MAX_SAMPLES {
            return Err(CodecError::TooMany { limit: MAX_SAMPLES });
        }
        let (value, own_t_ns, own_status) = read_field(field)?;
        let quality = own_status.or(status).and_then(ua_quality);
        out.push(Field::new(writer.as_deref().unwrap_or_default(), name, own_t_ns.unwrap_or(t_ns), value, quality));
    }
    Ok(())
}

type Read = (Scalar, Option<i64>, Option<u32>);

fn read_field(field: &Json) -> Result<Read, CodecError> {
    let Json::Object(object) = field else { return Ok((scalar(field, false), None, None)) };
    if let Some(body) = object.get("Body") {
        return Ok((scalar(body, is_wide(object, "Type")), None, None));
    }
    let told = ["StatusCode", "SourceTimestamp", "ServerTimestamp", "Value", "UaType"];
    if !object.is_empty() && !told.iter().any(|key| object.contains_key(*key)) {
        return Err(wrong("a field is an object without \"Value\", \"Body\" or \"StatusCode\""));
    }
    let status = status_of(object.get("StatusCode").or_else(|| object.get("Status")))?;
    let t_ns = match time_of(object, "SourceTimestamp")? {
        None => time_of(object, "ServerTimestamp")?,
        own => own,
    };
    let value = match object.get("Value") {
        // A data value around a variant.
        Some(Json::Object(variant)) => match (variant.get("Value"), variant.get("Body")) {
            (Some(value), _) => scalar(value, is_wide(variant, "UaType")),
            (None, Some(body)) => scalar(body, is_wide(variant, "Type")),
            (None, None) => Scalar::Missing,
        },
        Some(value) => scalar(value, is_wide(object, "UaType")),
        None => Scalar::Missing,
    };
    Ok((value, t_ns, status))
}

fn is_wide(object: &Map<String, Json>, key: &str) -> bool {
    object.get(key).and_then(Json::as_i64).is_some_and(|kind| WIDE.contains(&kind))
}

fn scalar(value: &Json, wide: bool) -> Scalar {
    match value {
        Json::Number(number) => number.as_f64().map_or(Scalar::Missing, Scalar::Number),
        Json::Bool(on) => Scalar::Number(f64::from(u8::from(*on))),
        // JSON cannot express values that are not finite, and 64-bit integers are written as text.
        Json::String(text) if wide || matches!(text.as_str(), "NaN" | "Infinity" | "-Infinity") => {
            text.parse().map_or(Scalar::Missing, Scalar::Number)
        }
        Json::String(text) => Scalar::Text(text.clone()),
        Json::Null | Json::Array(_) | Json::Object(_) => Scalar::Missing,
    }
}

fn status_of(status: Option<&Json>) -> Result<Option<u32>, CodecError> {
    let code = match status {
        None | Some(Json::Null) => return Ok(None),
        // Good is an empty object without a code.
        Some(Json::Object(object)) => match object.get("Code") {
            None => return Ok(Some(0)),
            Some(code) => code.as_u64(),
        },
        Some(code) => code.as_u64(),
    };
    code.and_then(|code| u32::try_from(code).ok())
        .map(Some)
        .ok_or_else(|| wrong("a status code is not a 32-bit number"))
}

fn time_of(object: &Map<String, Json>, key: &str) -> Result<Option<i64>, CodecError> {
    match object.get(key) {
        None | Some(Json::Null) => Ok(None),
        Some(Json::String(text)) if text.as_bytes().get(4) == Some(&b'-') => {
            parse_time(text).map(Some).map_err(|e| wrong(&format!("{key}: {e}")))
        }
        Some(_) => Err(wrong(&format!("{key} is not an RFC 3339 time"))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    type Read = (String, i64, Scalar, Option<u32>);

    fn read(text: &str) -> Result<Vec<Read>, CodecError> {
        let mut out = Vec::new();
        let bundle = Bundle { key: "k", payload: text.as_bytes(), fallback_t_ns: 7 };
        PubSub.fields(&bundle, &mut Memory::default(), &mut out)?;
        Ok(out.into_iter().map(|f| (f.name, f.t_ns, f.value, f.quality)).collect())
    }

    const NS: i64 = 1_546_300_800_000_000_000;

    #[test]
    fn every_form_of_message_and_field_is_read() {
        let network = r#"{"MessageId":"1","MessageType":"ua-data","PublisherId":"p","Messages":[{"DataSetWriterId":5,
            "DataSetWriterName":"w","Timestamp":"2019-01-01T00:00:00Z","Status":1073741824,"Payload":{"raw":1.5,
            "variant":{"UaType":11,"Value":2.5},"old":{"Type":11,"Body":3.5},"wide":{"UaType":8,"Value":"9"},
            "value":{"Value":4.5,"StatusCode":{"Code":2156724224,"Symbol":"BadSensorFailure"},
            "SourceTimestamp":"2019-01-01T00:00:01Z"},"both":{"Value":{"UaType":11,"Value":5.5},"StatusCode":{}},
            "bad":{"StatusCode":2156724224},"word":"AUTO","none":null,"on":true}}]}"#;
        let read = read(network).unwrap();
        let of = |name: &str| {
            let (_, t_ns, value, quality) = read.iter().find(|f| f.0 == format!("w.{name}")).unwrap();
            (*t_ns, value.clone(), *quality)
        };
        let uncertain = Some(0x4000_0000);
        assert_eq!(read.len(), 10);
        assert_eq!(of("raw"), (NS, Scalar::Number(1.5), uncertain));
        assert_eq!(of("variant").1, Scalar::Number(2.5));
        assert_eq!(of("old").1, Scalar::Number(3.5));
        assert_eq!(of("wide").1, Scalar::Number(9.0));
        assert_eq!(of("value"), (NS + 1_000_000_000, Scalar::Number(4.5), Some(0x808d_0000)));
        assert_eq!(of("both"), (NS, Scalar::Number(5.5), None));
        assert_eq!(of("bad"), (NS, Scalar::Missing, Some(0x808d_0000)));
        assert_eq!(of("word").1, Scalar::Text("AUTO".into()));
        assert_eq!((of("none").1, of("on").1), (Scalar::Missing, Scalar::Number(1.0)));
    }

    #[test]
    fn headers_may_be_left_out() {
        let bare = r#"{"DataSetWriterId":5,"Payload":{"x":1}}"#;
        assert_eq!(read(bare).unwrap(), [("5.x".to_owned(), 7, Scalar::Number(1.0), None)]);
        assert_eq!(read(&format!("[{bare},{bare}]")).unwrap().len(), 2);
        assert_eq!(read(&format!(r#"{{"MessageType":"ua-data","Messages":{bare}}}"#)).unwrap().len(), 1);
        assert_eq!(read(r#"{"Messages":[{"MessageType":"ua-keepalive"}]}"#).unwrap(), []);
        for bad in [
            "{}",
            r#"{"Payload":[1]}"#,
            r#"{"Payload":{"x":{"v":1}}}"#,
            r#"{"Payload":{"x":{"Value":1,"StatusCode":"Good"}}}"#,
            r#"{"Payload":{"x":{"Value":1,"SourceTimestamp":"yesterday"}}}"#,
            r#"{"Payload":{"x":1},"Timestamp":5}"#,
            "[1]",
        ] {
            assert!(read(bad).unwrap_err().to_string().contains("PubSub"), "{bad}");
        }
    }
}
