//! Sparkplug B: metrics in protobuf, on topics that name the sender.
//!
//! Only birth messages always name their metrics; data messages may use an alias in place of name and type. The names of
//! births are therefore kept ([`Memory`]), as far as there is room, until the next birth or death of the same node or
//! device. Timestamps are in milliseconds. Commands are not measurements and deaths have no values; both are ignored.

use prost::Message;

use super::fields::{AliasedMetric, Bundle, Field, Memory, Scalar, sparkplug_quality};
use super::{Codec, CodecError, MAX_SAMPLES};

/// Topic level below which all Sparkplug B messages are.
const NAMESPACE: &str = "spBv1.0";

/// The format `sparkplug-b`.
#[derive(Debug, Clone, Copy)]
pub struct Sparkplug;

/// The fields read from a payload (Sparkplug 3.0, `sparkplug_b.proto`).
#[derive(Clone, PartialEq, Message)]
struct Payload {
    #[prost(uint64, optional, tag = "1")]
    timestamp: Option<u64>,
    #[prost(message, repeated, tag = "2")]
    metrics: Vec<Metric>,
}

#[derive(Clone, PartialEq, Message)]
struct Metric {
    #[prost(string, optional, tag = "1")]
    name: Option<String>,
    #[prost(uint64, optional, tag = "2")]
    alias: Option<u64>,
    #[prost(uint64, optional, tag = "3")]
    timestamp: Option<u64>,
    #[prost(uint32, optional, tag = "4")]
    datatype: Option<u32>,
    #[prost(bool, optional, tag = "7")]
    is_null: Option<bool>,
    #[prost(message, optional, tag = "9")]
    properties: Option<PropertySet>,
    #[prost(oneof = "MetricValue", tags = "10, 11, 12, 13, 14, 15")]
    value: Option<MetricValue>,
}

#[derive(Clone, PartialEq, prost::Oneof)]
enum MetricValue {
    #[prost(uint32, tag = "10")]
    Int(u32),
    #[prost(uint64, tag = "11")]
    Long(u64),
    #[prost(float, tag = "12")]
    Float(f32),
    #[prost(double, tag = "13")]
    Double(f64),
    #[prost(bool, tag = "14")]
    Bool(bool),
    #[prost(string, tag = "15")]
    Text(String),
}

#[derive(Clone, PartialEq, Message)]
struct PropertySet {
    #[prost(string, repeated, tag = "1")]
    keys: Vec<String>,
    #[prost(message, repeated, tag = "2")]
    values: Vec<PropertyValue>,
}

#[derive(Clone, PartialEq, Message)]
struct PropertyValue {
    #[prost(uint32, optional, tag = "3")]
    int: Option<u32>,
    #[prost(uint64, optional, tag = "4")]
    long: Option<u64>,
}

/// Sender and message type.
struct Sender<'a> {
    kind: &'a str,
    /// Group, node and device.
    whole: String,
    /// The device, or the node for its own messages.
    short: &'a str,
}

impl<'a> Sender<'a> {
    /// From `…/spBv1.0/GROUP/KIND/NODE[/DEVICE]`; for other keys the key names the sender.
    fn of(key: &'a str) -> Self {
        let chunks: Vec<&str> = key.split('/').skip_while(|chunk| *chunk != NAMESPACE).skip(1).collect();
        match chunks[..] {
            [group, kind, node] => Self { kind, whole: format!("{group}/{node}"), short: node },
            [group, kind, node, device] => Self { kind, whole: format!("{group}/{node}/{device}"), short: device },
            ["STATE", ..] => Self { kind: "STATE", whole: String::new(), short: "" },
            _ => Self { kind: "DDATA", whole: key.to_owned(), short: "" },
        }
    }
}

