//! `stiction-lab calibrate`: features are computed once and cached, and the classifier is written as printed.

use std::fs;

use super::{lab, text};

/// A triangle in OP and a square in PV: the shapes of a sticking valve.
fn sticking() -> String {
    let row = |k: i32| {
        let t = (f64::from(k) / 60.0).fract();
        let triangle = if t < 0.5 { 4.0 * t - 1.0 } else { 3.0 - 4.0 * t };
        let square = if (0.1..0.6).contains(&t) { 1.0 } else { -1.0 };
        let noise = 1e-3 * f64::from(k * k % 31);
        format!("{k},{},{}\n", 50.0 + 3.0 * triangle, 20.0 + square + noise)
    };
    format!("t,op,pv\n{}", (0..600).map(row).collect::<String>())
}

#[track_caller]
fn expect(code: i32, arguments: &[&str]) -> String {
    let output = lab(arguments);
    assert_eq!(output.status.code(), Some(code), "{arguments:?}: {}{}", text(&output.stdout), text(&output.stderr));
    text(&output.stdout)
}

#[test]
fn calibrate_keeps_what_it_computed_and_writes_a_rule() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (index, features, out) = (path("INDEX.csv"), path("features.jsonl"), path("rule.json"));
    fs::write(path("A_01.csv"), sticking()).unwrap();
    fs::write(&index, "file,label\nA_01.csv,stiction\ngone.csv,tuning\n").unwrap();
    let arguments = ["calibrate", "--loops", "4", "--labelled", &index, "--features", &features, "--format", "json"];
    let first = expect(0, &[&arguments[..], &["--out", &out]].concat());
    let kept = fs::read_to_string(&features).unwrap();
    assert_eq!(kept.lines().count(), 9);
    let again = expect(0, &[&arguments[..], &["--out", &out, "--force"]].concat());
    assert_eq!(first, again);
    assert_eq!(fs::read_to_string(&features).unwrap(), kept);
    expect(1, &[&arguments[..], &["--out", &out]].concat());
    let told: serde_json::Value = serde_json::from_str(&first).unwrap();
    let rule: serde_json::Value = serde_json::from_str(&fs::read_to_string(&out).unwrap()).unwrap();
    assert_eq!(told["rule"], rule);
    assert_eq!((&rule["made"]["valves"], &rule["made"]["recordings"]), (&1.into(), &1.into()));
    assert_eq!(told["recordings"]["all"]["total"], 1.0);
    assert!(told["simulated"]["brier"].is_number());
    let other = [&arguments[..7], &["--use", "index,travel", "--ridge", "3"]].concat();
    assert!(expect(0, &other).contains("counted once"));
}
