//! The description of an API, made from its table of operations.

use std::sync::Arc;

use axum::extract::State;
use axum::routing::get;
use axum::{Json, Router};
use schemars::SchemaGenerator;
use schemars::generate::SchemaSettings;
use serde_json::{Map, Value, json};

use super::table::{self, BASE, Operation, ResponseKind, of};

/// OpenAPI 3.1 of these operations under [`BASE`], and of the description itself.
#[must_use]
pub fn document<S>(operations: &[Operation<S>]) -> Value {
    let settings =
        SchemaSettings::draft2020_12().for_serialize().with(|s| s.definitions_path = "/components/schemas".into());
    let mut generator = settings.into_generator();
    let mut paths = Map::new();
    describe(&own(), &mut paths, &mut generator);
    describe(operations, &mut paths, &mut generator);
    let schemas = generator.take_definitions(true);
    json!({
        "openapi": "3.1.0",
        "info": {
            "title": "stictiond",
            "version": crate::VERSION,
            "description": "What the page reads and sends. Times are ms since 1970 UTC, numbers that do not exist are null. A \
                            request that changes something carries the header `X-Stictiond: 1`, and the token where one is set.",
            "license": { "name": "MIT OR Apache-2.0", "identifier": "MIT OR Apache-2.0" },
        },
        "paths": paths,
        "components": {
            "schemas": schemas,
            "securitySchemes": { "token": { "type": "http", "scheme": "bearer" } },
        },
    })
}

/// The description itself.
fn own() -> [Operation<Arc<Value>>; 1] {
    [Operation {
        method: "get",
        path: "/openapi.json",
        summary: "This description",
        query: &[],
        body: None,
        response: ResponseKind::Json(of::<Value>),
        handler: || get(|State(description): State<Arc<Value>>| async move { Json(Value::clone(&description)) }),
    }]
}

/// Serves a description.
pub(super) fn router(description: Value) -> Router {
    table::router(&own()).with_state(Arc::new(description))
}

fn describe<S>(operations: &[Operation<S>], paths: &mut Map<String, Value>, generator: &mut SchemaGenerator) {
    for operation in operations {
        let path = paths.entry(format!("{BASE}{}", operation.path)).or_insert_with(|| json!({}));
        path[operation.method] = described(operation, generator);
    }
}

fn described<S>(operation: &Operation<S>, generator: &mut SchemaGenerator) -> Value {
    let in_path = operation.path.split('/').filter_map(|part| part.strip_prefix('{')?.strip_suffix('}'));
    let mut parameters: Vec<Value> = in_path
        .map(|name| json!({"name": name, "in": "path", "required": true, "schema": {"type": "string"}}))
        .collect();
    let query = operation.query.iter();
    parameters.extend(query.map(|p| json!({"name": p.name, "in": "query", "description": p.words, "schema": {}})));
    let content = match operation.response {
        ResponseKind::Json(schema) => json!({"application/json": {"schema": schema(generator)}}),
        ResponseKind::File(kind) => json!({kind: {}}),
        ResponseKind::Events => json!({"text/event-stream": {}}),
    };
    let refusal = json!({
        "description": "Refused: what is wrong, with the remedy",
        "content": {"application/json": {"schema": {
            "type": "object", "required": ["error"], "properties": {"error": {"type": "string"}},
        }}},
    });
    let mut said = json!({
        "summary": operation.summary,
        "parameters": parameters,
        "responses": {"200": {"description": "Done", "content": content}, "default": refusal},
    });
    if let Some(body) = operation.body {
        said["requestBody"] = json!({"required": true, "content": {"application/json": {"schema": body(generator)}}});
    }
    if operation.method != "get" {
        let own = json!({"name": "X-Stictiond", "in": "header", "required": true, "schema": {"const": "1"}});
        if let Some(parameters) = said["parameters"].as_array_mut() {
            parameters.push(own);
        }
        said["security"] = json!([{}, {"token": []}]);
    }
    said
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    fn is_whole<S>(operations: &[Operation<S>]) -> Value {
        let whole = document(operations);
        let described: usize = whole["paths"].as_object().unwrap().values().map(|p| p.as_object().unwrap().len()).sum();
        let different: BTreeSet<_> = operations.iter().map(|o| (o.method, o.path)).collect();
        assert_eq!((described, different.len()), (operations.len() + 1, operations.len()));
        let mut open = vec![&whole];
        let mut references = 0;
        while let Some(value) = open.pop() {
            match value {
                Value::Object(fields) => {
                    if let Some(place) = fields.get("$ref").and_then(Value::as_str) {
                        references += 1;
                        assert!(whole.pointer(place.trim_start_matches('#')).is_some(), "{place}");
                    }
                    open.extend(fields.values());
                }
                Value::Array(values) => open.extend(values),
                _ => {}
            }
        }
        assert!(references > 5, "{references}");
        whole
    }

    /// The descriptions in docs/ are those of this build; STICTIOND_GOLDEN=write writes them again.
    #[test]
    fn the_descriptions_are_whole_and_those_in_the_docs() {
        let both = [
            ("docs/openapi.json", is_whole(&crate::web::api::operations())),
            ("docs/openapi-workbench.json", is_whole(&crate::workbench::operations())),
        ];
        for (path, document) in both {
            let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join(path);
            let text = serde_json::to_string_pretty(&document).unwrap() + "\n";
            if std::env::var("STICTIOND_GOLDEN").is_ok_and(|wish| wish == "write") {
                std::fs::write(&path, &text).unwrap();
            }
            let kept = std::fs::read_to_string(&path).unwrap_or_default();
            assert!(kept == text, "{}: STICTIOND_GOLDEN=write writes it again", path.display());
        }
    }
}
