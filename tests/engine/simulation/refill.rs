//! A start continues the loops' windows from the recordings, and every run replays byte for byte.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use serde_json::Value;
use stiction_engine::codec::topic::{self, Kind};
use stiction_engine::config::Config;
use stiction_files::disk::{Disk, SystemDisk};
use stiction_files::run::RunMetadata;
use stiction_files::{RecordingFile, RecordingReader};
use stictiond::daemon::replay::parallel::ParallelReplay;
use stictiond::daemon::replay::{chains_of, files_before};
use stictiond::daemon::sim_daemon::{SimDaemon, no_receiver};
use stictiond::daemon::sink::recorder::segment_of;
use stictiond::runtime::clock::Clock;

const NAMES: [&str; 2] = ["A", "B"];

/// A plant with a sample a second, and the daemon that watches it.
struct Site<'a> {
    dir: &'a Path,
    clock: Clock,
    stage: Option<SimDaemon>,
    /// Start and end of each loop's windows, s.
    windows: BTreeMap<String, Vec<[i64; 2]>>,
    now_s: i64,
}

impl<'a> Site<'a> {
    fn new(dir: &'a Path) -> Self {
        let clock = Clock::standing(super::START_NS);
        Self { dir, clock, stage: None, windows: BTreeMap::new(), now_s: super::START_NS / 1_000_000_000 }
    }

    fn start(&mut self, hop_s: f64) -> &mut SimDaemon {
        let text = format!(
            "[site]\nprefix = \"p\"\n[window]\nhop_s = {hop_s:?}\nmax_gap_s = 120.0\n[gap]\nenabled = false\n\
             [recording]\nflush_s = 0.1\nmax_s = 300.0\ndir = {:?}\n",
            self.dir.to_str().unwrap()
        );
        let (config, disk) = (Config::parse(&text).unwrap(), Arc::new(SystemDisk) as Arc<dyn Disk>);
        self.stage.insert(SimDaemon::start(config, &text, &self.clock, &disk, no_receiver).unwrap())
    }

    fn pass(&mut self, seconds: i64) {
        self.clock.advance(Duration::from_secs(seconds as u64));
        self.now_s += seconds;
    }

