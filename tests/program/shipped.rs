//! The shipped recordings: this build reproduces them byte for byte from their scenarios, and its results match the truth.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::fs;

use crate::common::program::stictiond;

const SHIPPED: [&str; 4] = ["sticking", "four-loops", "awkward", "physical"];

#[test]
fn every_shipped_recording_is_made_again_and_verifies() {
    let dir = tempfile::tempdir().unwrap();
    for name in SHIPPED {
        let recording = format!("recordings/{name}.mcap");
        let out = stictiond(&["replay", &recording, "--verify"]);
        assert!(out.status.success(), "{name}: {}", String::from_utf8_lossy(&out.stdout));
        let again = dir.path().join(format!("{name}.mcap"));
        let scenario = format!("recordings/scenarios/{name}.toml");
        let out = stictiond(&["simulate", &scenario, "--out", again.to_str().unwrap()]);
        assert!(out.status.success(), "{name}: {}", String::from_utf8_lossy(&out.stderr));
        assert!(
            fs::read(&again).unwrap() == fs::read(&recording).unwrap(),
            "{recording} is not what {scenario} makes now: run stictiond simulate {scenario} --out {recording} --force"
        );
    }
}

#[test]
fn the_tour_finds_the_sticking_valve_and_its_size() {
    let out = stictiond(&["analyze", "recordings/sticking.mcap", "--format", "json"]);
    assert!(out.status.success());
    let d: serde_json::Value = serde_json::from_slice(&out.stdout).unwrap();
    assert_eq!((&d["verdict"], &d["loop"]), (&"stiction".into(), &"FIC101".into()));
    // The truth: fs 5, fd 3.
    let near = |key: &str, truth: f64| (d[key].as_f64().unwrap() - truth).abs() < 0.05 * truth;
    assert!(near("s", 8.0) && near("fs", 5.0) && near("fd", 3.0), "{d}");
    assert!(d["elapsed_ms"].as_f64().unwrap() > 0.0);
}

#[test]
fn outputs_are_never_replaced_unasked_and_folders_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("x.mcap");
    fs::write(&out, b"precious").unwrap();
    let refused = stictiond(&["simulate", "recordings/scenarios/sticking.toml", "--out", out.to_str().unwrap()]);
    assert_eq!(refused.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&refused.stderr).contains("--force"));
    assert_eq!(fs::read(&out).unwrap(), b"precious");
    assert_eq!(stictiond(&["analyze", dir.path().to_str().unwrap()]).status.code(), Some(1));
}

#[test]
fn a_short_or_empty_file_is_an_error_that_says_how_much_is_needed() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("short.csv");
    let rows: String = (0..29).map(|k| format!("{k},{},{}\n", k % 3, k % 5)).collect();
    fs::write(&path, format!("t,op,pv\n{rows}")).unwrap();
    let out = stictiond(&["analyze", path.to_str().unwrap()]);
    assert_eq!(out.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&out.stderr).contains("30"));
    for arguments in [&["analyze"][..], &["nonsense"], &["analyze", "x.csv", "--samples", "5,5"]] {
        assert_eq!(stictiond(arguments).status.code(), Some(2), "{arguments:?}");
    }
    for command in ["run", "demo", "play", "replay", "analyze", "simulate", "convert", "check", "info"] {
        let help = stictiond(&[command, "--help"]);
        assert!(help.status.success() && !help.stdout.is_empty(), "{command}");
    }
}
