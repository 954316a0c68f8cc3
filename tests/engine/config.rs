//! The shipped configurations: the reference has every key that the reader knows, and no other.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::collections::BTreeSet;
use stiction_engine::config::Config;

const MONITOR: &str = include_str!("../../config/monitor.toml");
const DEMO: &str = include_str!("../../config/demo.toml");
const BROKEN: &str = include_str!("../../config/broken.toml");

/// The keys that the reader knows in a table, which it lists when it meets an unknown one.
fn known_in(head: &str) -> BTreeSet<String> {
    let text = match head {
        "" => "zzzzzzzz = 1\n".to_owned(),
        "[site]" => "[site]\nzzzzzzzz = 1\n".to_owned(),
        _ => format!("[site]\nprefix = \"p\"\n{head}\nzzzzzzzz = 1\n"),
    };
    let faults = Config::parse(&text).unwrap_err();
    let fault = faults.iter().find(|f| f.key.ends_with("zzzzzzzz")).unwrap();
    let (_, known) = fault.remedy.split_once("valid keys: ").unwrap();
    known.split(", ").map(str::to_owned).collect()
}

/// The keys set in a table, and its subtables.
fn set_in(table: &toml::Table) -> BTreeSet<String> {
    table.keys().cloned().collect()
}

#[test]
fn the_reference_has_every_key_that_the_reader_knows() {
    let reference: toml::Table = MONITOR.parse().unwrap();
    assert_eq!(set_in(&reference), known_in(""), "tables");
    for name in known_in("") {
        let (head, table) = match &reference[&name] {
            toml::Value::Array(tables) => (format!("[[{name}]]"), tables[0].as_table().unwrap()),
            value => (format!("[{name}]"), value.as_table().unwrap()),
        };
        assert_eq!(set_in(table), known_in(&head), "{head}");
    }
}

#[test]
fn the_reference_shows_the_defaults() {
    let (plain, _) = MONITOR.split_once("\n[[loop]]").unwrap();
    assert_eq!(Config::parse(plain).unwrap(), Config::with_prefix("plant1/area1"));
    assert_eq!(Config::parse(MONITOR).unwrap().loops.len(), 1);
}

#[test]
fn the_reference_explains_every_key_and_gives_times_their_unit() {
    let (plain, _) = MONITOR.split_once("\n[[loop]]").unwrap();
    for line in plain.lines().filter(|l| l.contains(" = ") && !l.starts_with('#')) {
        let (setting, meaning) = line.split_once('#').unwrap_or_else(|| panic!("no meaning: {line}"));
        let key = setting.split(" =").next().unwrap();
        if key.ends_with("_s") {
            assert!(meaning.starts_with(" s"), "no unit: {line}");
        }
    }
}

#[test]
fn loops_upstream_are_names_of_other_loops() {
    let parse = |names: &str| {
        let entry = format!("[[loop]]\nname = \"TIC102\"\nop = \"x/op\"\npv = \"x/pv\"\nupstream = {names}\n");
        Config::parse(&format!("[site]\nprefix = \"p\"\n{entry}"))
    };
    let upstream = |names: &str| parse(names).unwrap().loops[0].upstream.clone();
    assert_eq!(upstream("[\"FIC101\", \"area2/FIC7\"]"), ["FIC101", "area2/FIC7"]);
    assert_ne!(parse("[\"FIC101\"]").unwrap().hash(), parse("[]").unwrap().hash());
    for refused in ["[\"TIC102\"]", "[\"a*\"]", "\"FIC101\""] {
        let faults = parse(refused).unwrap_err();
        assert!(faults.iter().any(|fault| fault.key == "loop[0].upstream"), "{refused}: {faults:?}");
    }
}

#[test]
fn the_demo_parses() {
    Config::parse(DEMO).unwrap();
}

/// Lines and keys of the faults announced in comments of the broken example.
fn announced() -> BTreeSet<(usize, String)> {
    let lines = BROKEN.lines().enumerate();
    let marked = lines.filter_map(|(at, line)| Some((at + 1, line.split_once("# fault: ")?.1)));
    marked.flat_map(|(at, keys)| keys.split(' ').map(move |k| (at, k.to_owned()))).collect()
}

#[test]
fn every_fault_of_the_broken_example_is_found_where_it_stands() {
    let faults = Config::parse(BROKEN).unwrap_err();
    let found: BTreeSet<(usize, String)> = faults.iter().map(|f| (f.line, f.key.clone())).collect();
    assert_eq!(found, announced());
    assert!(faults.iter().all(|f| !f.remedy.is_empty()));
}

#[test]
fn check_lists_them_all_and_fails() {
    let run = |arguments: &[&str]| {
        let output = std::process::Command::new(env!("CARGO_BIN_EXE_stictiond"))
            .args(arguments)
            .current_dir(env!("CARGO_MANIFEST_DIR"))
            .output()
            .unwrap();
        (output.status.code(), String::from_utf8(output.stdout).unwrap())
    };
    let (code, text) = run(&["check", "config/broken.toml"]);
    assert_eq!(code, Some(1), "{text}");
    for (line, key) in announced() {
        let start = format!("config/broken.toml: line {line}: {key}: ");
        assert!(text.lines().any(|l| l.starts_with(&start)), "{start} not in\n{text}");
    }
    let (code, text) = run(&["check", "config/broken.toml", "--format", "json"]);
    let document: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert_eq!(code, Some(1));
    assert!(document["faults"].as_array().unwrap().len() >= announced().len());
    for good in ["config/monitor.toml", "config/demo.toml"] {
        assert_eq!(run(&["check", good]).0, Some(0), "{good}");
    }
}

#[test]
fn nan_and_infinity_are_refused_with_the_key_and_the_range() {
    for (word, table) in [("nan", "window"), ("+inf", "window"), ("-nan", "window")] {
        let faults = Config::parse(&format!("[site]\nprefix = \"p\"\n[{table}]\nevery_s = {word}\n")).unwrap_err();
        let [fault] = faults.as_slice() else { panic!("{faults:?}") };
        assert_eq!((fault.line, fault.key.as_str()), (4, "window.every_s"));
        assert_eq!(fault.message, format!("{word} is not allowed: a setting must be a finite number"));
        assert!(fault.remedy.starts_with("write a number from "), "{}", fault.remedy);
    }
    let faults = Config::parse("[site]\nprefix = \"p\"\n[input]\nqueue = nan\n").unwrap_err();
    assert_eq!(
        faults[0].to_string().split(';').next().unwrap(),
        "line 4: input.queue: nan is not allowed: a setting must be a finite number"
    );
}
