//! A disk that breaks, and folders that are replaced.

use std::fs;
use std::os::unix::fs::symlink;

use zenoh::Wait;

use super::shim::Shim;
use crate::live::{
    Daemon, FAST, alarm_state, alarmed, ask, files, plane, raw_samples, skipped, state_after_restart, sticking,
    wait_for,
};

/// Sends this many samples of loop A, and waits until the daemon has them.
fn feed(daemon: &Daemon, bus: &zenoh::Session, sent: &mut u64, count: u64) {
    let before = daemon.counter("samples");
    for _ in 0..count {
        let t_ns = 1_700_000_000_000_000_000 + *sent * 1_000_000_000;
        bus.put("plant1/area1/A/op", format!("{{\"t\":{t_ns},\"v\":{}}}", *sent % 977)).wait().unwrap();
        *sent += 1;
    }
    wait_for("the samples", || (daemon.counter("samples") == before + count).then_some(()));
}

fn is_named(daemon: &Daemon, part: &str) -> bool {
    daemon.faults().iter().any(|f| f.contains(part))
}

#[test]
fn input_output_errors_are_named_counted_and_over_when_the_disk_is_well() {
    let dir = tempfile::tempdir().unwrap();
    let Some(shim) = Shim::new(dir.path()) else {
        return skipped("input_output_errors", "no C compiler (cc)");
    };
    let daemon = shim.start(dir.path(), FAST);
    daemon.play(&sticking(dir.path()));
    daemon.wait_for_estimates(6);
    let (bus, played, mut sent) = (daemon.session(), daemon.counter("samples"), 0);
    feed(&daemon, &bus, &mut sent, 300);
    wait_for("the samples on the disk", || (daemon.counter("recorded") >= played + sent).then_some(()));
    assert_eq!((daemon.counter("recording_lost"), daemon.faults()), (0, vec![]));
    shim.break_disk(true);
    feed(&daemon, &bus, &mut sent, 300);
    wait_for("the fault", || is_named(&daemon, "recording has stopped").then_some(()));
    wait_for("503", || (daemon.health_status() == 503).then_some(()));
    // The compressor does not pass on the error number of the file.
    assert!(is_named(&daemon, "os error 5") || is_named(&daemon, "I/O error"), "{:?}", daemon.faults());
    // The person is told that the command may be lost; it has effect all the same, and is stored once the disk works.
    let why = ask(&bus, &plane("FIC101/alarm?cmd=ack;by=ann")).unwrap_err();
    assert!(why.contains("carried out, but not stored"), "{why}");
    // The publisher sends it shortly after the command's reply.
    wait_for("the acknowledgement", || (alarm_state(&bus).as_deref() == Some("acked")).then_some(()));
    wait_for("the store's fault", || is_named(&daemon, "cannot be stored").then_some(()));
    shim.break_disk(false);
    wait_for("the faults' end", || {
        (!is_named(&daemon, "recording has stopped") && !is_named(&daemon, "cannot be stored")).then_some(())
    });
    wait_for("200", || (daemon.health_status() == 200).then_some(()));
    let recorded = daemon.counter("recorded");
    feed(&daemon, &bus, &mut sent, 300);
    wait_for("the samples after it", || (daemon.counter("recorded") >= recorded + 300).then_some(()));
    let lost = daemon.counter("recording_lost");
    assert!(lost >= 300, "{lost}");
    bus.close().wait().unwrap();
    daemon.kill();
    assert_eq!(state_after_restart(dir.path()), "acked");
    let kept: usize = files(&dir.path().join("rec")).iter().map(|f| raw_samples(f)).sum();
    assert!(kept as u64 + lost >= played + sent, "{kept} kept and {lost} lost of {played} and {sent}");
}