impl Codec for Sparkplug {
    fn name(&self) -> &'static str {
        "sparkplug-b"
    }

    fn speaks(&self, media_type: &str) -> bool {
        matches!(media_type, "application/vnd.sparkplug-b" | "application/x-sparkplug-b")
    }

    /// Whether it begins with a timestamp of this century and is complete.
    fn sniff(&self, payload: &[u8]) -> bool {
        let stamped = payload.first() == Some(&0x08) && payload.len() > 8;
        stamped
            && Payload::decode(payload)
                .is_ok_and(|p| p.timestamp.is_some_and(|ms| (946_684_800_000..4_102_444_800_000).contains(&ms)))
    }

    fn fields(&self, bundle: &Bundle<'_>, memory: &mut Memory, out: &mut Vec<Field>) -> Result<(), CodecError> {
        let sender = Sender::of(bundle.key);
        let births = match sender.kind {
            "STATE" | "NCMD" | "DCMD" => return Ok(()),
            "NDEATH" | "DDEATH" => {
                memory.forget(&sender.whole);
                return Ok(());
            }
            "NBIRTH" | "DBIRTH" => true,
            _ => false,
        };
        let payload = Payload::decode(bundle.payload).map_err(|e| wrong(e.to_string()))?;
        if payload.metrics.len() > MAX_SAMPLES {
            return Err(CodecError::TooMany { limit: MAX_SAMPLES });
        }
        if births {
            memory.forget(&sender.whole);
        }
        memory.hear(&sender.whole);
        let t_ns = payload.timestamp.and_then(ns_from_ms).unwrap_or(bundle.fallback_t_ns);
        let mut nameless = None;
        for metric in payload.metrics {
            match named(&metric, &sender.whole, births, memory) {
                Some((name, kind)) => out.push(field(metric, &sender, name, kind, t_ns)),
                None => nameless = nameless.or(Some(metric.alias.unwrap_or_default())),
            }
        }
        match nameless {
            // Metrics with names are used all the same.
            Some(alias) if out.is_empty() => Err(wrong(format!(
                "alias {alias} of {:?} has no name yet; wait for the next birth message or request a rebirth",
                sender.whole
            ))),
            _ => Ok(()),
        }
    }
}

fn wrong(why: String) -> CodecError {
    CodecError::Format { format: "Sparkplug B", why }
}

/// Name and type of a metric: its own, else those of its birth message.
fn named(metric: &Metric, device: &str, births: bool, memory: &mut Memory) -> Option<(String, u32)> {
    let known = metric.alias.and_then(|alias| memory.named(device, alias));
    let kind = metric.datatype.or(known.map(|k| k.kind)).unwrap_or_default();
    let Some(name) = metric.name.clone().filter(|name| !name.is_empty()) else {
        return known.map(|known| (known.name.clone(), kind));
    };
    if let (true, Some(alias)) = (births, metric.alias) {
        memory.learn(device, alias, AliasedMetric { name: name.clone(), kind });
    }
    Some((name, kind))
}

fn field(metric: Metric, sender: &Sender<'_>, name: String, kind: u32, t_ns: i64) -> Field {
    let quality = metric.properties.as_ref().and_then(quality_of);
    let t_ns = metric.timestamp.and_then(ns_from_ms).unwrap_or(t_ns);
    let value = match metric.value {
        _ if metric.is_null == Some(true) => Scalar::Missing,
        None => Scalar::Missing,
        Some(value) => scalar(value, kind),
    };
    Field { of: sender.short.to_owned(), ..Field::new("", &name, t_ns, value, quality) }
}

/// The property `Quality`.
fn quality_of(properties: &PropertySet) -> Option<u32> {
    let at = properties.keys.iter().position(|key| key.eq_ignore_ascii_case("quality"))?;
    let value = properties.values.get(at)?;
    value.int.or_else(|| value.long.map(|code| u32::try_from(code).unwrap_or(u32::MAX))).and_then(sparkplug_quality)
}

/// Signed numbers are two's complement in unsigned fields; type 0 is unspecified.
fn scalar(value: MetricValue, kind: u32) -> Scalar {
    let number = match (value, kind) {
        (MetricValue::Text(text), _) => return Scalar::Text(text),
        (MetricValue::Int(v), 1) => f64::from(v as u8 as i8),
        (MetricValue::Int(v), 2) => f64::from(v as u16 as i16),
        (MetricValue::Int(v), 3) => f64::from(v as i32),
        (MetricValue::Int(v), _) => f64::from(v),
        (MetricValue::Long(v), 3) => f64::from(v as i32),
        (MetricValue::Long(v), 4) => v as i64 as f64,
        (MetricValue::Long(v), _) => v as f64,
        (MetricValue::Float(v), _) => f64::from(v),
        (MetricValue::Double(v), _) => v,
        (MetricValue::Bool(on), _) => f64::from(u8::from(on)),
    };
    Scalar::Number(number)
}

