//! Gap diagnoses in the daemon, as seen from the bus and from its recordings.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

use crate::live::{Daemon, FAST, ask, documents, files, ok, plane, sticking, stictiond, wait_for};
use serde_json::Value;
use stiction_engine::codec::topic::Kind;
use zenoh::Wait;

const SMALL: &str = "[gap]\nbudget_evaluations = 3000\n";

/// Samples as CSV, header first.
fn rows(dir: &Path) -> (String, Vec<String>) {
    let csv = dir.join("FIC101.csv");
    ok(&["convert", &sticking(dir), csv.to_str().unwrap()]);
    let text = fs::read_to_string(&csv).unwrap();
    let mut lines = text.lines().map(str::to_owned);
    (lines.next().unwrap(), lines.collect())
}

fn write(dir: &Path, header: &str, rows: &[String]) -> PathBuf {
    let csv = dir.join("FIC101.csv");
    fs::write(&csv, format!("{header}\n{}\n", rows.join("\n"))).unwrap();
    csv
}

fn play(daemon: &Daemon, dir: &Path, header: &str, rows: &[String]) {
    daemon.play(write(dir, header, rows).to_str().unwrap());
}

#[test]
fn a_person_is_answered_and_every_file_replays_to_the_byte() {
    let dir = tempfile::tempdir().unwrap();
    let settings = format!("{FAST}max_bytes = 15000\n{SMALL}");
    let daemon = Daemon::start(dir.path(), &settings);
    let bus = daemon.session();
    let heard: Arc<Mutex<Vec<Value>>> = Arc::default();
    let taking = heard.clone();
    let subscriber = bus
        .declare_subscriber(plane("*/gap"))
        .callback(move |s| taking.lock().unwrap().push(serde_json::from_slice(&s.payload().to_bytes()).unwrap()))
        .wait()
        .unwrap();
    let (header, rows) = rows(dir.path());
    for piece in rows.chunks(400) {
        let csv = write(dir.path(), &header, piece);
        daemon.play_to_disk(csv.to_str().unwrap());
    }
    daemon.wait_for_estimates(6);

    let answer = ask(&bus, &format!("{}?run;by=ann", plane("FIC101/gap"))).unwrap();
    assert_eq!((&answer["schema"], &answer["loop"]), (&"stictiond.gap.v1".into(), &"FIC101".into()));
    assert_eq!((&answer["reason"], &answer["by"]), (&"operator".into(), &"ann".into()));
    // The loop was graded before, so the gap is split by its accepted model.
    assert_eq!(answer["base"]["source"], "given");
    assert!(answer["given"]["gap"].as_f64().unwrap() >= 0.0 && answer["parametric"].is_number(), "{answer}");
    assert_eq!(ask(&bus, &plane("FIC101/gap")).unwrap(), answer, "the last value");
    // A query's reply and a publication take separate paths, and neither waits for the other.
    wait_for("the publication", || (!heard.lock().unwrap().is_empty()).then_some(()));
    assert_eq!(*heard.lock().unwrap(), std::slice::from_ref(&answer), "published once");
    for refused in ["NOPE/gap?run", "*/gap?run", "FIC101/estimate?run"] {
        assert!(ask(&bus, &plane(refused)).is_err(), "{refused}");
    }
    subscriber.undeclare().wait().unwrap();
    bus.close().wait().unwrap();

    let files = files(&daemon.stop());
    assert!(files.len() >= 3, "{files:?}");
    let holding: Vec<_> = files.iter().filter(|f| !documents(f, Kind::Gap).is_empty()).collect();
    let [file] = holding[..] else { panic!("{holding:?}") };
    assert_eq!(documents(file, Kind::Gap), [("FIC101".to_owned(), answer)]);
    // A new file may begin between request and reply.
    let inputs: Vec<_> = files.iter().flat_map(|f| documents(f, Kind::Input)).collect();
    assert!(inputs.iter().any(|(_, i)| i["kind"] == "gap_run" && i["by"] == "ann"), "{inputs:?}");
    // By itself: data that its windows and the accepted model need are read from the files before it.
    ok(&["replay", file.to_str().unwrap(), "--verify"]);
    let text = ok(&["replay", file.to_str().unwrap()]);
    assert!(text.contains(" gap ") && text.contains("(operator"), "{text}");
}

