//! The daemon run as a program: played data in, recordings out, restarts, and orderly ends.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::collections::BTreeMap;
use std::fs;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use crate::common;
use crate::live::{Daemon, FAST, documents, files, free_port, ok, sticking, stictiond, wait_for};
use serde_json::Value;
use stiction_engine::codec::topic::Kind;
use stiction_files::RecordingReader;
use zenoh::Wait;

#[test]
fn real_recordings_played_live_give_the_numbers_of_analyze_and_replay() {
    let data = Path::new("../shared/data");
    if !data.exists() {
        common::skipped("real_recordings_played_live_give_the_numbers_of_analyze_and_replay", "no ../shared/data");
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let daemon = Daemon::start(dir.path(), "[recording]\nflush_s = 0.1\n");
    let mut inputs: Vec<PathBuf> = ["isdb/BAS7", "isdb/CHEM25", "isdb/CHEM28", "isdb/PAP6", "isdb/MET1"]
        .iter()
        .map(|f| data.join(format!("{f}.csv")))
        .collect();
    // Four recordings of the sticking valve with the most recordings.
    let mut of_valve: BTreeMap<String, Vec<PathBuf>> = BTreeMap::new();
    for row in csv::Reader::from_path(data.join("INDEX.csv")).unwrap().records().flatten() {
        if row[0].starts_with("plant/") && &row[6] == "stiction" {
            // A name ends in the date and time of the recording.
            let valve = row[0].rsplitn(3, '_').last().unwrap_or_default().to_owned();
            of_valve.entry(valve).or_default().push(data.join(&row[0]));
        }
    }
    let mut sticky = of_valve.into_values().max_by_key(Vec::len).unwrap();
    sticky.sort();
    inputs.extend(sticky.into_iter().take(4));
    // Twelve hours of a week-long recording.
    let stretch = fs::read_to_string(data.join("longrun/LIC-106.csv")).unwrap();
    let lines: Vec<&str> = stretch.lines().take(721).collect();
    let long = dir.path().join("LIC-106.csv");
    fs::write(&long, lines.join("\n")).unwrap();
    inputs.push(long);
    for input in &inputs {
        daemon.play(input.to_str().unwrap());
    }
    daemon.wait_for_estimates(130);
    let recordings = daemon.stop();
    let file = files(&recordings).pop().unwrap();
    let mut compared = 0;
    for (name, live) in documents(&file, Kind::Estimate) {
        // Every fourth fitted window of each loop is enough.
        let end_ns = live["window"]["end_ns"].as_i64().unwrap();
        if live["s"].is_null() || (end_ns / 600_000_000_000) % 4 != 0 {
            continue;
        }
        let window = format!("{}ns,{end_ns}ns", live["window"]["start_ns"]);
        let text = ok(&["analyze", file.to_str().unwrap(), "--loop", &name, "--window", &window, "--format", "json"]);
        let again: Value = serde_json::from_str(&text).unwrap();
        for key in
            ["window", "oscillation", "verdict", "fs", "fd", "s", "j", "stiction_index", "process", "config_hash"]
        {
            assert_eq!(live[key], again[key], "{name} {window} {key}");
        }
        compared += 1;
    }
    assert!(compared >= 6, "{compared}");
    ok(&["replay", recordings.to_str().unwrap(), "--verify"]);
}

/// Plays the sticking loop in pieces, so that files fill and rotate between them; returns the finished files.
fn rotated(dir: &Path, window: &str) -> Vec<PathBuf> {
    let settings = FAST.replace("[window]\n", &format!("[window]\n{window}"));
    let daemon = Daemon::start(dir, &settings.replace("[recording]\n", "[recording]\nmax_bytes = 15000\n"));
    let input = sticking(dir);
    let csv = dir.join("FIC101.csv");
    ok(&["convert", &input, csv.to_str().unwrap()]);
    let text = fs::read_to_string(&csv).unwrap();
    let (header, rows) = text.split_once('\n').unwrap();
    let rows: Vec<&str> = rows.lines().collect();
    for piece in rows.chunks(200) {
        fs::write(&csv, format!("{header}\n{}\n", piece.join("\n"))).unwrap();
        daemon.play_to_disk(csv.to_str().unwrap());
    }
    daemon.wait_for_estimates(6);
    files(&daemon.stop())
}

#[test]
fn every_rotated_file_is_verified_by_itself_and_a_missing_one_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let files = rotated(dir.path(), "");
    assert!(files.len() >= 3, "{files:?}");
    assert!(files.iter().all(|f| f.extension().unwrap() == "mcap"), "{files:?}");
    for file in &files {
        ok(&["replay", file.to_str().unwrap(), "--verify"]);
        ok(&["info", file.to_str().unwrap(), "--verify"]);
    }
    fs::remove_file(&files[1]).unwrap();
    let out = stictiond(&["replay", files[2].to_str().unwrap(), "--verify"]);
    assert_eq!(out.status.code(), Some(1));
    let missing = files[1].file_name().unwrap().to_str().unwrap();
    assert!(String::from_utf8_lossy(&out.stderr).contains(missing));
}

