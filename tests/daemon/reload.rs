//! An operator edits the configuration of a running daemon.

use std::fs;
use std::path::Path;

use serde_json::Value;
use stiction_monitor::codec::topic::Kind;
use zenoh::Wait;

use crate::live::{
    Daemon, PREFIX, ask, command_headers, documents, files, http, ok, plane, request, stictiond, wait_for,
};

const SETTINGS: &str = "[input]\ndiscover = false\n[window]\nhop_s = 60.0\n[plant]\ngroups = false\n";
const ADDED: &str = "[[loop]]\nname = \"FIC101\"\nop = \"gw/FIC101.OP\"\npv = \"gw/FIC101.PV\"\n";
/// A loop that is watched all the while.
const OTHER: &str = "[[loop]]\nname = \"TIC7\"\n";

/// Sends so many seconds of two loops: one under the prefix, one under keys of a gateway. Gives the next second.
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

    // A file with a fault, and one that needs a restart: neither changes anything, and both are named.
    // The health is made every few seconds: the one at hand may still be that of the old file.
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

/// The output of a command, and its exit code.
fn said(args: &[&str]) -> (Option<i32>, String) {
    let out = stictiond(args);
    (out.status.code(), String::from_utf8([out.stdout, out.stderr].concat()).unwrap())
}

#[test]
fn reload_and_check_say_what_changes_and_why_a_file_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let token_file = dir.path().join("token");
    fs::write(&token_file, "0123456789abcdef0123456789abcdef\n").unwrap();
    let daemon = Daemon::start(dir.path(), &format!("token_file = {token_file:?}\n{SETTINGS}{OTHER}"));
    let path = dir.path().join("config.toml");
    let (config, url) = (path.to_str().unwrap(), format!("http://{}", daemon.web));
    let text = fs::read_to_string(&path).unwrap();
    let write = |extra: &str| fs::write(&path, format!("{text}{extra}")).unwrap();
    let (reload, check) = (["reload", config, "--url", &url], ["check", config, &format!("--running={url}")]);
    assert_eq!(said(&check).0, Some(0));
    assert!(said(&check).1.contains("no changes"));
    let recordings = files(&daemon.recordings).len();
    assert_eq!(said(&reload), (Some(0), format!("{url}: in force\nno changes\n")));
    assert_eq!(files(&daemon.recordings).len(), recordings, "nothing changed");

    write(ADDED);
    let (code, out) = said(&check);
    assert!(code == Some(0) && out.contains("added: FIC101"), "{out}");
    assert_eq!(said(&reload), (Some(0), format!("{url}: in force\nadded: FIC101\n")));
    assert!(said(&check).1.contains("no changes"));
    wait_for("new recordings", || (files(&daemon.recordings).len() > recordings).then_some(()));

    // What needs a restart is named by both, and nothing of the file is used.
    write("[shard]\nindex = 0\ncount = 2\n");
    let (code, out) = said(&check);
    assert!(code == Some(0) && out.contains("removed: FIC101\nneed a restart: shard.count"), "{out}");
    let (code, out) = said(&reload);
    assert!(code == Some(1) && out.contains("shard.count") && out.contains("restart the daemon"), "{out}");
    wait_for("the fault", || daemon.faults().iter().any(|fault| fault.contains("shard.count")).then_some(()));
    write(ADDED);
    assert_eq!(said(&reload).0, Some(0));
    wait_for("no fault", || daemon.faults().is_empty().then_some(()));

    // Another file than the daemon's, another site's, and no daemon.
    let other = dir.path().join("other.toml");
    let with = |text: &str| {
        fs::write(&other, text).unwrap();
        said(&["reload", other.to_str().unwrap(), "--url", &url])
    };
    let (code, out) = with(&text);
    assert!(code == Some(1) && out.contains("reads another file") && out.contains("removed: FIC101"), "{out}");
    let (code, out) = with(&text.replace(PREFIX, "plant2"));
    assert!(code == Some(1) && out.contains("the daemon of") && out.contains("--url"), "{out}");
    let (code, out) = said(&["reload", config, "--url", "http://127.0.0.1:9"]);
    assert!(code == Some(1) && out.contains("no daemon answers"), "{out}");

    // The rules of all commands: the header of its own, and the token.
    let post = |headers: &[(&str, &str)]| {
        let stream = std::net::TcpStream::connect(&daemon.web).unwrap();
        request(stream, &["POST", "/api/v1/configuration/reload"], headers, "").0
    };
    assert_eq!(post(&[("Host", &daemon.web)]), 403);
    assert_eq!(post(&command_headers(&daemon.web, &[])), 401);
}
