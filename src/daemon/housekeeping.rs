//! Keeps the recording folder in order, in a thread of its own at the lowest priority: takes out samples that are older
//! or more than the retention allows, removes results that are, looks whether finished files are still whole, and names
//! what lies aside. It never touches the file in use, and logs and counts whatever it takes away.

use std::collections::{BTreeMap, HashMap};
use std::fs;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant, SystemTime};

use crossbeam_channel::{Receiver, RecvTimeoutError, TryRecvError};

use super::clock::now_ns;
use super::faults::Faults;
use super::metrics::Metrics;
use super::restore::{RunFile, is_recording, tell_aside};
use crate::files::lock::FolderLock;
use crate::files::rescue::{REMOVED, SAMPLES_KEY, take_samples_out, under_way};
use crate::files::{End, RecordingReader};
use stiction_monitor::config::Retention;

/// Pause between two looks at the folder.
const EVERY: Duration = Duration::from_secs(30);
/// Times what a check took that it then rests: a third of one disk at most.
const REST: u32 = 2;
/// Wall time beyond the newest recording from which the clock is doubted, ns: thirty days.
const DOUBT_NS: i64 = 30 * DAY_NS;
/// Wall time beyond the running time from which the clock is doubted, ns.
const JUMP_NS: i64 = DAY_NS;
/// How long nothing is removed by age then.
const WAIT: Duration = Duration::from_secs(86_400);
const DAY_NS: i64 = 86_400_000_000_000;
/// Room on the disk below which that is a fault, if it is also less than this part of the disk: about a day of samples of
/// a thousand loops.
const MIN_FREE_BYTES: u64 = 10_000_000_000;
const MIN_FREE_PART: u64 = 20;

/// What the housekeeper is told.
pub struct House {
    /// The folder.
    pub dir: PathBuf,
    /// Recordings of other prefixes are left alone.
    pub prefix: String,
    /// The run whose open files are in use.
    pub run_id: String,
    /// What may be kept; may change.
    pub retention: Arc<Mutex<Retention>>,
    /// The folder's lock.
    pub lock: Option<FolderLock>,
    /// Counters.
    pub metrics: Arc<Metrics>,
    /// Faults.
    pub faults: Arc<Faults>,
}

/// One recording, as far as keeping it goes.
#[derive(Debug, Clone)]
struct Kept {
    file: RunFile,
    bytes: u64,
    modified_ns: i64,
    /// Whether its samples were taken out.
    results_only: bool,
    open: bool,
}

/// Starts the thread; it ends when `stop` is closed.
///
/// # Errors
/// The system refuses a thread.
pub fn start(house: House, stop: Receiver<()>) -> std::io::Result<JoinHandle<()>> {
    let mut keeper = Housekeeper {
        house,
        known: HashMap::new(),
        checked: HashMap::new(),
        damaged: BTreeMap::new(),
        doubt: Doubt::new(now_ns(), Instant::now()),
    };
    std::thread::Builder::new().name("house".into()).spawn(move || {
        super::gaps::yield_to_all();
        let faults = keeper.house.faults.clone();
        loop {
            // Whatever a file makes it stumble over, the others are still to be looked after.
            let done = catch_unwind(AssertUnwindSafe(|| {
                keeper.look();
                keeper.check(&stop)
            }));
            match done {
                Ok(true) => return,
                Ok(false) => faults.clear("house"),
                Err(_) => faults.raise("house", "recordings cannot be looked after: the log says where it broke off"),
            }
            if stop.recv_timeout(EVERY) != Err(RecvTimeoutError::Timeout) {
                return;
            }
        }
    })
}

struct Housekeeper {
    house: House,
    /// What was read of each file, by name, size and age.
    known: HashMap<(PathBuf, u64, i64), Option<Kept>>,
    /// Files that were found whole, or not, with their size and age.
    checked: HashMap<PathBuf, (u64, i64)>,
    damaged: BTreeMap<PathBuf, String>,
    doubt: Doubt,
}

impl Housekeeper {
    /// Looks at the folder once.
    fn look(&mut self) {
        if let Some(lock) = &mut self.house.lock {
            match lock.renew() {
                Ok(()) => self.house.faults.clear("lock"),
                Err(error) => self.house.faults.raise("lock", error.to_string()),
            }
        }
        tell_aside(&self.house.dir, &self.house.faults);
        let files = self.files();
        tell_room(&self.house.dir, files.iter().map(|k| k.bytes).sum(), &self.house.faults);
        let retention = *self.house.retention.lock().unwrap_or_else(PoisonError::into_inner);
        let newest_before = files.iter().filter(|k| k.file.run_id != self.house.run_id).map(|k| k.modified_ns).max();
        let sure = self.doubt.look(now_ns(), Instant::now(), newest_before);
        match sure {
            Some(_) => self.house.faults.clear("clock"),
            None => self.house.faults.raise(
                "clock",
                "the clock is far ahead of the recordings: nothing is removed by age for a day; set the clock",
            ),
        }
        for step in plan(&files, &retention, sure) {
            self.carry_out(&step);
        }
    }

