//! A plant, a router and daemons, each daemon in a network namespace of its own, with a cable that can be cut.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::fs;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant, SystemTime};

use serde_json::Value;
use zenoh::Wait;

use crate::live::{self, PREFIX, ok, plane, wait_for};

/// Loops of the plant.
pub const LOOPS: usize = 24;
/// Pause between two scans.
const SCAN: Duration = Duration::from_millis(100);
/// Windows end at whole multiples of this.
pub const HOP_NS: i64 = 1_000_000_000;
/// Samples that each history remembers of a key.
const REMEMBERED: usize = 1000;

pub fn name_of(k: usize) -> String {
    format!("L{k}")
}

fn ip(arguments: &str) -> bool {
    Command::new("ip")
        .args(arguments.split(' '))
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status()
        .is_ok_and(|s| s.success())
}

/// An estimate as it came over the bus.
pub struct Heard {
    pub at: Instant,
    pub daemon: String,
    pub document: Value,
}

/// Estimates by loop and window.
pub type Union = BTreeMap<(String, i64), Vec<Heard>>;

pub struct Member {
    child: Child,
    pub folder: tempfile::TempDir,
}

/// Everything; taken down when dropped.
pub struct Site {
    number: usize,
    router: zenoh::Session,
    pub bus: zenoh::Session,
    stop: Arc<AtomicBool>,
    plant: Option<std::thread::JoinHandle<()>>,
    pub union: Arc<Mutex<Union>>,
    pub members: BTreeMap<String, Member>,
    /// Folders of daemons that were killed.
    pub left: Vec<tempfile::TempDir>,
}

fn session(mode: &str, place: &str, endpoint: &str) -> zenoh::Session {
    let mut config = zenoh::Config::default();
    for (key, value) in [
        ("mode", format!("{mode:?}")),
        (place, format!("[{endpoint:?}]")),
        ("scouting/multicast/enabled", "false".to_owned()),
        ("transport/link/tx/lease", "2000".to_owned()),
    ] {
        config.insert_json5(key, &value).unwrap();
    }
    zenoh::open(config).wait().unwrap()
}

type History = Arc<Mutex<BTreeMap<String, VecDeque<String>>>>;

/// Answers for the past of every second loop as a storage with history does, of the others as a publisher's cache.
fn remember(bus: &zenoh::Session, history: &History) {
    for (key, odd) in [(format!("{PREFIX}/**"), false), (format!("{PREFIX}/*/*/@adv/pub/1/1/_"), true)] {
        let history = history.clone();
        let answer = move |query: zenoh::query::Query| {
            assert!(query.parameters().get("_time").is_some(), "{query:?}");
            let asked = query.key_expr().as_str().to_owned();
            let wanted = asked.strip_prefix(PREFIX).unwrap().split('/').nth(1).unwrap().to_owned();
            let history = history.lock().unwrap();
            for (key, sent) in history.iter().filter(|(key, _)| key.split('/').rev().nth(1) == Some(&wanted)) {
                if (wanted[1..].parse::<usize>().unwrap() % 2 == 1) == odd {
                    sent.iter().for_each(|payload| query.reply(key, payload.as_str()).wait().unwrap());
                }
            }
        };
        bus.declare_queryable(key).callback(answer).background().wait().unwrap();
    }
}

/// The plant: OP stands still, so that no window costs a fit, and PV goes its way.
fn scan(bus: &zenoh::Session, history: &History, stop: &AtomicBool) {
    let step_ns = SCAN.as_nanos() as i64;
    let now_ns = || SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap().as_nanos() as i64;
    let mut t_ns = now_ns() / step_ns * step_ns;
    while !stop.load(Ordering::Relaxed) {
        t_ns += step_ns;
        std::thread::sleep(Duration::from_nanos((t_ns - now_ns()).max(0) as u64));
        for k in 0..LOOPS {
            for (signal, v) in [("op", 50.0), ("pv", ((t_ns / step_ns) % 17) as f64 + k as f64)] {
                let (key, payload) =
                    (format!("{PREFIX}/{}/{signal}", name_of(k)), format!("{{\"t\":{t_ns},\"v\":{v}}}"));
                let mut history = history.lock().unwrap();
                let sent = history.entry(key.clone()).or_default();
                sent.push_back(payload.clone());
                if sent.len() > REMEMBERED {
                    sent.pop_front();
                }
                drop(history);
                bus.put(key, payload).wait().unwrap();
            }
        }
    }
}

impl Site {
    /// Whether this machine permits namespaces; says so where not.
    pub fn permitted(test: &str) -> bool {
        let name = format!("stp{}", std::process::id());
        let permitted = ip(&format!("netns add {name}")) && ip(&format!("netns del {name}"));
        if !permitted {
            live::skipped(test, "no network namespaces: needs root and `ip`");
        }
        permitted
    }

