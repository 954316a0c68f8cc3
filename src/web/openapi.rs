//! The OpenAPI description of an API, generated from its table of operations.

use std::sync::Arc;

use axum::extract::State;
use axum::routing::get;
use axum::{Json, Router};
use schemars::SchemaGenerator;
use schemars::generate::SchemaSettings;
use serde_json::{Map, Value, json};

use super::table::{self, BASE, Operation, ResponseKind, of};

/// OpenAPI 3.1 of these operations under [`BASE`], including the description itself.
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
            "version": stiction::core::VERSION,
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

/// The operation that returns the description.
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

/// Serves the description.
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