#[test]
fn verification_reads_only_as_far_back_as_windows_reach() {
    let dir = tempfile::tempdir().unwrap();
    // Windows of 310 s at most: a file that starts 1,000 s into the run does not need the first one, and gives the same without
    // it.
    let files = rotated(dir.path(), "max_window_s = 310\n");
    assert!(files.len() >= 6, "{files:?}");
    let last = files.last().unwrap().to_str().unwrap();
    let whole = ok(&["replay", last, "--verify"]);
    fs::remove_file(&files[0]).unwrap();
    assert_eq!(ok(&["replay", last, "--verify"]), whole);
    let with_estimates = files.iter().rposition(|f| !documents(f, Kind::Estimate).is_empty()).unwrap();
    let file = files[with_estimates].to_str().unwrap();
    assert!(!ok(&["replay", file, "--verify"]).contains(" 0 estimates"));
}

#[test]
fn alarms_survive_kill_9_and_broken_files_do_not_stop_the_start() {
    let dir = tempfile::tempdir().unwrap();
    let input = sticking(dir.path());
    let first = Daemon::start(dir.path(), FAST);
    first.play(&input);
    first.wait_for_estimates(6);
    wait_for("the alarm on the disk", || {
        let last = files(&first.recordings).pop()?;
        (!documents(&last, Kind::Alarm).is_empty()).then_some(())
    });
    let recordings = first.kill();
    let part = files(&recordings).pop().unwrap();
    assert!(part.to_str().unwrap().ends_with(".mcap.part"));
    assert!(!documents(&part, Kind::Alarm).is_empty());
    // The flushed part is verified as far as it goes, and reported as cut off.
    let out = stictiond(&["replay", part.to_str().unwrap(), "--verify"]);
    assert_eq!(out.status.code(), Some(3), "{}", String::from_utf8_lossy(&out.stderr));

    fs::write(recordings.join("broken.mcap"), b"this is no recording").unwrap();
    fs::write(recordings.join("empty.mcap.part"), b"").unwrap();
    let second = Daemon::start(dir.path(), FAST);
    second.play(&input);
    second.wait_for_estimates(12);
    let recordings = second.stop();
    assert!(recordings.join("broken.mcap.broken").exists() && !recordings.join("empty.mcap.part").exists());
    let new = files(&recordings).into_iter().rfind(|f| f.extension().unwrap() == "mcap").unwrap();
    let states = documents(&new, Kind::State);
    assert_eq!(states[0].1["alarm"]["state"], "unack", "the first state of the new run is the old alarm");
    // Carried over: the same alarm is not raised again.
    assert!(documents(&new, Kind::Alarm).iter().all(|(_, d)| d["state"] != "unack"));
    ok(&["replay", new.to_str().unwrap(), "--verify"]);
}