    /// Every recording of this prefix, oldest first.
    fn files(&mut self) -> Vec<Kept> {
        let entries = fs::read_dir(&self.house.dir).into_iter().flatten().flatten();
        let mut files = Vec::new();
        let mut seen = HashMap::new();
        for path in entries.map(|e| e.path()).filter(|p| p.is_file() && is_recording(p)) {
            let Ok(there) = fs::metadata(&path) else { continue };
            let modified_ns = there.modified().map_or(0, ns_of);
            let key = (path.clone(), there.len(), modified_ns);
            let kept = self.known.remove(&key).unwrap_or_else(|| read(&path, &self.house, there.len(), modified_ns));
            files.extend(kept.clone());
            seen.insert(key, kept);
        }
        self.known = seen;
        let key = |k: &Kept| (k.file.run_number, k.file.started_ns, k.file.shard, k.file.index);
        files.sort_by_key(key);
        files
    }

    fn carry_out(&self, step: &Step) {
        let (metrics, faults) = (&self.house.metrics, &self.house.faults);
        let done = match step {
            Step::TakeSamplesOut { path, why } => {
                let out = finished_name(path);
                take_samples_out(path, &out)
                    .map_err(|e| e.to_string())
                    .inspect(|_| {
                        metrics.recordings_thinned.inc();
                        tracing::info!(file = %path.display(), why, "retention: samples taken out, results kept");
                    })
                    .map(drop)
            }
            Step::Remove { path, why } => fs::remove_file(path).map_err(|e| e.to_string()).inspect(|()| {
                metrics.recordings_removed.inc();
                tracing::info!(file = %path.display(), why, "retention: removed");
            }),
        };
        match done {
            Ok(()) => faults.clear("retention"),
            Err(why) => faults.raise("retention", format!("a recording that is too old cannot be removed: {why}")),
        }
    }

    /// Reads finished files that were not looked at yet, with rests; true where the daemon stops.
    fn check(&mut self, stop: &Receiver<()>) -> bool {
        let files = self.files();
        let there: HashMap<&Path, (u64, i64)> =
            files.iter().map(|k| (k.file.path.as_path(), (k.bytes, k.modified_ns))).collect();
        self.checked.retain(|path, _| there.contains_key(path.as_path()));
        self.damaged.retain(|path, _| there.contains_key(path.as_path()));
        self.tell_damaged();
        for kept in files.iter().rev().filter(|k| !k.open) {
            let (path, look) = (&kept.file.path, (kept.bytes, kept.modified_ns));
            if self.checked.get(path) == Some(&look) {
                continue;
            }
            let started = Instant::now();
            match fault_of(path, stop) {
                Some(why) => self.damaged.insert(path.clone(), why),
                None => self.damaged.remove(path),
            };
            self.checked.insert(path.clone(), look);
            self.tell_damaged();
            if stop.recv_timeout(started.elapsed() * REST) != Err(RecvTimeoutError::Timeout) {
                return true;
            }
        }
        false
    }

    fn tell_damaged(&self) {
        let faults = &self.house.faults;
        self.house.metrics.recordings_damaged.set(self.damaged.len() as i64);
        match self.damaged.iter().next() {
            None => faults.clear("damaged"),
            Some((path, why)) => {
                let (n, path) = (self.damaged.len(), path.display());
                let remedy = "stictiond recover rescues what can be read; then move them elsewhere";
                faults.raise("damaged", format!("{n} recordings are damaged, such as {path}: {why}; {remedy}"));
            }
        }
    }
}

/// Names a disk that will be full soon, while there is time to do something about it.
#[cfg(target_os = "linux")]
fn tell_room(dir: &Path, recordings: u64, faults: &Faults) {
    let Ok(disk) = rustix::fs::statvfs(dir) else { return };
    let [free, all] = [disk.f_bavail, disk.f_blocks].map(|blocks| blocks.saturating_mul(disk.f_frsize));
    match nearly_full(free, all, recordings) {
        Some(why) => faults.raise("room", format!("{}: {why}", dir.display())),
        None => faults.clear("room"),
    }
}

#[cfg(not(target_os = "linux"))]
fn tell_room(_dir: &Path, _recordings: u64, _faults: &Faults) {}

