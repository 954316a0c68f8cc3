//! Several daemons that share a plant's loops by `[shard]`.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

#[path = "common/live.rs"]
mod live;

use std::path::Path;

use live::{Daemon, FAST, PREFIX, plane, wait_for};
use serde_json::Value;
use stiction_monitor::shard::Shard;
use zenoh::Wait;

/// A part of the loops, on a bus of its own that may be connected to another daemon's.
fn shard(dir: &Path, index: u32, id: &str, connect: Option<&str>) -> Daemon {
    std::fs::create_dir_all(dir).unwrap();
    let extra = format!("[daemon]\nid = {id:?}\n[shard]\nindex = {index}\ncount = 2\n{FAST}");
    let daemon = Daemon::start_on(dir, &extra, connect);
    wait_for("a health document", || (daemon.health()["daemon"] == id).then_some(()));
    daemon
}

fn send(bus: &zenoh::Session, name: &str, second: i64) {
    for (signal, value) in [("op", 50.0), ("pv", (second % 7) as f64)] {
        let json = format!(r#"{{"t": {second}, "v": {value}}}"#);
        let key = format!("{PREFIX}/{name}/{signal}");
        bus.put(key, json).encoding(zenoh::bytes::Encoding::APPLICATION_JSON).wait().unwrap();
    }
}

#[test]
fn each_shard_watches_its_own_loops_answers_for_them_and_notices_a_second_one_of_its_kind() {
    let dir = tempfile::tempdir().unwrap();
    let first = shard(&dir.path().join("0"), 0, "plant-0", None);
    let second = shard(&dir.path().join("1"), 1, "plant-1", Some(&first.endpoint));
    let names: Vec<String> = (0..20).map(|k| format!("FIC{k}")).collect();
    let bus = first.session();
    // Both must be on the bus before the samples: sent again until each loop is watched by somebody.
    let watched = |daemon: &Daemon| daemon.health()["loops"].as_u64().unwrap();
    let mut second_s = 0;
    wait_for("all loops", || {
        second_s += 1;
        names.iter().for_each(|name| send(&bus, name, second_s));
        (watched(&first) + watched(&second) == 20).then_some(())
    });
    let of_first = names.iter().filter(|name| Shard::new(0, 2).unwrap().owns(name)).count() as u64;
    assert_eq!((watched(&first), watched(&second)), (of_first, 20 - of_first));
    assert!(first.faults().is_empty() && second.faults().is_empty(), "{:?} {:?}", first.faults(), second.faults());
    for name in &names {
        // No alarm is active, so the command is refused: by the daemon of the loop, and by no other.
        let replies = bus.get(plane(&format!("{name}/alarm?cmd=out_of_service;by=ann"))).wait().unwrap();
        let daemons: Vec<Value> = replies
            .iter()
            .filter_map(|reply| serde_json::from_slice(&reply.into_result().ok()?.payload().to_bytes()).ok())
            .map(|document: Value| document["daemon"].clone())
            .collect();
        let owner = if Shard::new(0, 2).unwrap().owns(name) { "plant-0" } else { "plant-1" };
        assert_eq!(daemons, [owner], "{name}");
    }
    let twin = shard(&dir.path().join("2"), 0, "plant-0", Some(&first.endpoint));
    let told = |daemon: &Daemon, part: &str| daemon.faults().iter().any(|f| f.contains(part)).then_some(());
    wait_for("the duplicate id", || told(&first, "has the id plant-0").and(told(&twin, "has the id plant-0")));
    wait_for("the duplicate documents", || {
        second_s += 100;
        names.iter().for_each(|name| send(&bus, name, second_s));
        told(&first, "come from elsewhere")
    });
    assert!(second.faults().is_empty(), "{:?}", second.faults());
    bus.close().wait().unwrap();
}
