//! Crashes, clocks and disks: acknowledged data are never lost, and the daemon always starts.

use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

use crate::live::{
    Daemon, FAST, alarm_state, alarmed, ask, configure, files, free_port, plane, raw_samples, state_after_restart,
    wait_for,
};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use zenoh::Wait;

/// Number of documents of all kinds, and of raw samples, in a file.
fn contents(file: &Path) -> (usize, usize) {
    let info = crate::live::ok(&["info", file.to_str().unwrap(), "--verify", "--format", "json"]);
    let info: serde_json::Value = serde_json::from_str(&info).unwrap();
    let results: u64 = info["results"].as_object().unwrap().values().map(|n| n.as_u64().unwrap()).sum();
    (usize::try_from(results).unwrap(), raw_samples(file))
}

#[test]
fn retention_takes_samples_out_keeps_results_and_never_touches_what_is_in_use() {
    let dir = tempfile::tempdir().unwrap();
    let daemon = alarmed(dir.path());
    let done = files(&daemon.stop()).pop().unwrap();
    let before = contents(&done);
    assert!(before.0 > 6 && before.1 > 1000, "{before:?}");
    let daemon = Daemon::start(dir.path(), &format!("{FAST}[retention]\nraw_bytes = 1\n"));
    wait_for("the retention", || (daemon.counter("recordings_thinned") == 1).then_some(()));
    assert_eq!(contents(&done), (before.0, 0), "results stay, samples go");
    daemon.wait_for_log("retention: samples taken out");
    let bus = daemon.session();
    assert_eq!(alarm_state(&bus).as_deref(), Some("unack"));
    bus.close().wait().unwrap();
    let replayed = crate::live::stictiond(&["replay", done.to_str().unwrap(), "--verify"]);
    assert_eq!(replayed.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&replayed.stderr).contains("[retention]"));
    // The file in use was kept, and is completed.
    assert_eq!(files(&daemon.stop()).iter().filter(|f| f.extension().unwrap() == "mcap").count(), 2);
    let daemon = Daemon::start(dir.path(), &format!("{FAST}[retention]\nraw_bytes = 1\nresults_bytes = 1\n"));
    wait_for("the removal", || (daemon.counter("recordings_removed") >= 1).then_some(()));
    assert!(!done.exists());
    daemon.stop();
}

#[test]
fn damaged_recordings_are_named_until_they_are_gone_and_recover_saves_what_can_be_read() {
    let dir = tempfile::tempdir().unwrap();
    let done = files(&alarmed(dir.path()).stop()).pop().unwrap();
    let whole = fs::read(&done).unwrap();
    let rec = dir.path().join("rec");
    for k in 0..3 {
        let mut hurt = whole.clone();
        hurt[whole.len() / 2 + k * 100] ^= 4;
        fs::write(rec.join(format!("hurt{k}.mcap")), &hurt).unwrap();
        fs::write(rec.join(format!("junk{k}.mcap")), vec![k as u8 + 1; 500]).unwrap();
        fs::write(rec.join(format!("cut{k}.mcap")), &whole[..whole.len() / (k + 2)]).unwrap();
    }
    let daemon = Daemon::start(dir.path(), FAST);
    let faults = wait_for("the faults", || {
        Some(daemon.faults()).filter(|f| f.iter().any(|f| f.contains("6 recordings are damaged")))
    });
    assert!(faults.iter().any(|f| f.contains("3 broken files are in")), "{faults:?}");
    assert_eq!(daemon.counter("quarantined"), 3);
    // Rescues into another folder: as much as possible of damaged files, and an exact copy of complete ones.
    let out = dir.path().join("rescued");
    let status = crate::live::stictiond(&["recover", rec.to_str().unwrap(), "--out", out.to_str().unwrap()]).status;
    assert_eq!(status.code(), Some(3));
    assert_eq!(fs::read(out.join(done.file_name().unwrap())).unwrap(), whole);
    assert!(contents(&out.join("hurt0.mcap")).1 > 1000);
    // Never onto itself, whether named by file or by folder.
    let again = out.join(done.file_name().unwrap());
    for onto in [&again, &out] {
        let said =
            crate::live::stictiond(&["recover", onto.to_str().unwrap(), "--out", onto.to_str().unwrap(), "--force"]);
        assert!(!said.status.success() && String::from_utf8_lossy(&said.stderr).contains("the input itself"));
    }
    assert_eq!(fs::read(&again).unwrap(), whole);
    assert!(!out.join("junk0.mcap").exists());
    for entry in fs::read_dir(&rec).unwrap().flatten() {
        let name = entry.file_name().to_string_lossy().into_owned();
        if ["hurt", "junk", "cut"].iter().any(|start| name.starts_with(start)) {
            fs::remove_file(entry.path()).unwrap();
        }
    }
    wait_for("no fault", || daemon.faults().is_empty().then_some(()));
    daemon.stop();
}

