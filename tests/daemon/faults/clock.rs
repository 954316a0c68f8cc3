//! A wall clock that is years off, at a start or while the daemon runs.

use std::fs;

use zenoh::Wait;

use super::shim::{Shim, YEAR_S};
use crate::live::{FAST, alarm_state, alarmed, files, ok, raw_samples, skipped, state_after_restart, wait_for};

#[test]
fn one_start_with_the_clock_ahead_is_not_the_newest_for_ever() {
    let dir = tempfile::tempdir().unwrap();
    let Some(shim) = Shim::new(dir.path()) else {
        return skipped("one_start_with_the_clock_ahead", "no C compiler (cc)");
    };
    shim.set_clock(10 * YEAR_S);
    let ahead = shim.start(dir.path(), FAST);
    let bus = ahead.session();
    for k in 0..5_i64 {
        let t_ns = 1_700_000_000_000_000_000 + k * 1_000_000_000;
        bus.put("plant1/area1/FIC101/op", format!("{{\"t\":{t_ns},\"v\":1}}")).wait().unwrap();
    }
    wait_for("the samples", || (ahead.counter("samples") == 5).then_some(()));
    bus.close().wait().unwrap();
    ahead.stop();
    let first = files(&dir.path().join("rec")).pop().unwrap();
    assert!(first.file_name().unwrap().to_str().unwrap().contains("-203"), "{first:?} was made under that clock");
    // The clock is correct again, and an alarm is raised.
    alarmed(dir.path()).stop();
    assert_eq!(state_after_restart(dir.path()), "unack");
    fs::remove_file(dir.path().join("rec/state.redb")).unwrap();
    assert_eq!(state_after_restart(dir.path()), "unack", "without the store");
}

#[test]
fn a_clock_that_jumps_years_either_way_costs_no_sample_no_recording_and_no_alarm() {
    let dir = tempfile::tempdir().unwrap();
    let Some(shim) = Shim::new(dir.path()) else { return skipped("a_clock_that_jumps", "no C compiler (cc)") };
    let old = files(&alarmed(dir.path()).stop()).pop().unwrap();
    let samples = raw_samples(&old);
    let daemon = shim.start(dir.path(), FAST);
    let bus = daemon.session();
    assert_eq!(wait_for("an alarm", || alarm_state(&bus)), "unack");
    let mut sent = 0_i64;
    for ahead_s in [10 * YEAR_S, -10 * YEAR_S, 0, 10 * YEAR_S] {
        shim.set_clock(ahead_s);
        for _ in 0..50 {
            for name in ["A", "B"] {
                let t_ns = 1_700_000_000_000_000_000 + sent * 1_000_000_000;
                bus.put(format!("plant1/area1/{name}/op"), format!("{{\"t\":{t_ns},\"v\":1}}")).wait().unwrap();
            }
            sent += 1;
        }
        wait_for("the samples", || (daemon.counter("samples") == 2 * sent.unsigned_abs()).then_some(()));
    }
    // Ten years later, every recording is older than the retention allows.
    wait_for("the doubt", || daemon.faults().iter().any(|f| f.contains("the clock is far ahead")).then_some(()));
    for name in
        ["stamps_ahead", "over_rate", "dropped_input", "recording_lost", "recordings_thinned", "recordings_removed"]
    {
        assert_eq!(daemon.counter(name), 0, "{name}");
    }
    shim.set_clock(0);
    daemon.play(dir.path().join("sticking.mcap").to_str().unwrap());
    bus.close().wait().unwrap();
    daemon.stop();
    assert_eq!(raw_samples(&old), samples);
    assert_eq!(state_after_restart(dir.path()), "unack");
    for file in files(&dir.path().join("rec")) {
        ok(&["info", file.to_str().unwrap(), "--verify"]);
        ok(&["replay", file.to_str().unwrap(), "--verify"]);
    }
}
