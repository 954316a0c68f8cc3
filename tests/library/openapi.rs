//! The descriptions of both APIs in docs/ are whole, and those of this build.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::collections::BTreeSet;
use std::path::Path;

use serde_json::Value;

use stiction_web::openapi;
use stiction_web::table::Operation;

fn is_whole<S>(operations: &[Operation<S>]) -> Value {
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
    whole
}

/// The descriptions in docs/ are those of this build; STICTIOND_GOLDEN=write writes them again.
#[test]
fn the_descriptions_are_whole_and_those_in_the_docs() {
    let both = [
        ("docs/openapi.json", is_whole(&stiction_web::api::operations())),
        ("docs/openapi-workbench.json", is_whole(&stiction_workbench::operations())),
    ];
    for (path, document) in both {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(path);
        let text = serde_json::to_string_pretty(&document).unwrap() + "\n";
        if std::env::var("STICTIOND_GOLDEN").is_ok_and(|wish| wish == "write") {
            std::fs::write(&path, &text).unwrap();
        }
        let kept = std::fs::read_to_string(&path).unwrap_or_default();
        assert!(kept == text, "{}: STICTIOND_GOLDEN=write writes it again", path.display());
    }
}
