//! An operator edits the configuration of a running daemon.

use std::fs;
use std::path::Path;

use serde_json::Value;
use stiction_engine::codec::topic::Kind;
use zenoh::Wait;

use crate::live::{Daemon, PREFIX, ask, documents, files, http, ok, plane, wait_for};

const SETTINGS: &str = "[input]\ndiscover = false\n[window]\nhop_s = 60.0\n[plant]\ngroups = false\n";
const ADDED: &str = "[[loop]]\nname = \"FIC101\"\nop = \"gw/FIC101.OP\"\npv = \"gw/FIC101.PV\"\n";
/// A loop that is watched throughout.
const OTHER: &str = "[[loop]]\nname = \"TIC7\"\n";

/// Sends this many seconds of two loops: one under the prefix, one under keys of a gateway. Returns the next second.
fn send(bus: &zenoh::Session, from_s: i64, seconds: i64) -> i64 {
    for second in from_s..from_s + seconds {
        let t_ns = (1_700_000_000 + second) * 1_000_000_000;
        for (key, value) in [
            (format!("{PREFIX}/TIC7/op"), 50 + second % 7),
            (format!("{PREFIX}/TIC7/pv"), second % 11),
            ("gw/FIC101.OP".to_owned(), 40 + second % 5),
            ("gw/FIC101.PV".to_owned(), second % 13),
        ] {
            bus.put(key, format!(r#"{{"t": {t_ns}, "v": {value}}}"#)).wait().unwrap();
        }
    }
    from_s + seconds
}

fn names(daemon: &Daemon) -> Vec<String> {
    let loops: Value = serde_json::from_str(&http(&daemon.web, "/api/v1/loops")).unwrap();
    let mut names: Vec<String> =
        loops["loops"].as_array().unwrap().iter().map(|row| row["name"].as_str().unwrap().to_owned()).collect();
    names.sort();
    names
}

/// Writes the configuration with these entries, and sends SIGHUP.
fn edit(daemon: &Daemon, dir: &Path, text: &str, extra: &str) {
    fs::write(dir.join("config.toml"), format!("{text}{extra}")).unwrap();
    daemon.signal("HUP");
}

fn replays(recordings: &Path) -> Vec<usize> {
    let said = ok(&["replay", recordings.to_str().unwrap(), "--verify"]);
    assert!(said.contains("all equal to the byte"), "{said}");
    files(recordings).iter().map(|file| documents(file, Kind::Estimate).len()).collect()
}

#[test]
fn an_operator_adds_a_loop_to_a_running_daemon_sees_its_first_window_and_removes_it() {
    let dir = tempfile::tempdir().unwrap();
    let daemon = Daemon::start(dir.path(), &format!("{SETTINGS}[recording]\nflush_s = 0.1\n{OTHER}"));
    let text = fs::read_to_string(dir.path().join("config.toml")).unwrap();
    let bus = daemon.session();
    let mut second = 0;
    wait_for("a window", || {
        second = send(&bus, second, 90);
        ask(&bus, &plane("TIC7/estimate")).ok()
    });
    assert_eq!(names(&daemon), ["TIC7"]);

    let before = daemon.health()["config_hash"].clone();
    edit(&daemon, dir.path(), &text, ADDED);
    daemon.wait_for_log("added: FIC101");
    let first = wait_for("its first window", || {
        second = send(&bus, second, 90);
        ask(&bus, &plane("FIC101/estimate")).ok()
    });
    assert_eq!(first["loop"], "FIC101");
    assert_eq!(names(&daemon), ["FIC101", "TIC7"]);

    // A file with a fault, and one that needs a restart: neither changes anything, and both are reported. The health is updated
    // every few seconds, so the current document may still be from the old file.
    let hash = wait_for("the new file's health", || {
        Some(daemon.health()["config_hash"].clone()).filter(|hash| *hash != before)
    });
    for (extra, named) in
        [("[[loop]]\nname = \"A\"\nhop_z = 1\n", "hop_z"), ("[shard]\nindex = 0\ncount = 2\n", "shard.count")]
    {
        edit(&daemon, dir.path(), &text, extra);
        let fault = wait_for(named, || daemon.faults().into_iter().find(|f| f.contains(named)));
        assert!(fault.contains("the old one holds") && fault.contains("config.toml"), "{fault}");
    }
    assert_eq!(daemon.health()["config_hash"], hash);
    second = send(&bus, second, 90);
    assert_eq!(names(&daemon), ["FIC101", "TIC7"]);

    edit(&daemon, dir.path(), &text, "");
    daemon.wait_for_log("removed: FIC101");
    wait_for("no fault", || daemon.faults().is_empty().then_some(()));
    wait_for("its end", || (names(&daemon) == ["TIC7"]).then_some(()));
    assert!(ask(&bus, &plane("FIC101/estimate")).is_err());
    let before = daemon.counter("estimates");
    wait_for("another window", || {
        second = send(&bus, second, 90);
        (daemon.counter("estimates") > before).then_some(())
    });
    assert_eq!(names(&daemon), ["TIC7"]);
    bus.close().wait().unwrap();
    let counts = replays(&daemon.stop());
    assert_eq!(counts.len(), 3, "a recording for each edit: {counts:?}");
    assert!(counts.iter().all(|count| *count > 0), "{counts:?}");
}