#[test]
fn an_end_beside_a_disk_that_hangs_or_breaks_fails_and_names_what_is_not_finished() {
    for hangs in [true, false] {
        let dir = tempfile::tempdir().unwrap();
        let Some(shim) = Shim::new(dir.path()) else {
            return skipped("an_end_beside_a_disk", "no C compiler (cc)");
        };
        let daemon = shim.start(dir.path(), "[recording]\nflush_s = 0.1\n");
        let (bus, mut sent) = (daemon.session(), 0);
        feed(&daemon, &bus, &mut sent, 100);
        wait_for("the samples on the disk", || (daemon.counter("recorded") >= 100).then_some(()));
        assert_eq!(daemon.health_status(), 200);
        if hangs {
            shim.hang_disk(true);
        } else {
            shim.break_disk(true);
        }
        feed(&daemon, &bus, &mut sent, 300);
        wait_for("503", || {
            // A hanging disk is noticed only by operations that wait for it.
            feed(&daemon, &bus, &mut sent, 1);
            (daemon.health_status() == 503).then_some(())
        });
        let fault = if hangs { "the recording disk has not answered" } else { "recording has stopped" };
        assert!(is_named(&daemon, fault), "{:?}", daemon.faults());
        bus.close().wait().unwrap();
        let rec = daemon.recordings.clone();
        let (code, log) = daemon.end();
        assert_eq!(code, Some(1), "{log}");
        let said = log.lines().last().unwrap();
        assert!(said.contains("recordings not finished") && said.contains("-s0-00000.mcap"), "{said}");
        assert_eq!(said.contains("the recorder thread did not end in time"), hangs, "{said}");
        let kept: usize = files(&rec).iter().map(|f| raw_samples(f)).sum();
        assert!(kept >= 100, "{kept}");
    }
}

#[test]
fn a_folder_that_becomes_a_file_or_a_circle_of_links_is_named_and_recording_goes_on_after_it() {
    let dir = tempfile::tempdir().unwrap();
    let daemon = Daemon::start(dir.path(), "[recording]\nflush_s = 0.1\n");
    let (bus, rec, mut sent) = (daemon.session(), daemon.recordings.clone(), 0);
    feed(&daemon, &bus, &mut sent, 20);
    wait_for("the recording", || (daemon.counter("recorded") >= 20).then_some(()));
    for circle in [false, true] {
        fs::remove_dir_all(&rec).unwrap();
        if circle {
            symlink(&rec, &rec).unwrap();
        } else {
            fs::write(&rec, b"").unwrap();
        }
        wait_for("the fault", || is_named(&daemon, "recording has stopped").then_some(()));
        feed(&daemon, &bus, &mut sent, 20);
        // Commands are answered all the same.
        let why = ask(&bus, &plane("A/alarm?cmd=suppress;by=ann"));
        assert!(why.as_ref().is_err_and(|w| w.contains("not stored")), "{why:?}");
        fs::remove_file(&rec).unwrap();
        wait_for("the faults' end", || {
            (!is_named(&daemon, "recording has stopped") && !is_named(&daemon, "cannot be stored")).then_some(())
        });
        ask(&bus, &plane("A/alarm?cmd=unsuppress;by=ann")).unwrap();
        feed(&daemon, &bus, &mut sent, 20);
    }
    bus.close().wait().unwrap();
    let lost = daemon.counter("recording_lost");
    let kept: usize = files(&daemon.stop()).iter().map(|f| raw_samples(f)).sum();
    assert!(kept as u64 + lost >= sent && kept >= 20, "{kept} kept and {lost} lost of {sent}");
}

#[test]
fn links_in_circles_pipes_and_folders_among_the_recordings_stop_nothing() {
    let dir = tempfile::tempdir().unwrap();
    alarmed(dir.path()).kill();
    let rec = dir.path().join("rec");
    symlink(rec.join("a.mcap"), rec.join("a.mcap")).unwrap();
    symlink(rec.join("nowhere"), rec.join("b.mcap.part")).unwrap();
    symlink(&rec, rec.join("c.mcap")).unwrap();
    fs::create_dir(rec.join("d.mcap")).unwrap();
    let pipe = rec.join("e.mcap");
    assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    assert_eq!(state_after_restart(dir.path()), "unack");
    fs::remove_file(rec.join("state.redb")).unwrap();
    assert_eq!(state_after_restart(dir.path()), "unack", "from the recordings");
    // A folder in place of the store can be neither read nor written: the daemon reports it and starts.
    fs::remove_file(rec.join("state.redb")).unwrap();
    fs::create_dir(rec.join("state.redb")).unwrap();
    let daemon = Daemon::start(dir.path(), FAST);
    let bus = daemon.session();
    assert_eq!(wait_for("an alarm", || alarm_state(&bus)), "unack");
    wait_for("the fault", || is_named(&daemon, "cannot be stored").then_some(()));
    fs::remove_dir(rec.join("state.redb")).unwrap();
    wait_for("the fault's end", || (!is_named(&daemon, "cannot be stored")).then_some(()));
    bus.close().wait().unwrap();
    daemon.stop();
}