#[test]
fn a_changed_recording_fails_verification_and_another_version_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let recording = dir.path().join("s.mcap");
    let path = recording.to_str().unwrap();
    ok(&["simulate", "recordings/scenarios/sticking.toml", "--out", path]);
    ok(&["replay", path, "--verify"]);
    // The same messages with one digit of an estimate changed, and with another version.
    let rewrite = |change: &dyn Fn(&str, &mut Vec<u8>), version: &str| {
        let mut reader = RecordingReader::open(&recording).unwrap();
        let mut metadata = reader.metadata().clone();
        metadata.insert("version".into(), version.into());
        let stem = format!("changed-{version}");
        let mut out = stiction_files::RecordingFile::create(dir.path(), &stem, &metadata).unwrap();
        while let Some(m) = reader.next_message().unwrap() {
            let mut data = m.data.to_vec();
            change(m.topic(), &mut data);
            out.write(m.topic(), m.channel.kind.unwrap(), m.log_time_ns, m.publish_time_ns, &data).unwrap();
        }
        out.finish().unwrap()
    };
    let touched = rewrite(
        &|topic, data| {
            if topic.ends_with("estimate") {
                let text = String::from_utf8(data.clone()).unwrap().replace("\"stiction\":true", "\"stiction\":false");
                *data = text.into_bytes();
            }
        },
        stiction::core::VERSION,
    );
    let out = stictiond(&["replay", touched.to_str().unwrap(), "--verify"]);
    assert_eq!(out.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&out.stdout).contains("DIFFERS"));
    let foreign = rewrite(&|_, _| {}, "0.0.1");
    assert_eq!(stictiond(&["replay", foreign.to_str().unwrap(), "--verify"]).status.code(), Some(2));
    ok(&["replay", foreign.to_str().unwrap(), "--verify", "--allow-version"]);
}

#[test]
fn a_faulty_configuration_ends_with_exit_1_and_a_remedy() {
    let dir = tempfile::tempdir().unwrap();
    let config = dir.path().join("c.toml");
    fs::write(&config, "[site]\nprefx = 1\n").unwrap();
    let out = stictiond(&["run", "--config", config.to_str().unwrap()]);
    assert_eq!(out.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&out.stderr).contains("did you mean prefix?"));
    assert_eq!(stictiond(&["run"]).status.code(), Some(2));
}

#[test]
fn the_demo_finds_the_sticking_valve_and_leaves_a_recording_that_verifies() {
    let dir = tempfile::tempdir().unwrap();
    let binary = env!("CARGO_BIN_EXE_stictiond");
    let mut child = Command::new(binary)
        .args(["demo", "--for", "600", "--format", "json"])
        .current_dir(dir.path())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let mut documents: Vec<Value> = Vec::new();
    for line in BufReader::new(child.stdout.take().unwrap()).lines() {
        documents.push(serde_json::from_str(&line.unwrap()).unwrap());
        let last = &documents[documents.len() - 1];
        if last["schema"] == "stictiond.alarm.v2" && last["state"] == "unack" {
            assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
        }
    }
    assert!(child.wait().unwrap().success());
    let sticking: Vec<&Value> = documents.iter().filter(|d| d["stiction"] == true).collect();
    assert!(!sticking.is_empty() && sticking.iter().all(|d| d["loop"] == "FIC101"), "{documents:?}");
    assert!(documents.iter().any(|d| d["schema"] == "stictiond.alarm.v2" && d["state"] == "unack"));
    let recordings = dir.path().join("recordings/demo");
    assert!(files(&recordings).iter().all(|f| f.extension().unwrap() == "mcap"));
    ok(&["replay", recordings.to_str().unwrap(), "--verify"]);
}

#[test]
fn play_sends_once_something_subscribes() {
    let endpoint = format!("tcp/127.0.0.1:{}", free_port());
    let mut config = zenoh::Config::default();
    for (key, value) in
        [("listen/endpoints", format!("[{endpoint:?}]")), ("scouting/multicast/enabled", "false".into())]
    {
        config.insert_json5(key, &value).unwrap();
    }
    let bus = zenoh::open(config).wait().unwrap();
    let play = ["play", "recordings/sticking.mcap", "--prefix", "late", "--speed", "max", "--format", "json"];
    let play = Command::new(env!("CARGO_BIN_EXE_stictiond"))
        .args(play)
        .args(["--connect", &endpoint])
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    // It is connected by then, unless the machine is slow.
    std::thread::sleep(Duration::from_secs(3));
    let received = Arc::new(AtomicU64::new(0));
    let counter = received.clone();
    let count = move |_| {
        counter.fetch_add(1, Ordering::Relaxed);
    };
    let _subscriber = bus.declare_subscriber("late/**").callback(count).wait().unwrap();
    let said: Value = serde_json::from_slice(&play.wait_with_output().unwrap().stdout).unwrap();
    let sent = said["published"].as_u64().unwrap();
    assert!(sent > 1000 && said["published"] == said["of"], "{said}");
    wait_for("every sample", || (received.load(Ordering::Relaxed) == sent).then_some(()));
}
