//! Several daemons that divide a plant's loops by `[shard]`.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use crate::live::{Daemon, FAST, PREFIX, ask, files, free_port, ok, plane, wait_for};
use serde_json::Value;
use stiction_engine::shard::Shard;
use zenoh::Wait;

/// A daemon for a part of the loops, on a separate bus that may be connected to another daemon's.
fn shard(dir: &Path, index: u32, id: &str, connect: Option<&str>) -> Daemon {
    std::fs::create_dir_all(dir).unwrap();
    let extra = format!("[daemon]\nid = {id:?}\n[shard]\nindex = {index}\ncount = 2\n{FAST}");
    let daemon = Daemon::start_on(dir, &extra, connect);
    wait_for("a health document", || (daemon.health()["daemon"] == id).then_some(()));
    daemon
}

fn send(bus: &zenoh::Session, name: &str, second: i64) {
    for (signal, value) in [("op", 50.0), ("pv", (second % 7) as f64)] {
        let json = format!(r#"{{"t": {}, "v": {value}}}"#, second * 1_000_000_000);
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
    // Both must be on the bus before the samples, which are sent again until each loop is watched.
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
        // No alarm is active, so the command is refused: by the loop's daemon and by no other.
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

/// Time of arrival of an estimate, its loop, and start and end of its window, ns.
type Heard = (Instant, String, [i64; 2]);

/// Publishes loops at 10 Hz from a session that daemons connect to, and receives their estimates, until dropped.
struct Plant {
    bus: zenoh::Session,
    endpoint: String,
    heard: Arc<Mutex<Vec<Heard>>>,
    stop: Arc<AtomicBool>,
    sending: Option<std::thread::JoinHandle<()>>,
}

impl Plant {
    fn start(names: &[String]) -> Self {
        let endpoint = format!("tcp/127.0.0.1:{}", free_port());
        let mut config = zenoh::Config::default();
        config.insert_json5("listen/endpoints", &format!("[{endpoint:?}]")).unwrap();
        config.insert_json5("scouting/multicast/enabled", "false").unwrap();
        let bus = zenoh::open(config).wait().unwrap();
        let (heard, stop) = (Arc::new(Mutex::new(Vec::new())), Arc::new(AtomicBool::new(false)));
        let note = heard.clone();
        let hear = move |sample: zenoh::sample::Sample| {
            let document: Value = serde_json::from_slice(&sample.payload().to_bytes()).unwrap();
            let window = ["start_ns", "end_ns"].map(|end| document["window"][end].as_i64().unwrap());
            note.lock().unwrap().push((Instant::now(), document["loop"].as_str().unwrap().to_owned(), window));
        };
        bus.declare_subscriber(plane("**/estimate")).callback(hear).background().wait().unwrap();
        let (of, names, stopped) = (bus.clone(), names.to_vec(), stop.clone());
        let sending = std::thread::spawn(move || {
            while !stopped.load(Ordering::Relaxed) {
                let t_ns = now_ns();
                for name in &names {
                    for (signal, v) in [("op", 50.0), ("pv", (t_ns / 100_000_000 % 7) as f64)] {
                        let json = format!(r#"{{"t": {t_ns}, "v": {v}}}"#);
                        of.put(format!("{PREFIX}/{name}/{signal}"), json).wait().unwrap();
                    }
                }
                std::thread::sleep(Duration::from_millis(100));
            }
        });
        Self { bus, endpoint, heard, stop, sending: Some(sending) }
    }

    /// Waits until this many loops have had an estimate of a window that ends after a given time; returns when the last one
    /// came, and the latest start of these windows, ns.
    fn estimated(&self, loops: usize, since_ns: i64) -> (Instant, i64) {
        wait_for("estimates of all loops", || {
            let heard = self.heard.lock().unwrap();
            let mut first = std::collections::BTreeMap::new();
            heard.iter().filter(|(_, _, [_, end_ns])| *end_ns > since_ns).for_each(|(at, name, [start_ns, _])| {
                first.entry(name.clone()).or_insert((*at, *start_ns));
            });
            let last = (first.values().map(|(at, _)| *at).max(), first.values().map(|(_, start_ns)| *start_ns).max());
            (first.len() == loops).then(|| (last.0.unwrap(), last.1.unwrap()))
        })
    }
}

fn now_ns() -> i64 {
    i64::try_from(SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_nanos()).unwrap()
}

impl Drop for Plant {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        self.sending.take().map(std::thread::JoinHandle::join);
    }
}

#[test]
fn a_shard_that_is_killed_and_restarted_keeps_its_alarms_and_goes_on_with_its_windows() {
    let dir = tempfile::tempdir().unwrap();
    let part = Shard::new(1, 2).unwrap();
    let names: Vec<String> = (0..40).map(|k| format!("FIC{k}")).filter(|name| part.owns(name)).collect();
    let plant = Plant::start(&names);
    let extra = "[daemon]\nid = \"plant-1\"\n[shard]\nindex = 1\ncount = 2\n[window]\nhop_s = 1.0\nlateness_s = 0.2\n\
                 max_gap_s = 60.0\n\
                 [recording]\nflush_s = 0.1\n";
    let start = || Daemon::start_on(dir.path(), extra, Some(&plant.endpoint));
    let daemon = start();
    // Five seconds of windows.
    let began_ns = now_ns();
    plant.estimated(names.len(), began_ns + 5_000_000_000);
    let command = |cmd: &str| ask(&plant.bus, &plane(&format!("{}/alarm?cmd={cmd};by=ann", names[0]))).unwrap();
    assert_eq!(command("out_of_service")["state"], "out_of_service");
    let killed = Instant::now();
    daemon.kill();
    let killed_ns = now_ns();
    let daemon = start();
    let (at, start_ns) = plant.estimated(names.len(), killed_ns);
    let (loops, took, before_s) = (names.len(), at - killed, (killed_ns - start_ns) as f64 / 1e9);
    println!(
        "killed and restarted: the first estimate of each of {loops} loops came within {took:.1?}; its window began {before_s:.1} s before the kill at least"
    );
    assert!(before_s > 2.0, "windows begin anew");
    let alarm = wait_for("the alarm", || ask(&plant.bus, &plane(&format!("{}/alarm", names[0]))).ok());
    assert_eq!((&alarm["state"], &alarm["daemon"]), (&"out_of_service".into(), &"plant-1".into()));
    assert_eq!(command("in_service")["state"], "normal");
    plant.estimated(names.len(), now_ns());
    for file in files(&daemon.stop()).iter().filter(|f| f.extension().is_some_and(|e| e == "mcap")) {
        ok(&["replay", file.to_str().unwrap(), "--verify"]);
    }
}
