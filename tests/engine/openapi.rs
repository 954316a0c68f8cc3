//! The descriptions of both APIs list every operation, and have no dangling references.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::collections::BTreeSet;

use serde_json::Value;

use stictiond::web::openapi;
use stictiond::web::table::Operation;

fn is_whole<S>(operations: &[Operation<S>]) {
    let whole = openapi::document(operations);
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
}

#[test]
fn both_descriptions_are_whole() {
    is_whole(&stictiond::web::api::operations());
    is_whole(&stictiond::web::workbench::operations());
}