#[test]
fn a_loop_that_departs_is_diagnosed_unasked_once_and_no_estimate_waits_for_it() {
    let dir = tempfile::tempdir().unwrap();
    let window = "[window]\nhop_s = 150.0\nmax_periods = 5\n[recording]\nflush_s = 0.1\n";
    let daemon = Daemon::start(dir.path(), &format!("{window}{SMALL}"));
    let (header, mut rows) = rows(dir.path());
    let pv = header.split(',').position(|name| name == "pv").unwrap();
    // From some time on, add something that no valve does.
    for (k, row) in rows.iter_mut().enumerate().skip(1200) {
        let mut cells: Vec<String> = row.split(',').map(str::to_owned).collect();
        let value: f64 = cells[pv].parse().unwrap();
        cells[pv] = (value + 3.0 * (k as f64 * 0.11).sin()).to_string();
        *row = cells.join(",");
    }
    play(&daemon, dir.path(), &header, &rows);
    // All of them, since a window that is not finished when the daemon stops is skipped.
    daemon.wait_for_estimates(14);
    wait_for("a diagnosis", || {
        files(&daemon.recordings).iter().any(|f| !documents(f, Kind::Gap).is_empty()).then_some(())
    });
    let recordings = daemon.stop();
    let file = files(&recordings).pop().unwrap();
    let gaps = documents(&file, Kind::Gap);
    assert_eq!(gaps.len(), 1, "once a day");
    let reason = gaps[0].1["reason"].as_str().unwrap();
    assert!(["fit_fell", "gap_grew"].contains(&reason) && gaps[0].1["by"].is_null(), "{reason}");
    // Every window has its estimate, none was skipped, and all are in order of their windows.
    let ends: Vec<i64> = documents(&file, Kind::Estimate)
        .iter()
        .map(|(_, d)| {
            assert!(!d["gates"].as_array().unwrap().iter().any(|g| g == "skipped"), "{d}");
            d["window"]["end_ns"].as_i64().unwrap()
        })
        .collect();
    assert!(ends.len() == 14 && ends.windows(2).all(|w| w[1] - w[0] == 150_000_000_000), "{ends:?}");
    ok(&["replay", file.to_str().unwrap(), "--verify"]);
}

#[test]
fn a_diagnosis_under_way_at_the_end_is_a_recorded_skip() {
    let dir = tempfile::tempdir().unwrap();
    let endless = "[gap]\nenabled = false\nbudget_evaluations = 100000000\n";
    let daemon = Daemon::start(dir.path(), &format!("{FAST}{endless}"));
    let bus = daemon.session();
    let (header, rows) = rows(dir.path());
    play(&daemon, dir.path(), &header, &rows[..500]);
    daemon.wait_for_estimates(1);
    let asked = std::thread::spawn(move || {
        let answer = ask(&bus, &format!("{}?run;by=ann", plane("FIC101/gap")));
        bus.close().wait().unwrap();
        answer
    });
    wait_for("the request in the recording", || {
        files(&daemon.recordings).iter().any(|f| !documents(f, Kind::Input).is_empty()).then_some(())
    });
    let file = files(&daemon.stop()).pop().unwrap();
    let inputs: Vec<Value> = documents(&file, Kind::Input).into_iter().map(|(_, d)| d).collect();
    assert_eq!(inputs[0]["kind"], "gap_run");
    let last = inputs.last().unwrap();
    if documents(&file, Kind::Gap).is_empty() {
        assert_eq!((&last["kind"], &last["reason"]), (&"gap_skip".into(), &"shutdown".into()));
        assert!(asked.join().unwrap().unwrap_err().contains("stopped"));
    } else {
        // If the search finished before the daemon's end, it was cut there or came to a natural end.
        assert!(asked.join().unwrap().is_ok());
    }
    assert_eq!(stictiond(&["replay", file.to_str().unwrap(), "--verify"]).status.code(), Some(0));
}
