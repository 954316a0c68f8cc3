//! Telegraf's JSON (one metric, an array, or `{"metrics": [...]}`) and InfluxDB's line protocol.
//!
//! A value's name is `MEASUREMENT.FIELD`, or with tags `MEASUREMENT,TAG=VALUE,….FIELD` with the tags sorted by name.

use std::fmt::Write as _;

use serde_json::Value as Json;

use super::fields::{Bundle, Field, Memory, Scalar, stamp_ns, stamp_ns_of, ua_quality};
use super::json::tree;
use super::pubsub::{has, has_names};
use super::{Codec, CodecError, MAX_SAMPLES};

/// The format `telegraf-json`.
#[derive(Debug, Clone, Copy)]
pub struct TelegrafJson;

/// The format `line-protocol`.
#[derive(Debug, Clone, Copy)]
pub struct LineProtocol;

impl Codec for TelegrafJson {
    fn name(&self) -> &'static str {
        "telegraf-json"
    }

    fn speaks(&self, media_type: &str) -> bool {
        media_type == "application/vnd.telegraf+json"
    }

    fn sniff(&self, payload: &[u8]) -> bool {
        has_names(payload) && has(payload, b"\"fields\"") && has(payload, b"\"name\"")
    }

    fn fields(&self, bundle: &Bundle<'_>, _: &mut Memory, out: &mut Vec<Field>) -> Result<(), CodecError> {
        let (whole, fallback_t_ns) = (tree(bundle.payload)?, bundle.fallback_t_ns);
        match whole.get("metrics").unwrap_or(&whole) {
            Json::Array(all) => all.iter().try_for_each(|metric| read_metric(metric, fallback_t_ns, out)),
            one => read_metric(one, fallback_t_ns, out),
        }
    }
}

fn wrong(why: &str) -> CodecError {
    CodecError::Format { format: "Telegraf's JSON", why: why.to_owned() }
}

fn read_metric(metric: &Json, fallback_t_ns: i64, out: &mut Vec<Field>) -> Result<(), CodecError> {
    let name = metric.get("name").and_then(Json::as_str).ok_or_else(|| wrong("a metric has no \"name\""))?;
    let fields = metric.get("fields").and_then(Json::as_object).ok_or_else(|| wrong("a metric has no \"fields\""))?;
    // serde_json keeps an object's keys in their order of names.
    let tags = metric.get("tags").and_then(Json::as_object).into_iter().flatten();
    let series =
        Series::new(name, tags.map(|(tag, value)| (tag.clone(), value.as_str().unwrap_or_default().to_owned())));
    let t_ns = match metric.get("timestamp") {
        None | Some(Json::Null) => fallback_t_ns,
        Some(stamp) => {
            let exact = stamp.as_i64().map(stamp_ns_of);
            let told = exact.unwrap_or_else(|| stamp.as_f64().and_then(stamp_ns));
            told.ok_or_else(|| wrong(&format!("timestamp {stamp} is not a time in s, ms, us or ns since 1970")))?
        }
    };
    let read = fields.iter().map(|(field, value)| {
        let value = match value {
            Json::Number(number) => number.as_f64().map_or(Scalar::Missing, Scalar::Number),
            Json::Bool(on) => Scalar::Number(f64::from(u8::from(*on))),
            Json::String(text) => Scalar::Text(text.clone()),
            _ => Scalar::Missing,
        };
        (field.clone(), value)
    });
    series.put(read.collect(), t_ns, out)
}

/// Prefix of a metric's field names.
struct Series {
    /// `MEASUREMENT,TAG=VALUE,…`
    head: String,
    /// Owner of the fields: the tag `loop`, else the measurement.
    of: String,
}

impl Series {
    fn new(measurement: &str, tags: impl Iterator<Item = (String, String)>) -> Self {
        let (mut head, mut of) = (measurement.to_owned(), measurement.to_owned());
        for (tag, value) in tags {
            let _ = write!(head, ",{tag}={value}");
            if tag == "loop" {
                of = value;
            }
        }
        Self { head, of }
    }

    /// Appends a metric's fields; one called `quality` applies to the others.
    fn put(&self, fields: Vec<(String, Scalar)>, t_ns: i64, out: &mut Vec<Field>) -> Result<(), CodecError> {
        let is_quality = |name: &str| name.eq_ignore_ascii_case("quality");
        let quality = fields.iter().find(|(name, _)| is_quality(name)).and_then(|(_, value)| quality_of(value));
        for (name, value) in fields.into_iter().filter(|(name, _)| !is_quality(name)) {
            if out.len() >= MAX_SAMPLES {
                return Err(CodecError::TooMany { limit: MAX_SAMPLES });
            }
            out.push(Field { of: self.of.clone(), ..Field::new(&self.head, &name, t_ns, value, quality) });
        }
        Ok(())
    }
}

