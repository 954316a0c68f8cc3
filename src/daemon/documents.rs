//! JSON Schema 2020-12 of the published documents, derived from their types.
//!
//! A document may hold more fields than its schema names, never fewer. Within a version fields are only added; removing or
//! renaming one, or changing its meaning or unit, needs a new version. A number without a value is null.

use schemars::generate::SchemaSettings;
use schemars::{JsonSchema, Schema};
use serde_json::{Value, json};

use crate::runtime::data_health::DataHealthDocument;
use crate::runtime::health::{DaemonHealth, LoopHealth};
use stiction::core::gap::document::{GAP_SCHEMA, GapDocument};
use stiction::core::verdict::{ESTIMATE_SCHEMA, EstimateDocument};
use stiction::plantwide::{GROUP_SCHEMA, GroupDocument};
use stiction_engine::alarm::{ALARM_SCHEMA, AlarmDocument};
use stiction_engine::codec::topic::{DAEMON_HEALTH_SCHEMA, DATA_HEALTH_SCHEMA, LOOP_HEALTH_SCHEMA};

/// The schema of a type as it is serialized.
fn written<T: JsonSchema>() -> Schema {
    SchemaSettings::draft2020_12().for_serialize().into_generator().into_root_schema_for::<T>()
}

/// The same, under the name that the document carries.
fn document<T: JsonSchema>(name: &str) -> Value {
    let mut schema = written::<T>().to_value();
    schema["$id"] = json!(format!("urn:stictiond:{name}"));
    schema["title"] = json!(name);
    schema["properties"]["schema"] = json!({"const": name});
    schema
}

/// Names and schemas of every published document.
#[must_use]
pub fn schemas() -> Vec<(&'static str, Value)> {
    vec![
        (ESTIMATE_SCHEMA, document::<EstimateDocument>(ESTIMATE_SCHEMA)),
        (ALARM_SCHEMA, document::<AlarmDocument>(ALARM_SCHEMA)),
        (GAP_SCHEMA, document::<GapDocument>(GAP_SCHEMA)),
        (GROUP_SCHEMA, document::<GroupDocument>(GROUP_SCHEMA)),
        (LOOP_HEALTH_SCHEMA, document::<LoopHealth>(LOOP_HEALTH_SCHEMA)),
        (DAEMON_HEALTH_SCHEMA, document::<DaemonHealth>(DAEMON_HEALTH_SCHEMA)),
        (DATA_HEALTH_SCHEMA, document::<DataHealthDocument>(DATA_HEALTH_SCHEMA)),
    ]
}

/// The schema of one document, formatted as in `docs/schemas`.
#[must_use]
pub fn text(schema: &Value) -> String {
    serde_json::to_string_pretty(schema).unwrap_or_default() + "\n"
}

#[cfg(test)]
mod tests {
    use super::*;
    use stiction_engine::codec::topic::Kind;

    #[test]
    fn what_may_be_null_may_be_and_what_is_always_there_is_required() {
        let all = schemas();
        let estimate = &all[0].1;
        let required: Vec<&str> = estimate["required"].as_array().unwrap().iter().filter_map(Value::as_str).collect();
        for field in ["schema", "loop", "fs", "process", "version", "window"] {
            assert!(required.contains(&field), "{field}: {required:?}");
        }
        assert_eq!(estimate["properties"]["fs"]["type"], json!(["number", "null"]));
        assert_eq!(estimate["properties"]["s_interval"]["maxItems"], 2);
        assert_eq!(estimate["properties"]["schema"]["const"], "stictiond.estimate.v1");
    }

    #[test]
    fn topics_and_documents_call_them_alike() {
        assert_eq!(Kind::Alarm.schema(), ALARM_SCHEMA);
        assert_eq!((Kind::Estimate.schema(), Kind::Gap.schema()), (ESTIMATE_SCHEMA, GAP_SCHEMA));
        assert_eq!(Kind::Group.schema(), GROUP_SCHEMA);
        assert!(schemas().iter().all(|(name, schema)| schema["properties"]["schema"]["const"] == *name));
    }

    /// `docs/schemas` equals the schemas of this build; STICTIOND_GOLDEN=write rewrites it.
    #[test]
    fn the_kept_schemas_are_those_of_the_types() {
        let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/schemas");
        for (name, schema) in schemas() {
            let path = folder.join(format!("{name}.json"));
            if std::env::var("STICTIOND_GOLDEN").is_ok_and(|mode| mode == "write") {
                std::fs::create_dir_all(&folder).unwrap();
                std::fs::write(&path, text(&schema)).unwrap();
            }
            let kept = std::fs::read_to_string(&path).unwrap_or_default();
            assert!(kept == text(&schema), "{}: STICTIOND_GOLDEN=write makes it anew", path.display());
        }
    }
}
