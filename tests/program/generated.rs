//! Parts of the pages that are generated from the program's output: its commands from the help, documents and their fields from
//! the schemas. If they differ, `STICTIOND_GOLDEN=write cargo test --features full --test program generated` rewrites them.

use std::fmt::Write;
use std::fs;

use serde_json::Value;

use crate::live::{ok, skipped};

fn json(arguments: &[&str]) -> Value {
    serde_json::from_str(&ok(arguments)).unwrap()
}

/// The documents of the bus: the key, the schema's name, and when one is published.
fn topics() -> String {
    let api = json(&["schema", "asyncapi"]);
    let mut out = "| key below `{prefix}/@stiction/v1/` | document | when |\n|---|---|---|\n".to_owned();
    for channel in api["channels"].as_object().unwrap().values() {
        let key = channel["address"].as_str().unwrap().trim_start_matches("{prefix}/@stiction/v1/");
        let name = channel["messages"].as_object().unwrap().keys().next().unwrap();
        let when = channel["summary"].as_str().unwrap().trim_end_matches('.');
        writeln!(out, "| `{key}` | `{name}` | {when} |").unwrap();
    }
    out
}

/// Whether a document may lack the field, or have null there.
fn may_lack(schema: &Value, field: &str, of: &Value) -> bool {
    let required = schema["required"].as_array().unwrap().iter().any(|name| name == field);
    let null = |kind: &Value| kind == "null" || kind["type"] == "null";
    let kinds = of["type"].as_array().or_else(|| of["anyOf"].as_array());
    !required || kinds.is_some_and(|kinds| kinds.iter().any(null))
}

/// The fields of each document.
fn fields() -> String {
    let mut out = "| document | fields |\n|---|---|\n".to_owned();
    for name in ok(&["schema"]).lines() {
        let schema = json(&["schema", name]);
        let mark =
            |(field, of): (&String, &Value)| format!("{field}{}", if may_lack(&schema, field, of) { "?" } else { "" });
        let all: Vec<String> = schema["properties"].as_object().unwrap().iter().map(mark).collect();
        writeln!(out, "| [`{name}`](schemas/{name}.json) | `{}` |", all.join(" ")).unwrap();
    }
    out
}

/// The commands and their arguments, from the help.
fn commands() -> String {
    let help = ok(&["--help"]);
    let lines = help.lines().skip_while(|line| *line != "Commands:").skip(1).take_while(|line| !line.is_empty());
    let mut rows: Vec<(&str, String)> = Vec::new();
    for line in lines {
        match line.strip_prefix("  ").filter(|rest| !rest.starts_with(' ')) {
            Some(row) => {
                let (name, about) = row.split_once(' ').unwrap();
                rows.push((name, about.trim().to_owned()));
            }
            // The rest of a long description is indented further.
            None => write!(rows.last_mut().unwrap().1, " {}", line.trim()).unwrap(),
        }
    }
    let mut out = "| command | takes | does |\n|---|---|---|\n".to_owned();
    for (name, about) in rows.iter().filter(|(name, _)| *name != "help") {
        let help = ok(&[name, "-h"]);
        let usage = help.lines().find_map(|line| line.strip_prefix("Usage: stictiond ")).unwrap();
        let takes = usage.trim_start_matches(name).replace(" [OPTIONS]", "");
        let takes = if takes.is_empty() { String::new() } else { format!("`{}`", takes.trim()) };
        writeln!(out, "| `{name}` | {takes} | {about} |").unwrap();
    }
    out
}

/// Compares the part of a page between its marks with the expected text, or writes it.
fn compare(page: &str, part: &str, made: &str) {
    let text = fs::read_to_string(page).unwrap();
    let (begins, ends) = (format!("<!-- made from {part} -->\n\n"), "\n<!-- end -->\n");
    let (before, rest) = text.split_once(&begins).unwrap_or_else(|| panic!("{page} lacks {begins}"));
    let (kept, after) = rest.split_once(ends).unwrap();
    if std::env::var("STICTIOND_GOLDEN").is_ok_and(|wish| wish == "write") {
        fs::write(page, format!("{before}{begins}{made}{ends}{after}")).unwrap();
        return;
    }
    let differs = made.lines().find(|line| !kept.lines().any(|kept| kept == *line));
    assert!(kept == made, "{page} is not of this build: {differs:?}; STICTIOND_GOLDEN=write makes it anew");
}

#[test]
fn topics_and_fields_are_those_of_the_schemas() {
    compare("docs/formats.md", "the topics", &topics());
    compare("docs/formats.md", "the schemas", &fields());
}

#[test]
fn commands_are_those_of_the_help() {
    let made = commands();
    if !made.contains("| `manual` |") {
        skipped("commands_are_those_of_the_help", "a build without the feature manual lacks two of them");
        return;
    }
    compare("docs/commands.md", "the help", &made);
}

/// Fields explained on pages exist: the first column of a table is read up to `…`, which stands for further fields.
#[test]
fn fields_that_pages_explain_are_in_the_schemas() {
    for (page, heading, name) in [
        ("docs/read-a-result.md", "| field | means |", "stictiond.estimate.v1"),
        ("docs/alarms.md", "| field | means |", "stictiond.alarm.v2"),
        ("docs/gap.md", "| part | in the document | how it is found |", "stictiond.gap.v1"),
    ] {
        let schema = json(&["schema", name]);
        let text = fs::read_to_string(page).unwrap();
        let mut rows = text.lines().skip_while(|line| *line != heading);
        assert!(rows.next().is_some(), "{page} lacks {heading}");
        let column = if heading.starts_with("| part") { 2 } else { 1 };
        for row in rows.skip(1).take_while(|line| line.starts_with('|')) {
            let cell = row.split('|').nth(column).unwrap();
            // Every second part is in backticks; a field may be followed by a nested one.
            for field in cell.split('`').skip(1).step_by(2) {
                let first = field.split(['.', '[']).next().unwrap();
                let known = schema["properties"].get(first).is_some() || first.starts_with('…');
                assert!(known, "{page}: {name} has no field {field}");
            }
        }
    }
}
