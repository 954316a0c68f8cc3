//! Groups in a running daemon: published, recorded, replayed byte for byte, and withdrawn when the oscillation ends.

use std::collections::BTreeSet;
use std::path::Path;

use serde_json::Value;
use stiction_engine::codec::topic::Kind;

use super::cli_plant::written;
use super::live::{Daemon, ask, documents, files, ok, plane, wait_for};
use stiction_lab::plants::Role;

/// Windows that end often enough for several comparisons.
const SETTINGS: &str = "[window]\nhop_s = 600.0\nmax_points = 400\n[recording]\nflush_s = 0.1\n";

#[test]
fn groups_are_published_recorded_and_replayed_to_the_byte() {
    let dir = tempfile::tempdir().unwrap();
    let plant = dir.path().join("plant");
    std::fs::create_dir(&plant).unwrap();
    let case = written(&plant);
    let daemon = Daemon::start(dir.path(), SETTINGS);
    daemon.play_to_disk(plant.to_str().unwrap());
    let source = case.iter().find(|l| l.role == Role::Source).unwrap();
    let followers = case.iter().filter(|l| l.group == source.group && l.name != source.name);
    let expected: BTreeSet<&str> = followers.map(|l| l.name.as_str()).chain([source.name.as_str()]).collect();
    let bus = daemon.session();
    let group = wait_for("the group on the bus", || {
        let group = ask(&bus, &plane("@plant/**")).ok()?;
        let members = group["members"].as_array()?.iter().filter_map(Value::as_str).collect::<BTreeSet<&str>>();
        (members.is_subset(&expected) && members.contains(source.name.as_str())).then_some(group)
    });
    assert_eq!(group["schema"], "stictiond.group.v1");
    assert!(group["daemon"].is_string(), "{group}");
    let groups_in =
        |dir: &Path| files(dir).iter().flat_map(|f| documents(f, Kind::Group)).collect::<Vec<(String, Value)>>();
    wait_for("three recorded groups", || (groups_in(&daemon.recordings).len() >= 3).then_some(()));
    assert!(daemon.counter("comparisons") >= 3);
    let recordings = daemon.stop();
    let recorded = groups_in(&recordings);
    let estimates: Vec<(String, Value)> =
        files(&recordings).iter().flat_map(|f| documents(f, Kind::Estimate)).collect();
    let with_cause = estimates.iter().filter(|(_, d)| d["group"]["cause"].is_string()).count();
    assert!(with_cause > 0, "no estimate of {} names what drives its loop", estimates.len());
    let verified = ok(&["replay", recordings.to_str().unwrap(), "--verify", "--format", "json"]);
    let verified: Value = serde_json::from_str(&verified).unwrap();
    assert_eq!((&verified["equal"], &verified["unchecked"]), (&true.into(), &0.into()), "{verified}");
    assert!(verified["compared"].as_u64().unwrap() as usize >= recorded.len() + estimates.len(), "{verified}");
}