    /// `number` tells the networks of tests apart.
    pub fn start(number: usize) -> Self {
        let bridge = format!("stb{number}");
        ip(&format!("link del {bridge}"));
        assert!(ip(&format!("link add {bridge} type bridge")));
        assert!(ip(&format!("addr add 10.77.{number}.1/24 dev {bridge}")) && ip(&format!("link set {bridge} up")));
        let endpoint = format!("tcp/10.77.{number}.1:7447");
        let router = session("router", "listen/endpoints", &endpoint);
        let bus = session("client", "connect/endpoints", &endpoint);
        let history = History::default();
        remember(&bus, &history);
        let union = Arc::new(Mutex::new(Union::new()));
        let heard = union.clone();
        let hear = move |sample: zenoh::sample::Sample| {
            let document: Value = serde_json::from_slice(&sample.payload().to_bytes()).unwrap();
            let key = (document["loop"].as_str().unwrap().to_owned(), document["window"]["end_ns"].as_i64().unwrap());
            let daemon = document["daemon"].as_str().unwrap().to_owned();
            heard.lock().unwrap().entry(key).or_default().push(Heard { at: Instant::now(), daemon, document });
        };
        bus.declare_subscriber(plane("*/estimate")).callback(hear).background().wait().unwrap();
        let stop = Arc::new(AtomicBool::new(false));
        let (plant_bus, stopping) = (bus.clone(), stop.clone());
        let plant = std::thread::spawn(move || scan(&plant_bus, &history, &stopping));
        Self { number, router, bus, stop, plant: Some(plant), union, members: BTreeMap::new(), left: Vec::new() }
    }

    fn wire(&self, id: &str) -> (String, String) {
        (format!("st{}{id}", self.number), format!("stv{}{id}", self.number))
    }

    /// Starts a daemon; its folder is a new one unless one is given.
    pub fn add(&mut self, id: &str, folder: Option<tempfile::TempDir>) {
        let (space, cable) = self.wire(id);
        let n = self.number;
        let address = u32::from(id.as_bytes()[0]);
        if !ip(&format!("-n {space} link show e0")) {
            ip(&format!("netns del {space}"));
            assert!(ip(&format!("netns add {space}")));
            assert!(ip(&format!("link add {cable} type veth peer name e0 netns {space}")));
            assert!(ip(&format!("link set {cable} master stb{n}")) && ip(&format!("link set {cable} up")));
            assert!(ip(&format!("-n {space} addr add 10.77.{n}.{address}/24 dev e0")));
            assert!(ip(&format!("-n {space} link set e0 up")) && ip(&format!("-n {space} link set lo up")));
        }
        let folder = folder.unwrap_or_else(|| tempfile::tempdir().unwrap());
        let text = format!(
            "[site]\nprefix = \"{PREFIX}\"\n[zenoh]\nmode = \"client\"\nconnect = [\"tcp/10.77.{n}.1:7447\"]\n\
             [window]\nhop_s = 1.0\nmax_window_s = 30.0\nlateness_s = 0.2\nmax_gap_s = 60.0\n[web]\nenabled = false\n[daemon]\nid = \"{id}\"\n\
             [cluster]\nname = \"c\"\nrefill_s = 60.0\n[recording]\nflush_s = 0.1\ndir = {:?}\n",
            self.recordings_in(folder.path())
        );
        let path = folder.path().join("c.toml");
        fs::write(&path, text).unwrap();
        let log = fs::OpenOptions::new().create(true).append(true).open(folder.path().join("log")).unwrap();
        let child = Command::new("ip")
            .args(["netns", "exec", &space, &live::program(), "run", "--workers", "1", "--config"])
            .arg(&path)
            .stderr(log)
            .spawn()
            .unwrap();
        self.members.insert(id.to_owned(), Member { child, folder });
    }

    fn recordings_in(&self, folder: &std::path::Path) -> PathBuf {
        folder.join("rec")
    }

    pub fn signal(&self, id: &str, name: &str) {
        let pid = self.members[id].child.id().to_string();
        assert!(Command::new("kill").args([&format!("-{name}"), &pid]).status().unwrap().success());
    }

    pub fn cable(&self, id: &str, state: &str) {
        let (_, cable) = self.wire(id);
        assert!(ip(&format!("link set {cable} {state}")));
    }

    /// Takes a daemon out, whose process has been told to end or has been killed; gives its folder.
    pub fn remove(&mut self, id: &str) -> tempfile::TempDir {
        let mut member = self.members.remove(id).unwrap();
        member.child.wait().unwrap();
        member.folder
    }

    /// Who made the newest window of each loop that came after a moment.
    pub fn owners_since(&self, since: Instant) -> BTreeMap<String, BTreeSet<String>> {
        let mut owners: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
        for ((name, _), heard) in self.union.lock().unwrap().iter() {
            for one in heard.iter().filter(|one| one.at >= since) {
                owners.entry(name.clone()).or_default().insert(one.daemon.clone());
            }
        }
        owners
    }