fn ns_from_ms(ms: u64) -> Option<i64> {
    i64::try_from(ms).ok()?.checked_mul(1_000_000)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn metric(name: Option<&str>, alias: Option<u64>, value: MetricValue) -> Metric {
        Metric { name: name.map(str::to_owned), alias, value: Some(value), ..Metric::default() }
    }

    fn read(memory: &mut Memory, key: &str, metrics: Vec<Metric>) -> Result<Vec<Field>, CodecError> {
        let payload = Payload { timestamp: Some(1_767_600_000_000), metrics }.encode_to_vec();
        let mut out = Vec::new();
        Sparkplug.fields(&Bundle { key, payload: &payload, fallback_t_ns: 7 }, memory, &mut out)?;
        assert_eq!(Sparkplug.sniff(&payload), payload.len() > 8);
        Ok(out)
    }

    #[test]
    fn names_and_types_come_from_the_birth() {
        let mut memory = Memory::default();
        let mut born = metric(Some("FIC101/OP"), Some(1), MetricValue::Int(u32::MAX));
        born.datatype = Some(3);
        let birth = read(&mut memory, "b/spBv1.0/g/DBIRTH/n/d", vec![born]).unwrap();
        assert_eq!((birth[0].name.as_str(), birth[0].of.as_str()), ("FIC101/OP", "d"));
        assert_eq!((birth[0].value.clone(), birth[0].t_ns), (Scalar::Number(-1.0), 1_767_600_000_000_000_000));
        let data = |memory: &mut Memory| {
            read(memory, "b/spBv1.0/g/DDATA/n/d", vec![metric(None, Some(1), MetricValue::Int(u32::MAX - 1))])
        };
        let field = data(&mut memory).unwrap().remove(0);
        assert_eq!((field.name.as_str(), field.value), ("FIC101/OP", Scalar::Number(-2.0)));
        assert_eq!(read(&mut memory, "b/spBv1.0/g/NDEATH/n", vec![]).unwrap(), []);
        let error = data(&mut memory).unwrap_err().to_string();
        assert!(error.contains("alias 1") && error.contains("birth"), "{error}");
    }

    #[test]
    fn values_nulls_stamps_and_quality_are_read() {
        let property = |code: u32| PropertySet {
            keys: vec!["Quality".into()],
            values: vec![PropertyValue { int: Some(code), long: None }],
        };
        let bad = Metric {
            properties: Some(property(500)),
            timestamp: Some(1_767_600_000_500),
            ..metric(Some("pv"), None, MetricValue::Double(1.5))
        };
        let good = Metric {
            properties: Some(property(192)),
            is_null: Some(true),
            ..metric(Some("op"), None, MetricValue::Float(2.5))
        };
        let fields = read(
            &mut Memory::default(),
            "s/spBv1.0/g/NDATA/n",
            vec![bad, good, metric(Some("mode"), None, MetricValue::Text("AUTO".into()))],
        )
        .unwrap();
        let seen: Vec<(i64, Scalar, Option<u32>)> = fields.into_iter().map(|f| (f.t_ns, f.value, f.quality)).collect();
        let t_ns = 1_767_600_000_000_000_000;
        assert_eq!(seen[0], (t_ns + 500_000_000, Scalar::Number(1.5), Some(0x8000_0000)));
        assert_eq!(seen[1], (t_ns, Scalar::Missing, None));
        assert_eq!(seen[2], (t_ns, Scalar::Text("AUTO".into()), None));
    }

    #[test]
    fn commands_and_states_give_nothing() {
        for key in ["spBv1.0/g/NCMD/n", "spBv1.0/g/DCMD/n/d", "spBv1.0/STATE/host1"] {
            assert_eq!(
                read(&mut Memory::default(), key, vec![metric(Some("op"), None, MetricValue::Int(1))]).unwrap(),
                []
            );
        }
    }

    #[test]
    fn values_with_names_are_taken_where_their_names_cannot_be_kept() {
        let mut memory = Memory::default();
        let long = "n".repeat(1000);
        let born =
            vec![metric(Some(&long), Some(1), MetricValue::Int(1)), metric(Some("OP"), Some(2), MetricValue::Int(2))];
        assert_eq!(read(&mut memory, "b/spBv1.0/g/NBIRTH/n", born).unwrap().len(), 2);
        assert_eq!(memory.take_lost(), 1);
        let data = vec![metric(None, Some(1), MetricValue::Int(1)), metric(None, Some(2), MetricValue::Int(2))];
        assert_eq!(read(&mut memory, "b/spBv1.0/g/NDATA/n", data).unwrap().len(), 1);
    }
}