/// What to say of a disk with so many bytes free of all, beside so many of recordings.
fn nearly_full(free: u64, all: u64, recordings: u64) -> Option<String> {
    let [free_gb, recordings_gb] = [free, recordings].map(|bytes| bytes as f64 / 1e9);
    let is_short = free < MIN_FREE_BYTES && free < all / MIN_FREE_PART;
    is_short.then(|| {
        format!(
            "the disk is nearly full: {free_gb:.1} GB are free, recordings take {recordings_gb:.1} GB; recording stops when \
             it is full: make room, or lower [retention] raw_bytes"
        )
    })
}

/// What is wrong with a finished file. One that a crash cut off is as whole as it can be.
fn fault_of(path: &Path, stop: &Receiver<()>) -> Option<String> {
    let part = path.extension().is_some_and(|e| e == "part");
    let mut reader = match RecordingReader::open(path) {
        Ok(reader) => reader,
        Err(error) => return Some(error.to_string()),
    };
    for count in 0_u64.. {
        match reader.next_item() {
            // A large file must not hold up the end of the daemon.
            Ok(Some(_)) if count.is_multiple_of(4096) && stop.try_recv() == Err(TryRecvError::Disconnected) => {
                return None;
            }
            Ok(Some(_)) => {}
            Ok(None) => break,
            Err(error) => return Some(error.to_string()),
        }
    }
    match reader.end() {
        Some(End::Damaged { reason }) => Some(reason.clone()),
        Some(End::Cut { reason }) if !part => Some(reason.clone()),
        _ => None,
    }
}

fn read(path: &Path, house: &House, bytes: u64, modified_ns: i64) -> Option<Kept> {
    let reader = RecordingReader::open(path).ok()?;
    let metadata = reader.metadata();
    if metadata.get("prefix") != Some(&house.prefix) {
        return None;
    }
    let file = RunFile::of(path, metadata)?;
    let open = file.run_id == house.run_id && path.extension().is_some_and(|e| e == "part");
    let results_only = metadata.get(SAMPLES_KEY).is_some_and(|word| word == REMOVED);
    // What an earlier attempt left half done.
    let _ = fs::remove_file(under_way(&finished_name(path)));
    Some(Kept { file, bytes, modified_ns, results_only, open })
}

/// A recording's name once it is whole.
fn finished_name(path: &Path) -> PathBuf {
    if path.extension().is_some_and(|e| e == "part") { path.with_extension("") } else { path.to_owned() }
}

fn ns_of(time: SystemTime) -> i64 {
    time.duration_since(SystemTime::UNIX_EPOCH).map_or(0, |d| i64::try_from(d.as_nanos()).unwrap_or(i64::MAX))
}