    /// Waits until each loop is watched by the one of these daemons that owns it.
    #[track_caller]
    pub fn wait_until_shared(&self, ids: &[&str]) {
        let live: stiction_monitor::ownership::Live = ids.iter().copied().collect();
        wait_for("every loop at its owner's", || {
            let since = Instant::now();
            std::thread::sleep(Duration::from_millis(2500));
            let owners = self.owners_since(since);
            let right = |k: &usize| {
                let name = name_of(*k);
                owners.get(&name).is_some_and(|of| of.len() == 1 && of.contains(live.owner(&name).unwrap()))
            };
            ((0..LOOPS).filter(right).count() == LOOPS).then_some(())
        });
    }

    /// How long after a moment the last of a daemon's loops had its first window from another, s.
    #[track_caller]
    pub fn taken_over(&self, of: &str, live: &[&str], since: Instant) -> f64 {
        let before: stiction_monitor::ownership::Live = live.iter().copied().collect();
        let lost: Vec<String> = (0..LOOPS).map(name_of).filter(|name| before.is_owner(of, name)).collect();
        assert!(!lost.is_empty());
        let last = wait_for("every lost loop elsewhere", || {
            let union = self.union.lock().unwrap();
            let first = |name: &String| {
                let of_loop =
                    union.range((name.clone(), i64::MIN)..=(name.clone(), i64::MAX)).flat_map(|(_, heard)| heard);
                of_loop.filter(|one| one.at > since && one.daemon != of).map(|one| one.at).min()
            };
            lost.iter().map(first).collect::<Option<Vec<Instant>>>()?.into_iter().max()
        });
        (last - since).as_secs_f64()
    }

    /// From the first window that each loop has to its last one none is missing, and of a window that two daemons made
    /// both say the same. Gives how many windows there are, and how many of them twice.
    #[track_caller]
    pub fn check_union(&self) -> (usize, usize) {
        // Windows that are still on their way are no hole.
        std::thread::sleep(Duration::from_secs(4));
        let union = self.union.lock().unwrap();
        let (mut twice, mut faults) = (0, Vec::new());
        for k in 0..LOOPS {
            let name = name_of(k);
            let of_loop: Vec<_> = union.range((name.clone(), i64::MIN)..=(name.clone(), i64::MAX)).collect();
            for pair in of_loop.windows(2) {
                let [((_, before), _), ((_, next), _)] = pair else { continue };
                if next - before != HOP_NS {
                    faults.push(format!("{name}: {} windows missing after {before}", (next - before) / HOP_NS - 1));
                }
            }
            for ((_, end_ns), heard) in of_loop {
                let makers: BTreeSet<&str> = heard.iter().map(|one| one.daemon.as_str()).collect();
                twice += usize::from(makers.len() > 1);
                let said: BTreeSet<String> = heard.iter().map(|one| one.document["verdict"].to_string()).collect();
                if said.len() > 1 {
                    faults.push(format!("{name} {end_ns}: {said:?}"));
                }
            }
        }
        assert!(faults.is_empty(), "{}", faults.join("\n"));
        (union.len(), twice)
    }

    /// Ends every daemon in order; each of their recordings replays to the byte.
    pub fn end_and_verify(mut self) {
        let ids: Vec<String> = self.members.keys().cloned().collect();
        ids.iter().for_each(|id| self.signal(id, "TERM"));
        let ended: Vec<tempfile::TempDir> = ids.iter().map(|id| self.remove(id)).collect();
        for folder in ended.iter().chain(&self.left) {
            let recordings = self.recordings_in(folder.path());
            let out = live::stictiond(&["replay", recordings.to_str().unwrap(), "--verify"]);
            let text = String::from_utf8_lossy(&out.stdout).into_owned();
            // 3: a recording that kill -9 cut off is compared as far as it goes.
            assert!(matches!(out.status.code(), Some(0 | 3)), "{text}\n{}", String::from_utf8_lossy(&out.stderr));
            assert!(text.contains("all equal to the byte"), "{text}");
        }
    }

    /// What the bus answers for a loop's alarm.
    pub fn alarm(&self, parameters: &str) -> Vec<Value> {
        let replies = self.bus.get(plane(&format!("{}/alarm{parameters}", name_of(0)))).wait().unwrap();
        let good = replies.into_iter().filter_map(|reply| reply.into_result().ok());
        good.map(|sample| serde_json::from_slice(&sample.payload().to_bytes()).unwrap()).collect()
    }
}

impl Drop for Site {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        let _ = self.plant.take().map(std::thread::JoinHandle::join);
        if std::thread::panicking() {
            for (id, member) in &self.members {
                let log = fs::read_to_string(member.folder.path().join("log")).unwrap_or_default();
                eprintln!("== {id}\n{log}");
            }
        }
        for member in self.members.values_mut() {
            let _ = (member.child.kill(), member.child.wait());
        }
        let _ = (self.bus.close().wait(), self.router.close().wait());
        for id in ["a", "b", "c"] {
            ip(&format!("netns del {}", self.wire(id).0));
        }
        ip(&format!("link del stb{}", self.number));
    }
}

/// The program answers at all: a build that cannot start would look like a slow one.
pub fn program_runs() {
    assert!(ok(&["--version"]).contains("stictiond"));
}
