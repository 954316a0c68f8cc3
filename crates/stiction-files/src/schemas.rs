//! JSON schemas of the documents in a recording, one per [`Kind`].
//!
//! Viewers plot named scalar fields and accept one plain type per field, so a number that does not exist is null in the
//! data. Extra fields are allowed everywhere.

use serde_json::{Map, Value, json};
use stiction_engine::codec::topic::Kind;

const TIME: &[&str] = &["t"];

/// Fields of one kind, by type.
#[derive(Default)]
struct Fields {
    integers: &'static [&'static str],
    numbers: &'static [&'static str],
    texts: &'static [&'static str],
    flags: &'static [&'static str],
    objects: &'static [(&'static str, &'static [&'static str])],
}

fn fields(kind: Kind) -> Fields {
    match kind {
        Kind::Sample => Fields { integers: &["t", "q"], numbers: &["v"], ..Fields::default() },
        Kind::Mode => Fields { integers: &["t", "q"], texts: &["v"], ..Fields::default() },
        Kind::Estimate => Fields {
            numbers: &[
                "p_stiction",
                "p_calibrated",
                "prevalence",
                "confidence",
                "fs",
                "fd",
                "s",
                "j",
                "s_detectable",
                "stiction_index",
                "s_over_span",
            ],
            texts: &[
                "schema",
                "loop",
                "verdict",
                "grade",
                "region",
                "strength_by_span",
                "severity_by_range",
                "version",
                "config_hash",
            ],
            flags: &["stiction", "j_identifiable"],
            objects: &[
                ("window", &["start_ns", "end_ns", "samples", "ts_s"]),
                ("oscillation", &["period_s", "periods", "samples_per_period", "regularity"]),
                ("process", &["order", "gain", "dead_time_s", "mse", "fit_pct"]),
                ("controller", &["kc", "ti_s", "td_s", "lag_samples", "r2", "unexplained"]),
            ],
            ..Fields::default()
        },
        Kind::Alarm => Fields {
            integers: &["since_ns", "changed_ns", "criticality"],
            numbers: &["s", "s_limit", "p", "p_calibrated", "prevalence", "stiction_index"],
            texts: &[
                "schema",
                "loop",
                "alarm",
                "event_id",
                "event",
                "state",
                "priority",
                "area",
                "equipment",
                "ne107",
                "class",
                "unit",
                "verdict",
                "why",
                "by",
                "detail",
            ],
            flags: &["active"],
            objects: &[("window", &["start_ns", "end_ns"])],
        },
        Kind::Gap => Fields {
            integers: &["evaluations"],
            numbers: &["parametric"],
            texts: &["schema", "loop", "version", "reason", "by", "config_hash"],
            flags: &["stopped_early"],
            objects: &[
                ("window", &["start_ns", "end_ns", "samples", "ts_s"]),
                ("gap", &["rmse", "noise_floor", "gap", "relative"]),
                ("given", &["rmse", "noise_floor", "gap", "relative"]),
                ("where", &["onset_s", "slip_window_s", "direction_ratio", "fundamental_hz"]),
                ("cause", &["probability"]),
                ("forward", &["gap_before", "gap_after", "closed_pct"]),
                ("model_after", &["fs", "fd", "s", "j", "ts_s"]),
                ("next_test", &["size", "duration_s", "p"]),
            ],
        },
        Kind::Group => Fields {
            integers: &["pairs_compared"],
            numbers: &["period_s", "p_value"],
            texts: &["schema", "version", "daemon"],
            objects: &[("source", &["probability"]), ("window", &["start_ns", "end_ns"])],
            ..Fields::default()
        },
        Kind::Health => Fields {
            numbers: &["uptime_s", "loops", "data_age_s", "gaps", "dropped"],
            texts: &["schema", "daemon", "loop", "version", "config_hash"],
            ..Fields::default()
        },
        Kind::DataHealth => Fields {
            integers: &["due_ns", "loops", "judged", "more"],
            numbers: &["share", "share_before", "change"],
            texts: &["schema", "daemon", "event_id", "due", "version"],
            ..Fields::default()
        },
        Kind::State | Kind::Input => Fields { integers: TIME, texts: &["schema", "loop", "kind"], ..Fields::default() },
    }
}

/// The name of a kind's schema, such as `stictiond.estimate.v1`.
#[must_use]
pub fn name(kind: Kind) -> String {
    kind.schema().to_owned()
}

/// The kind with this schema name, of any version: recordings of earlier builds contain earlier ones.
#[must_use]
pub fn kind_of(schema_name: &str) -> Option<Kind> {
    let (document, version) = schema_name.rsplit_once(".v")?;
    version.parse::<u32>().ok()?;
    Kind::ALL.into_iter().find(|kind| kind.schema().rsplit_once(".v").is_some_and(|(own, _)| own == document))
}

/// A kind's JSON schema.
#[must_use]
pub fn json_schema(kind: Kind) -> Value {
    let Fields { integers, numbers, texts, flags, objects } = fields(kind);
    let mut properties = Map::new();
    for (names, word) in [(integers, "integer"), (numbers, "number"), (texts, "string"), (flags, "boolean")] {
        properties.extend(names.iter().map(|name| ((*name).to_owned(), json!({ "type": word }))));
    }
    for (name, members) in objects {
        let members: Map<String, Value> =
            members.iter().map(|member| ((*member).to_owned(), json!({ "type": "number" }))).collect();
        properties.insert((*name).to_owned(), json!({ "type": "object", "properties": members }));
    }
    json!({ "title": name(kind), "type": "object", "properties": properties, "additionalProperties": true })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Viewers refuse a whole topic over one field without a plain type.
    #[test]
    fn every_field_has_one_plain_type() {
        for kind in Kind::ALL {
            assert_eq!(kind_of(&name(kind)), Some(kind));
            let schema = json_schema(kind);
            assert_eq!(schema["type"], "object");
            for (field, shape) in schema["properties"].as_object().unwrap() {
                let word = shape["type"].as_str().unwrap();
                assert!(["integer", "number", "string", "boolean", "object"].contains(&word), "{kind:?} {field}");
            }
        }
        assert_eq!(kind_of("stictiond.alarm.v1"), Some(Kind::Alarm));
        assert_eq!(kind_of("foxglove.Grid"), None);
        assert_eq!(kind_of("stictiond.alarm.vx"), None);
    }
}