/// `OK (0x0)` as from Telegraf's OPC UA input, or a number in the configured convention.
fn quality_of(value: &Scalar) -> Option<u32> {
    match value {
        Scalar::Number(code) if code.fract() == 0.0 && (0.0..=f64::from(u32::MAX)).contains(code) => Some(*code as u32),
        Scalar::Text(text) => {
            let (_, code) = text.rsplit_once("(0x")?;
            u32::from_str_radix(code.strip_suffix(')')?, 16).ok().and_then(ua_quality)
        }
        Scalar::Number(_) | Scalar::Missing => None,
    }
}

impl Codec for LineProtocol {
    fn name(&self) -> &'static str {
        "line-protocol"
    }

    fn speaks(&self, media_type: &str) -> bool {
        matches!(media_type, "application/vnd.influx.line" | "text/x-line-protocol")
    }

    fn sniff(&self, payload: &[u8]) -> bool {
        let first = payload.iter().find(|b| !b.is_ascii_whitespace());
        let named = first.is_some_and(|b| b.is_ascii_alphabetic() || *b == b'_' || *b == b'#');
        named && has(payload, b"=") && has(payload, b" ")
    }

    fn fields(&self, bundle: &Bundle<'_>, _: &mut Memory, out: &mut Vec<Field>) -> Result<(), CodecError> {
        let text = std::str::from_utf8(bundle.payload).map_err(|_| no_line(1, "is not UTF-8"))?;
        for (at, line) in lines(text).into_iter().enumerate() {
            let line = line.trim();
            if !line.is_empty() && !line.starts_with('#') {
                read_line(line, bundle.fallback_t_ns, out).map_err(|why| no_line(at + 1, why))?;
            }
            if out.len() > MAX_SAMPLES {
                return Err(CodecError::TooMany { limit: MAX_SAMPLES });
            }
        }
        Ok(())
    }
}

fn no_line(line: usize, why: &str) -> CodecError {
    CodecError::Format { format: "line protocol", why: format!("line {line}: {why}") }
}

/// Lines; breaks inside quotes do not count.
fn lines(text: &str) -> Vec<&str> {
    pieces(text, '\n')
}

/// Splits a text at a character, except after a backslash and inside quotes.
fn pieces(text: &str, at: char) -> Vec<&str> {
    let (mut out, mut start, mut quoted, mut escaped) = (Vec::new(), 0, false, false);
    for (place, c) in text.char_indices() {
        match c {
            _ if escaped => escaped = false,
            '\\' => escaped = true,
            '"' => quoted = !quoted,
            c if c == at && !quoted => {
                out.push(&text[start..place]);
                start = place + c.len_utf8();
            }
            _ => {}
        }
    }
    out.push(&text[start..]);
    out
}

/// Removes the protocol's backslashes before a comma, equals sign or space.
fn plain(text: &str) -> String {
    ["\\,", "\\=", "\\ "].iter().fold(text.to_owned(), |text, escape| text.replace(escape, &escape[1..]))
}

/// `measurement[,tag=value…] field=value[,field=value…] [timestamp]`
fn read_line(line: &str, fallback_t_ns: i64, out: &mut Vec<Field>) -> Result<(), &'static str> {
    let parts: Vec<&str> = pieces(line, ' ').into_iter().filter(|part| !part.is_empty()).collect();
    let (series, fields, stamp) = match parts[..] {
        [series, fields] => (series, fields, None),
        [series, fields, stamp] => (series, fields, Some(stamp)),
        _ => return Err("must be: measurement, space, fields, and optionally space and time"),
    };
    let t_ns = match stamp {
        None => fallback_t_ns,
        Some(digits) => digits.parse().ok().and_then(stamp_ns_of).ok_or("has no time in s, ms, us or ns since 1970")?,
    };
    let mut series = pieces(series, ',').into_iter();
    let measurement = plain(series.next().unwrap_or_default());
    let mut tags: Vec<(String, String)> = series
        .filter_map(|tag| match pieces(tag, '=')[..] {
            [name, value] => Some((plain(name), plain(value))),
            _ => None,
        })
        .collect();
    tags.sort();
    let series = Series::new(&measurement, tags.into_iter());
    let mut read = Vec::new();
    for field in pieces(fields, ',') {
        let [name, value] = pieces(field, '=')[..] else { return Err("has a field without name=value") };
        let value = match value {
            "t" | "T" | "true" | "True" | "TRUE" => Scalar::Number(1.0),
            "f" | "F" | "false" | "False" | "FALSE" => Scalar::Number(0.0),
            text if text.len() > 1 && text.starts_with('"') && text.ends_with('"') => {
                Scalar::Text(text[1..text.len() - 1].replace("\\\"", "\"").replace("\\\\", "\\"))
            }
            number => {
                let digits = number.strip_suffix(['i', 'u']).unwrap_or(number);
                Scalar::Number(digits.parse().map_err(|_| "has a value that is not a number, text or boolean")?)
            }
        };
        read.push((plain(name), value));
    }
    series.put(read, t_ns, out).map_err(|_| "exceeds the limit of values")
}

