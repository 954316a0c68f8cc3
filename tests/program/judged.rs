//! `replay --config`: a recording under another configuration.

use std::fs;

use serde_json::Value;
use stiction_files::RecordingReader;

use crate::common::program::{expect, stdout};

const RECORDING: &str = "recordings/sticking.mcap";

#[test]
fn what_another_configuration_changes_is_named_and_the_recorded_one_changes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let config = folder.path().join("new.toml");
    let judged = |text: &str, more: &[&str]| {
        fs::write(&config, text).unwrap();
        stdout(&expect(0, &[&["replay", RECORDING, "--config", config.to_str().unwrap()], more].concat()))
    };
    let reader = RecordingReader::open(RECORDING.as_ref()).unwrap();
    let recorded = reader.metadata()["config"].clone();
    let same = judged(&recorded, &[]);
    assert!(
        same.starts_with("settings that differ: none\n0 of 1 loop changed; alarms active at the end: 1 as"),
        "{same}"
    );

    let deaf = format!("{recorded}\n[[loop]]\nname = \"FIC101\"\ns_limit_op = 20.0\n");
    let text = judged(&deaf, &[]);
    for part in [
        "settings that differ: with FIC101",
        "alarm    recorded settings: raised 2026-01-05T08:",
        "these settings:    not raised",
        "below the limit of 20 OP units",
        "1 of 1 loop changed; alarms active at the end: 1 as recorded, 0 under ",
        "; gone: FIC101",
    ] {
        assert!(text.contains(part), "{part:?} is not in\n{text}");
    }
    let documents = judged(&deaf, &["--format", "json"]);
    let documents: Vec<Value> = documents.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let [one, all] = &documents[..] else { panic!("{documents:?}") };
    assert_eq!((&one["schema"], &one["loop"]), (&"stictiond.judged_loop.v1".into(), &"FIC101".into()));
    assert_eq!((&one["before"]["active"], &one["after"]["active"]), (&true.into(), &false.into()));
    assert_eq!((&one["verdicts"], &one["before"]["windows"]), (&Value::Array(Vec::new()), &one["common_windows"]));
    assert_eq!((&all["active"]["gone"][0], &all["changed"]), (&"FIC101".into(), &1.into()));

    // A hop twice as long gives half as many windows; those in both are compared.
    let slower = judged(&recorded.replace("hop_s = 300", "hop_s = 600"), &[]);
    assert!(slower.contains("settings that differ: window.every_s") && slower.contains(" before, "), "{slower}");
}
