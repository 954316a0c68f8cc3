//! Named values in a tree: JSON and CBOR payloads with several signals.
//!
//! The members of an object are values under their names, except `t` (time) and `q` (quality), which apply to all of them.
//! A member may be an object with `v` and its own `t` and `q`, or an object whose name is a prefix to the names of its
//! members. `{"name", "v"}` (or `"tag"`) is one value under that name. Arrays are batches.

use serde::de::DeserializeSeed;
use serde_json::{Map, Value as Json};

use super::MAX_SAMPLES;
use super::fields::{Field, Scalar};
use super::samples::{QualitySeed, TimeSeed};

/// Deepest nesting of names.
const MAX_DEPTH: usize = 6;

/// Defaults for all values of an object.
#[derive(Clone, Copy)]
struct Said {
    t_ns: i64,
    quality: Option<u32>,
}

/// Appends the values of a whole payload.
///
/// # Errors
/// The fault in words.
pub(super) fn read(tree: &Json, fallback_t_ns: i64, out: &mut Vec<Field>) -> Result<(), String> {
    let said = Said { t_ns: fallback_t_ns, quality: None };
    match tree {
        Json::Array(batch) => batch.iter().try_for_each(|one| match one {
            Json::Object(object) => members(object, "", said, 0, out),
            _ => Err("an array of something other than objects".to_owned()),
        }),
        Json::Object(object) => members(object, "", said, 0, out),
        _ => Err("a value without a name".to_owned()),
    }
}

/// Time and quality of an object, overriding those of its parent.
fn said_in(object: &Map<String, Json>, around: Said) -> Result<Said, String> {
    let t_ns = match object.get("t") {
        None => None,
        Some(t) => TimeSeed.deserialize(t).map_err(|e| e.to_string())?,
    };
    let quality = match object.get("q") {
        None => None,
        Some(q) => QualitySeed.deserialize(q).map_err(|e| e.to_string())?,
    };
    Ok(Said { t_ns: t_ns.unwrap_or(around.t_ns), quality: quality.or(around.quality) })
}

fn members(
    object: &Map<String, Json>,
    head: &str,
    around: Said,
    depth: usize,
    out: &mut Vec<Field>,
) -> Result<(), String> {
    if depth > MAX_DEPTH {
        return Err(format!("names are nested more than {MAX_DEPTH} deep"));
    }
    let said = said_in(object, around)?;
    let named = ["name", "tag"].into_iter().find_map(|key| object.get(key)?.as_str());
    if let (Some(name), Some(value)) = (named, object.get("v")) {
        return push(head, name, value, said, out);
    }
    for (name, value) in object.iter().filter(|(name, _)| !matches!(name.as_str(), "t" | "q")) {
        match value {
            Json::Object(inner) => match inner.get("v") {
                Some(value) => push(head, name, value, said_in(inner, said)?, out)?,
                None => {
                    let head = if head.is_empty() { name.clone() } else { format!("{head}.{name}") };
                    members(inner, &head, said, depth + 1, out)?;
                }
            },
            value => push(head, name, value, said, out)?,
        }
    }
    Ok(())
}

fn push(head: &str, name: &str, value: &Json, said: Said, out: &mut Vec<Field>) -> Result<(), String> {
    let value = match value {
        Json::Number(number) => number.as_f64().map_or(Scalar::Missing, Scalar::Number),
        Json::Bool(on) => Scalar::Number(f64::from(u8::from(*on))),
        Json::String(text) => Scalar::Text(text.clone()),
        Json::Null => Scalar::Missing,
        Json::Array(_) | Json::Object(_) => return Err(format!("{:?} is not a value", short(name))),
    };
    // One more than the limit is enough to refuse the whole payload.
    if out.len() <= MAX_SAMPLES {
        out.push(Field::new(head, name, said.t_ns, value, said.quality));
    }
    Ok(())
}

fn short(name: &str) -> String {
    name.chars().take(40).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::codec::{Bundle, Codec, Json as JsonCodec, Memory};

    fn fields(text: &str) -> Result<Vec<Field>, String> {
        let (mut out, bundle) = (Vec::new(), Bundle { key: "k", payload: text.as_bytes(), fallback_t_ns: 7 });
        JsonCodec.fields(&bundle, &mut Memory::default(), &mut out).map_err(|e| e.to_string())?;
        Ok(out)
    }

    #[test]
    fn one_loop_several_loops_and_lists_are_read() {
        let one =
            fields(r#"{"t": 9, "q": 192, "op": 42.5, "pv": {"v": NaN, "q": 0, "t": 8}, "mode": "AUTO"}"#).unwrap();
        let of = |name: &str| one.iter().find(|f| f.name == name).unwrap();
        assert_eq!(one.len(), 3);
        assert_eq!((of("op").t_ns, of("op").quality, of("op").value.clone()), (9, Some(192), Scalar::Number(42.5)));
        assert_eq!((of("pv").t_ns, of("pv").quality), (8, Some(0)));
        assert_eq!(of("mode").value, Scalar::Text("AUTO".into()));
        let two = fields(r#"{"FIC101": {"op": 1, "pv": true}, "u1": {"LIC7": {"op": null}}}"#).unwrap();
        let names: Vec<(&str, &str)> = two.iter().map(|f| (f.name.as_str(), f.of.as_str())).collect();
        assert_eq!(names, [("FIC101.op", "FIC101"), ("FIC101.pv", "FIC101"), ("u1.LIC7.op", "u1.LIC7")]);
        let list = fields(r#"[{"name": "FIC101.OP", "v": 1, "t": 5}, {"tag": "FIC101.PV", "v": 2}]"#).unwrap();
        assert_eq!((list[0].t_ns, list[1].name.as_str(), list[1].t_ns), (5, "FIC101.PV", 7));
    }

    #[test]
    fn what_has_no_name_or_no_value_is_refused() {
        for bad in [
            "1.5",
            "[1]",
            r#"{"op": [1, 2]}"#,
            r#"{"op": 1, "t": "yesterday"}"#,
            "{\"a\":{\"b\":{\"c\":{\"d\":{\"e\":{\"f\":{\"g\":{\"h\":1}}}}}}}}",
        ] {
            assert!(fields(bad).is_err(), "{bad}");
        }
    }
}