#[cfg(test)]
mod tests {
    use super::*;

    const NS: i64 = 1_546_300_800_000_000_000;

    fn read(codec: &dyn Codec, text: &str) -> Result<Vec<(String, i64, Scalar)>, CodecError> {
        let mut out = Vec::new();
        let bundle = Bundle { key: "k", payload: text.as_bytes(), fallback_t_ns: 7 };
        codec.fields(&bundle, &mut Memory::default(), &mut out)?;
        Ok(out.into_iter().map(|f| (f.name, f.t_ns, f.value)).collect())
    }

    fn row(name: &str, t_ns: i64, value: f64) -> (String, i64, Scalar) {
        (name.to_owned(), t_ns, Scalar::Number(value))
    }

    #[test]
    fn json_of_one_metric_of_several_and_of_a_batch() {
        let one =
            r#"{"fields":{"op":42.5,"pv":7},"name":"opcua","tags":{"unit":"1","host":"a"},"timestamp":1546300800}"#;
        let wanted = [row("opcua,host=a,unit=1.op", NS, 42.5), row("opcua,host=a,unit=1.pv", NS, 7.0)];
        assert_eq!(read(&TelegrafJson, one).unwrap(), wanted);
        assert_eq!(read(&TelegrafJson, &format!(r#"{{"metrics":[{one},{one}]}}"#)).unwrap().len(), 4);
        let later = r#"[{"fields":{"m":"AUTO","on":true,"x":null},"name":"n","timestamp":1546300800250}]"#;
        let read_later = read(&TelegrafJson, later).unwrap();
        assert_eq!(read_later[0], ("n.m".to_owned(), NS + 250_000_000, Scalar::Text("AUTO".into())));
        assert_eq!((read_later[1].2.clone(), read_later[2].2.clone()), (Scalar::Number(1.0), Scalar::Missing));
        assert_eq!(read(&TelegrafJson, r#"{"fields":{"a":1},"name":"n"}"#).unwrap(), [row("n.a", 7, 1.0)]);
        for bad in ["{}", "[1]", r#"{"fields":{},"timestamp":5,"name":"n"}"#, r#"{"name":"n","fields":3}"#] {
            assert!(read(&TelegrafJson, bad).unwrap_err().to_string().contains("Telegraf"), "{bad}");
        }
    }

    #[test]
    fn quality_and_loop_stand_beside_the_values() {
        let line =
            "opcua,loop=FIC101,id=ns\\=3;s\\=x op=42.5,Quality=\"BadSensorFailure (0x808c0000)\" 1546300800000000000";
        let (mut out, bundle) = (Vec::new(), Bundle { key: "k", payload: line.as_bytes(), fallback_t_ns: 7 });
        LineProtocol.fields(&bundle, &mut Memory::default(), &mut out).unwrap();
        assert_eq!((out.len(), out[0].of.as_str(), out[0].quality), (1, "FIC101", Some(0x808c_0000)));
        assert_eq!(out[0].name, "opcua,id=ns=3;s=x,loop=FIC101.op");
        assert_eq!(quality_of(&Scalar::Text("OK (0x0)".into())), None);
        assert_eq!(quality_of(&Scalar::Number(192.0)), Some(192));
    }

    #[test]
    fn lines_as_the_protocol_writes_them() {
        let text = "# a comment\nopcua,unit=1,host=a\\ b op=42.5,pv=7i,n=3u 1546300800000000000\n\nm\\,x f\\ g=\"a \\\"b\\\", c=d\",on=T\r\n";
        assert_eq!(
            read(&LineProtocol, text).unwrap(),
            [
                row("opcua,host=a b,unit=1.op", NS, 42.5),
                row("opcua,host=a b,unit=1.pv", NS, 7.0),
                row("opcua,host=a b,unit=1.n", NS, 3.0),
                ("m,x.f g".to_owned(), 7, Scalar::Text("a \"b\", c=d".into())),
                row("m,x.on", 7, 1.0),
            ]
        );
        for bad in ["m", "m f", "m f=x", "m f=1 2 3", "m f=1 5", "m f=1=2", "m f=1e"] {
            let error = read(&LineProtocol, bad).unwrap_err().to_string();
            assert!(error.contains("line protocol: line 1: "), "{bad}: {error}");
        }
    }
}
