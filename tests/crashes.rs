//! Crashes, clocks and disks: what was acknowledged is never lost, and the daemon always starts.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]
#![cfg(feature = "daemon")]

#[path = "common/live.rs"]
mod live;

use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

use live::{Daemon, FAST, alarm_state, ask, configure, files, free_port, plane, sticking, wait_for};
use zenoh::Wait;

/// A daemon whose alarm on FIC101 is raised.
fn alarmed(dir: &Path) -> Daemon {
    let daemon = Daemon::start(dir, FAST);
    daemon.play(&sticking(dir));
    daemon.wait_for_estimates(6);
    daemon
}

/// The alarm's state after one more start.
fn state_after_restart(dir: &Path) -> String {
    let daemon = Daemon::start(dir, FAST);
    let bus = daemon.session();
    let state = wait_for("an alarm", || Some(alarm_state(&bus)).filter(|s| s != "no answer"));
    bus.close().wait().unwrap();
    daemon.stop();
    state
}

#[test]
fn an_acknowledgement_outlives_kill_9_and_an_orderly_end() {
    let dir = tempfile::tempdir().unwrap();
    let daemon = alarmed(dir.path());
    let bus = daemon.session();
    let acked = ask(&bus, &plane("FIC101/alarm?cmd=ack;by=ann;why=seen")).unwrap();
    assert_eq!((&acked["state"], &acked["by"]), (&"acked".into(), &"ann".into()));
    // The answer is there: from here on nothing may take it back.
    daemon.kill();
    drop(bus);
    assert_eq!(state_after_restart(dir.path()), "acked");
    assert_eq!(state_after_restart(dir.path()), "acked", "after an orderly end");
    let all = files(&dir.path().join("rec"));
    // Without the store the recordings give it.
    fs::remove_file(dir.path().join("rec/state.redb")).unwrap();
    assert_eq!(state_after_restart(dir.path()), "acked", "without the store");
    for file in all.iter().filter(|f| f.extension().unwrap() == "mcap") {
        live::ok(&["replay", file.to_str().unwrap(), "--verify"]);
    }
}

#[test]
fn kills_just_after_a_start_cost_no_alarm() {
    let dir = tempfile::tempdir().unwrap();
    alarmed(dir.path()).kill();
    let path = configure(dir.path(), &format!("tcp/127.0.0.1:{}", free_port()), FAST);
    // Set higher for a long run; also without the store, from the recordings alone.
    let cycles = std::env::var("STICTIOND_CYCLES").ok().and_then(|n| n.parse().ok()).unwrap_or(16_u64);
    for cycle in 0..cycles {
        if cycle % 2 == 1 {
            let _ = fs::remove_file(dir.path().join("rec/state.redb"));
        }
        let mut child = Command::new(env!("CARGO_BIN_EXE_stictiond"))
            .args(["run", "--config", path.to_str().unwrap()])
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        std::thread::sleep(Duration::from_millis(cycle * 37 % 100));
        child.kill().unwrap();
        child.wait().unwrap();
        if cycle % 4 >= 2 {
            assert_eq!(state_after_restart(dir.path()), "unack", "cycle {cycle}");
        }
    }
    assert_eq!(state_after_restart(dir.path()), "unack");
}

#[test]
fn a_recording_folder_that_is_removed_is_counted_named_and_made_again() {
    let dir = tempfile::tempdir().unwrap();
    let daemon = Daemon::start(dir.path(), "[recording]\nflush_s = 0.1\n");
    let bus = daemon.session();
    let mut sent = 0_u64;
    let mut feed = |count: u64| {
        for _ in 0..count {
            let t_ns = 1_700_000_000_000_000_000 + sent * 1_000_000_000;
            bus.put("plant1/area1/A/op", format!("{{\"t\":{t_ns},\"v\":1}}")).wait().unwrap();
            sent += 1;
        }
        wait_for("the samples", || (daemon.counter("samples") == sent).then_some(()));
    };
    feed(50);
    wait_for("the recording", || (daemon.counter("recorded") >= 50).then_some(()));
    std::thread::sleep(Duration::from_millis(300));
    fs::remove_dir_all(&daemon.recordings).unwrap();
    wait_for("the loss", || (daemon.counter("recording_lost") >= 50).then_some(()));
    wait_for("a new file", || (!files(&daemon.recordings).is_empty()).then_some(()));
    let faults = wait_for("a fault", || Some(daemon.faults()).filter(|f| !f.is_empty()));
    assert!(faults.iter().any(|f| f.contains("recorded")), "{faults:?}");
    feed(30);
    bus.close().wait().unwrap();
    let lost = daemon.counter("recording_lost");
    let recordings = daemon.stop();
    let kept: usize = files(&recordings).iter().map(|f| raw_samples(f)).sum();
    assert_eq!(kept as u64 + lost, 80, "every sample is recorded or counted as lost");
}

fn raw_samples(file: &Path) -> usize {
    let loaded = stictiond::files::load_samples(file).unwrap();
    loaded.loops.iter().map(|l| l.samples.len()).sum()
}