#[test]
fn what_people_put_aside_stays_there_over_a_crash() {
    let dir = tempfile::tempdir().unwrap();
    let daemon = alarmed(dir.path());
    let bus = daemon.session();
    let asked = |parameters: &str| ask(&bus, &plane(&format!("FIC101/alarm?{parameters}")));
    let shelved = asked("cmd=shelve;by=ann;why=overhaul;for_s=7200").unwrap();
    assert_eq!((&shelved["state"], &shelved["active"]), (&"shelved".into(), &true.into()));
    assert!(asked("cmd=shelve;by=ann;for_s=x").unwrap_err().contains("whole number"));
    assert!(asked("cmd=shelve;by=ann").unwrap_err().contains("unshelve"));
    daemon.kill();
    assert_eq!(state_after_restart(dir.path()), "shelved");
    let daemon = Daemon::start(dir.path(), FAST);
    let bus = daemon.session();
    let back = ask(&bus, &plane("FIC101/alarm?cmd=unshelve;by=bob")).unwrap();
    assert_eq!((&back["state"], &back["by"]), (&"unack".into(), &"bob".into()));
    bus.close().wait().unwrap();
    daemon.stop();
}

#[test]
fn an_acknowledgement_outlives_kill_9_and_an_orderly_end() {
    let dir = tempfile::tempdir().unwrap();
    let daemon = alarmed(dir.path());
    let bus = daemon.session();
    let acked = ask(&bus, &plane("FIC101/alarm?cmd=ack;by=ann;why=seen")).unwrap();
    assert_eq!((&acked["state"], &acked["by"]), (&"acked".into(), &"ann".into()));
    // After the reply, nothing may undo the command.
    daemon.kill();
    drop(bus);
    assert_eq!(state_after_restart(dir.path()), "acked");
    assert_eq!(state_after_restart(dir.path()), "acked", "after an orderly end");
    let all = files(&dir.path().join("rec"));
    // Without the store the state comes from the recordings.
    fs::remove_file(dir.path().join("rec/state.redb")).unwrap();
    assert_eq!(state_after_restart(dir.path()), "acked", "without the store");
    for file in all.iter().filter(|f| f.extension().unwrap() == "mcap") {
        crate::live::ok(&["replay", file.to_str().unwrap(), "--verify"]);
    }
}

#[test]
fn a_recording_in_columns_outlives_kill_9_up_to_its_last_flush() {
    let dir = tempfile::tempdir().unwrap();
    let fast = format!("{FAST}raw = \"columns\"\n");
    let daemon = Daemon::start(dir.path(), &fast);
    daemon.play(&crate::live::sticking(dir.path()));
    daemon.wait_for_estimates(6);
    let open = files(&dir.path().join("rec")).pop().unwrap();
    assert!(open.to_str().unwrap().ends_with(".part"));
    wait_for("the samples on the disk", || (raw_samples(&open) as u64 == daemon.counter("samples")).then_some(()));
    let samples = raw_samples(&open);
    daemon.kill();
    assert!(raw_samples(&open) >= samples && samples > 1000, "{samples}");
    let replayed = crate::live::stictiond(&["replay", open.to_str().unwrap(), "--verify"]);
    // Cut off, and equal up to that point.
    assert_eq!(replayed.status.code(), Some(3), "{}", String::from_utf8_lossy(&replayed.stderr));
    // Without the store, the alarm is found in this file; the next file begins where it ended.
    fs::remove_file(dir.path().join("rec/state.redb")).unwrap();
    assert_eq!(state_after_restart(dir.path()), "unack");
}