    /// All loops send for this many seconds. Recordings reach the disk except for the last `unwritten` seconds.
    fn send(&mut self, names: &[&str], seconds: i64, unwritten: i64) {
        for left in (0..seconds).rev() {
            let stage = self.stage.as_mut().unwrap();
            for (name, signal, value) in names.iter().flat_map(|n| [(n, "op", 50), (n, "pv", self.now_s % 20)]) {
                let json = format!(r#"{{"t": {}, "v": {value}}}"#, self.now_s * 1_000_000_000);
                stage.deliver(&format!("p/{name}/{signal}"), json.as_bytes());
            }
            stage.turn();
            stage.work(usize::MAX, |_, request| Some(crate::answers::compute(request).assessment));
            if left >= unwritten {
                stage.record();
            }
            assert!(stage.keep());
            for publication in stage.published().filter(|p| p.kind == Kind::Estimate).collect::<Vec<_>>() {
                let document: Value = serde_json::from_slice(&publication.document.unwrap()).unwrap();
                let second = |field: &str| document["window"][field].as_i64().unwrap() / 1_000_000_000;
                let name = document["loop"].as_str().unwrap().to_owned();
                self.windows.entry(name).or_default().push([second("start_ns"), second("end_ns")]);
            }
            self.pass(1);
        }
    }

    /// Kills the daemon as by kill -9.
    fn kill(&mut self) -> i64 {
        self.stage = None;
        self.now_s
    }

    /// The windows of a loop that end after a given second.
    fn windows_after(&self, name: &str, second: i64) -> Vec<[i64; 2]> {
        self.windows[name].iter().copied().filter(|[_, end]| *end > second).collect()
    }
}

fn metadata(file: &Path) -> RunMetadata {
    RunMetadata::of(file, RecordingReader::open(file).unwrap().metadata()).unwrap()
}

/// Replays files and compares the last one.
fn compare_last(files: &[PathBuf]) -> usize {
    let last = files.last().unwrap();
    let mut replay = ParallelReplay::new(&metadata(last).config, Some("stage"), false);
    let report = |(at, file): (usize, &PathBuf)| replay.file(file, "p", at == 0, true).unwrap();
    let report = files.iter().enumerate().map(report).last().unwrap();
    assert_eq!(report.difference, None, "{files:?}");
    report.compared
}

/// Replays every chain of files as a whole, in a folder of one run.
pub fn chains_replay_to_the_byte(dir: &Path) -> usize {
    let mut compared = 0;
    for chain in chains_of(dir).unwrap() {
        let mut replay = ParallelReplay::new(&metadata(&chain[0]).config, Some("stage"), false);
        for (at, file) in chain.iter().enumerate() {
            let report = replay.file(file, "p", at == 0, true).unwrap();
            assert_eq!(report.difference, None, "{}", file.display());
            compared += report.compared;
        }
    }
    compared
}

/// Replays every run as the command replays a folder: after as much of the earlier files as its windows need.
pub fn runs_replay_to_the_byte(dir: &Path) -> usize {
    let mut compared = 0;
    for chain in chains_of(dir).unwrap() {
        let before = files_before(&chain).unwrap();
        let mut replay = ParallelReplay::new(&metadata(&chain[0]).config, Some("stage"), false);
        for (at, file) in before.iter().chain(&chain).enumerate() {
            let report = replay.file(file, "p", at == 0, at >= before.len()).unwrap();
            assert_eq!(report.difference, None, "{}", file.display());
            compared += report.compared;
        }
    }
    compared
}

/// Replays every file separately, and every chain of files, as the command does.
pub fn replays_to_the_byte(dir: &Path) -> usize {
    let mut compared = 0;
    for chain in chains_of(dir).unwrap() {
        let needed = |files: &[PathBuf]| [&files_before(files).unwrap(), files].concat();
        let whole = needed(&chain);
        for (at, file) in chain.iter().enumerate() {
            compared += compare_last(&needed(std::slice::from_ref(file)));
            compare_last(&whole[..=whole.len() - chain.len() + at]);
        }
    }
    compared
}

#[test]
fn a_killed_daemon_goes_on_with_its_windows_makes_none_twice_and_replays_to_the_byte() {
    let dir = tempfile::tempdir().unwrap();
    let mut site = Site::new(dir.path());
    site.start(60.0);
    site.send(&NAMES, 700, 50);
    let mut killed = site.kill();
    // Kills just after a start and in the middle of a window, and one normal end.
    for unwritten in [0, 70, 20] {
        site.pass(10);
        site.start(60.0);
        site.kill();
        site.start(60.0);
        let started = site.now_s;
        site.send(&NAMES, 200, unwritten);
        for name in NAMES {
            let [start, end] = site.windows_after(name, started)[0];
            assert!(start < killed && end - started <= 60, "{name}: {start} to {end}, killed {killed}");
            let all = &site.windows[name];
            assert!(all.is_sorted_by(|a, b| a[1] < b[1]), "{name}: {all:?}");
        }
        if unwritten == 20 {
            site.stage.as_mut().unwrap().finish();
        }
        killed = site.kill();
    }
    // With another hop the windows are different, so they start empty. The same holds after a silence longer than a window.
    for (hop_s, silent) in [(30.0, 10), (30.0, 8 * 86_400)] {
        site.pass(silent);
        site.start(hop_s);
        let started = site.now_s;
        site.send(&NAMES, 300, 0);
        assert!(NAMES.iter().all(|name| site.windows_after(name, started)[0][0] >= started), "{:?}", site.windows);
        site.kill();
    }
    assert!(replays_to_the_byte(dir.path()) > 50);
}

#[test]
fn a_recording_that_cannot_be_read_is_named_and_its_loops_begin_anew() {
    let dir = tempfile::tempdir().unwrap();
    let mut site = Site::new(dir.path());
    site.start(60.0);
    site.send(&NAMES, 130, 0);
    site.kill();
    let file = chains_of(dir.path()).unwrap().pop().unwrap().pop().unwrap();
    let mut metadata = RecordingReader::open(&file).unwrap().metadata().clone();
    metadata.insert("file_index".to_owned(), "9".to_owned());
    let name = file.file_name().unwrap().to_str().unwrap().replace(".mcap", "").replace(".part", "");
    let mut broken = RecordingFile::create(dir.path(), &format!("{}9", &name[..name.len() - 1]), &metadata).unwrap();
    broken.write(&topic::result("p", "A", Kind::State), Kind::State, 1, 1, b"{}").unwrap();
    broken.finish().unwrap();
    let stage = site.start(60.0);
    assert!(stage.faults().iter().any(|f| f.contains("windows") && f.contains("00009.mcap")), "{:?}", stage.faults());
    let id = stage.engine().find("A").unwrap();
    assert_eq!(stage.engine().figures(id).greatest_ns, None);
}

#[test]
fn loops_keep_their_shards_over_a_start() {
    let dir = tempfile::tempdir().unwrap();
    let mut site = Site::new(dir.path());
    let names: Vec<String> = (0..1100).map(|k| format!("L{}", k * 7919 % 1100)).collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    site.start(60.0);
    site.send(&names, 3, 0);
    let shards = |stage: &SimDaemon| -> Vec<usize> {
        names.iter().map(|name| segment_of(stage.engine().find(name).unwrap())).collect()
    };
    let before = shards(site.stage.as_ref().unwrap());
    site.kill();
    let stage = site.start(60.0);
    assert_eq!(shards(stage), before);
    assert!(before.contains(&1) && stage.engine().ids().all(|id| stage.engine().figures(id).greatest_ns.is_some()));
}
