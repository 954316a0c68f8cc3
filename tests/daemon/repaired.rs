//! A valve repaired while the daemon runs: the maintenance list compares the windows before and after the date of the work.

use std::fs;
use std::net::TcpStream;
use std::path::Path;

use serde_json::{Value, json};

use crate::live::{Daemon, FAST, command_headers, http, ok, request, wait_for};

const SCENARIO: &str = include_str!("../../recordings/scenarios/sticking.toml");
/// The valve sticks until 08:33 and is repaired at 09:00. After 09:30 it moves freely.
const REPAIRED: &str = "2026-01-05T09:00:00Z";

/// A recording of the loop with these bands.
fn simulated(dir: &Path, name: &str, start: &str, bands: [f64; 2]) -> String {
    let [fs, fd] = bands;
    let text = SCENARIO
        .replace("2026-01-05T08:00:00Z", start)
        .replace("fs = 5.0, fd = 3.0", &format!("fs = {fs:?}, fd = {fd:?}"));
    let [scenario, out] = ["toml", "mcap"].map(|end| dir.join(format!("{name}.{end}")).to_str().unwrap().to_owned());
    fs::write(&scenario, text).unwrap();
    ok(&["simulate", &scenario, "--raw", "--out", &out]);
    out
}

fn review(daemon: &Daemon, label: &str, work_at: Option<&str>) -> (u16, String) {
    let body = json!({"label": label, "method": "inspection", "by": "ann", "work_at": work_at}).to_string();
    let stream = TcpStream::connect(&daemon.web).unwrap();
    request(stream, &["POST", "/api/v1/loops/FIC101/review"], &command_headers("localhost", &[]), &body)
}

/// Result of the loop's newest review in the maintenance list, once it has been compared.
fn outcome(daemon: &Daemon, label: &str) -> Value {
    wait_for("a comparison", || {
        let list: Value = serde_json::from_str(&http(&daemon.web, "/api/v1/maintenance")).unwrap();
        let reviewed = list["reviewed"][0].clone();
        (reviewed["label"] == label && !reviewed["outcome"].is_null()).then_some(reviewed)
    })
}

#[test]
fn a_repair_is_judged_from_the_date_of_the_work() {
    let dir = tempfile::tempdir().unwrap();
    let daemon = Daemon::start(dir.path(), FAST);
    daemon.play(&simulated(dir.path(), "before", "2026-01-05T08:00:00Z", [5.0, 3.0]));
    daemon.play(&simulated(dir.path(), "after", "2026-01-05T09:30:00Z", [0.0, 0.0]));
    daemon.wait_for_estimates(12);

    for (label, work_at) in
        [("repaired", None), ("stiction", Some(REPAIRED)), ("repaired", Some("2999-01-01T00:00:00Z"))]
    {
        let (status, body) = review(&daemon, label, work_at);
        assert!(status == 422 && body.contains("work_at"), "{label}, {work_at:?}: {status} {body}");
    }
    // There are no windows after the reviewed one yet.
    assert_eq!(review(&daemon, "stiction", None).0, 200);
    assert_eq!(outcome(&daemon, "stiction")["outcome"]["helped"], "unknown");

    let (status, body) = review(&daemon, "repaired", Some(REPAIRED));
    assert_eq!(status, 200, "{body}");
    let reviewed = outcome(&daemon, "repaired");
    let of = &reviewed["outcome"];
    assert_eq!((&of["helped"], &reviewed["work_at_ms"]), (&"yes".into(), &1_767_603_600_000.0.into()), "{reviewed:#}");
    assert!(of["words"].as_str().unwrap().starts_with("Stiction was seen before the repair"), "{of:#}");
    assert!(of["before"]["windows"].as_u64().unwrap() >= 3 && of["after"]["windows"].as_u64().unwrap() >= 3, "{of:#}");
    let pv_sd = |side: &str| of[side]["pv_sd"].as_f64().unwrap();
    assert!(pv_sd("after") < 0.5 * pv_sd("before"), "{of:#}");
    assert!(http(&daemon.web, "/api/v1/maintenance?format=csv").contains("2026-01-05T09:00:00Z"));
    daemon.stop();
}