#[test]
fn kills_just_after_a_start_cost_no_alarm() {
    let dir = tempfile::tempdir().unwrap();
    alarmed(dir.path()).kill();
    let path = configure(dir.path(), &format!("tcp/127.0.0.1:{}", free_port()), FAST);
    // Set higher for long runs. Half of the cycles go without the store, from the recordings alone.
    let cycles = std::env::var("STICTIOND_CYCLES").ok().and_then(|n| n.parse().ok()).unwrap_or(16_u64);
    for cycle in 0..cycles {
        if cycle % 2 == 1 {
            let _ = fs::remove_file(dir.path().join("rec/state.redb"));
        }
        let mut child = Command::new(crate::live::program())
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

/// Effect of commands on an active alarm, modelled by three flags.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Inhibit {
    acked: bool,
    shelved: bool,
    suppressed: bool,
}

impl Inhibit {
    fn shown(self) -> &'static str {
        match (self.suppressed, self.shelved, self.acked) {
            (true, _, _) => "suppressed",
            (_, true, _) => "shelved",
            (_, _, true) => "acked",
            _ => "unack",
        }
    }

    /// The state after a command, and the command's name.
    fn asked(self, k: u64) -> (Self, &'static str) {
        match k % 3 {
            0 if !self.acked => (Self { acked: true, ..self }, "ack"),
            1 if self.suppressed => (Self { suppressed: false, ..self }, "unsuppress"),
            1 => (Self { suppressed: true, ..self }, "suppress"),
            _ if self.shelved => (Self { shelved: false, ..self }, "unshelve"),
            _ => (Self { shelved: true, ..self }, "shelve"),
        }
    }
}

#[test]
fn commands_that_were_answered_outlive_kill_9_at_any_moment() {
    let dir = tempfile::tempdir().unwrap();
    alarmed(dir.path()).kill();
    // Set higher for long runs.
    let cycles = std::env::var("STICTIOND_CYCLES").ok().and_then(|n| n.parse().ok()).unwrap_or(12_u64);
    let mut random = ChaCha8Rng::seed_from_u64(cycles);
    let mut known = Inhibit { acked: false, shelved: false, suppressed: false };
    let (mut answered, mut cut) = (0, 0);
    for cycle in 0..cycles {
        let daemon = Daemon::start(dir.path(), FAST);
        let bus = daemon.session();
        let state = wait_for("an alarm", || alarm_state(&bus));
        assert_eq!(state, known.shown(), "cycle {cycle}: {known:?}");
        // Some commands are answered just before the kill, and one may be under way.
        for k in 0..random.next_u32() % 3 {
            let (next, cmd) = known.asked(u64::from(random.next_u32()));
            ask(&bus, &plane(&format!("FIC101/alarm?cmd={cmd};by=ann")))
                .unwrap_or_else(|e| panic!("{cycle}, {k}, {cmd}: {e}"));
            (known, answered) = (next, answered + 1);
        }
        let (next, cmd) = known.asked(u64::from(random.next_u32()));
        let under_way = bus.get(plane(&format!("FIC101/alarm?cmd={cmd};by=ann"))).wait().unwrap();
        std::thread::sleep(Duration::from_micros(u64::from(random.next_u32() % 8000)));
        daemon.kill();
        let told = under_way.recv().is_ok_and(|reply| reply.into_result().is_ok());
        let _ = bus.close().wait();
        if told {
            (known, answered) = (next, answered + 1);
        } else {
            // No reply was given, so both states are valid, and the one found must persist.
            cut += 1;
            let state = state_after_restart(dir.path());
            assert!([known.shown(), next.shown()].contains(&&*state), "cycle {cycle}: {state}, {known:?}, {next:?}");
            known = settled(dir.path(), known, next);
        }
    }
    println!("{cycles} cycles, {answered} commands answered, {cut} cut off: none lost");
}

/// Which of two states is in the store.
fn settled(dir: &Path, before: Inhibit, after: Inhibit) -> Inhibit {
    let store = stiction_files::store::StateStore::open(&dir.join("rec/state.redb")).unwrap();
    let stored = store.load().unwrap().values;
    let state: serde_json::Value =
        serde_json::from_slice(&stored[&format!("{}\nFIC101", crate::live::PREFIX)]).unwrap();
    let (alarm, aside) = (&state["alarm"], &state["alarm"]["aside"]);
    let found = Inhibit {
        acked: alarm["state"] == "acked",
        shelved: !aside["shelved_until_ns"].is_null(),
        suppressed: aside["suppressed"] == true,
    };
    assert!([before, after].contains(&found), "{found:?} is neither {before:?} nor {after:?}");
    found
}