/// One thing to do.
#[derive(Debug, Clone, PartialEq, Eq)]
enum Step {
    TakeSamplesOut { path: PathBuf, why: &'static str },
    Remove { path: PathBuf, why: &'static str },
}

/// What the retention asks for, files given oldest first. `now_ns` is none while the clock is in doubt.
fn plan(files: &[Kept], retention: &Retention, now_ns: Option<i64>) -> Vec<Step> {
    let mut steps = Vec::new();
    let kinds =
        [(false, retention.raw_days, retention.raw_bytes), (true, retention.results_days, retention.results_bytes)];
    for (results_only, days, limit) in kinds {
        let of_kind = || files.iter().filter(move |k| k.results_only == results_only);
        let mut bytes: u64 = of_kind().map(|k| k.bytes).sum();
        let old = |k: &Kept| {
            let age_ns = now_ns.map_or(0, |now| now.saturating_sub(k.modified_ns));
            days > 0.0 && age_ns as f64 > days * DAY_NS as f64
        };
        for kept in of_kind().filter(|k| !k.open) {
            let why = match (old(kept), limit > 0 && bytes > limit) {
                (true, _) => "older than is kept",
                (false, true) => "more bytes than are kept",
                (false, false) => continue,
            };
            bytes -= kept.bytes;
            let path = kept.file.path.clone();
            steps.push(if results_only { Step::Remove { path, why } } else { Step::TakeSamplesOut { path, why } });
        }
    }
    steps
}

/// Whether the wall clock may be believed: a clock that is years ahead must not remove everything at once.
#[derive(Debug)]
struct Doubt {
    at: (i64, Instant),
    until: Option<Instant>,
    first: bool,
}

impl Doubt {
    fn new(now_ns: i64, now: Instant) -> Self {
        Self { at: (now_ns, now), until: None, first: true }
    }

    /// The time, unless it is in doubt. `newest_ns`: when the newest recording of an earlier run was written.
    fn look(&mut self, now_ns: i64, now: Instant, newest_ns: Option<i64>) -> Option<i64> {
        let ran_ns = i64::try_from(now.duration_since(self.at.1).as_nanos()).unwrap_or(i64::MAX);
        let jumped = now_ns.saturating_sub(self.at.0).saturating_sub(ran_ns) > JUMP_NS;
        let ahead = self.first && newest_ns.is_some_and(|newest| now_ns.saturating_sub(newest) > DOUBT_NS);
        (self.at, self.first) = ((now_ns, now), false);
        if jumped || ahead {
            self.until = Some(now + WAIT);
        }
        if self.until.is_some_and(|until| now < until) {
            return None;
        }
        self.until = None;
        Some(now_ns)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn kept(index: u32, bytes: u64, age_days: i64, results_only: bool) -> Kept {
        let path = PathBuf::from(format!("{index}.mcap"));
        let file = RunFile { path, run_number: 1, started_ns: 0, run_id: "r".into(), shard: 0, index };
        Kept { file, bytes, modified_ns: -age_days * DAY_NS, results_only, open: false }
    }

    fn names(steps: &[Step]) -> Vec<String> {
        steps
            .iter()
            .map(|step| match step {
                Step::TakeSamplesOut { path, .. } => format!("thin {}", path.display()),
                Step::Remove { path, .. } => format!("remove {}", path.display()),
            })
            .collect()
    }

    #[test]
    fn samples_go_first_by_age_and_bytes_and_results_much_later() {
        let files = [kept(0, 10, 500, true), kept(1, 10, 90, true), kept(2, 10, 70, false), kept(3, 10, 9, false)];
        let retention = Retention { raw_days: 60.0, raw_bytes: 0, results_days: 400.0, results_bytes: 0 };
        assert_eq!(names(&plan(&files, &retention, Some(0))), ["thin 2.mcap", "remove 0.mcap"]);
        // By bytes the oldest first, and only as many as must go.
        let many: Vec<Kept> = (0..5).map(|k| kept(k, 10, 1, false)).collect();
        let retention = Retention { raw_days: 0.0, raw_bytes: 30, results_days: 0.0, results_bytes: 0 };
        assert_eq!(names(&plan(&many, &retention, Some(0))), ["thin 0.mcap", "thin 1.mcap"]);
        // The file in use counts, and stays.
        let mut one = vec![kept(0, 100, 99, false)];
        one[0].open = true;
        let strict = Retention { raw_days: 1.0, raw_bytes: 1, results_days: 1.0, results_bytes: 1 };
        assert!(plan(&one, &strict, Some(0)).is_empty());
        // Without a clock that can be believed only bytes count.
        assert_eq!(names(&plan(&files, &Retention { raw_days: 1.0, raw_bytes: 0, ..strict }, None)).len(), 2);
        let unlimited = Retention { raw_days: 0.0, raw_bytes: 0, results_days: 0.0, results_bytes: 0 };
        assert!(plan(&files, &unlimited, Some(0)).is_empty());
    }

    #[test]
    fn a_disk_is_nearly_full_where_both_part_and_bytes_are_few() {
        let gb = 1_000_000_000;
        assert_eq!(nearly_full(50 * gb, 2000 * gb, 0), None, "room for days");
        assert_eq!(nearly_full(2 * gb, 20 * gb, 0), None, "a small disk, and a tenth of it");
        let said = nearly_full(4 * gb, 100 * gb, 80 * gb).unwrap();
        assert!(said.contains("4.0 GB are free, recordings take 80.0 GB"), "{said}");
        assert!(nearly_full(0, 0, 0).is_none(), "no disk that tells its size");
    }

    #[test]
    fn a_clock_that_is_far_ahead_or_jumps_removes_nothing_for_a_day() {
        let start = Instant::now();
        let later = |s: u64| start + Duration::from_secs(s);
        let mut doubt = Doubt::new(100 * DAY_NS, start);
        assert_eq!(doubt.look(100 * DAY_NS, start, Some(99 * DAY_NS)), Some(100 * DAY_NS));
        assert_eq!(doubt.look(3000 * DAY_NS, later(30), None), None, "a jump");
        assert_eq!(doubt.look(3000 * DAY_NS, later(60), None), None, "still");
        assert!(doubt.look(3001 * DAY_NS, later(90_000), None).is_some(), "a day later it is believed");
        let mut ahead = Doubt::new(3000 * DAY_NS, start);
        assert_eq!(ahead.look(3000 * DAY_NS, start, Some(99 * DAY_NS)), None, "ahead from the start");
    }
}
