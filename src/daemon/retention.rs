//! Maintains the recording folder on a thread of the lowest priority: removes samples that are older or more than the retention
//! allows, likewise results; reads every finished file once to check that it is complete; and reports what was put aside. It
//! never touches the file in use, and logs and counts everything it removes.

use std::collections::{BTreeMap, HashMap};
use std::fs;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant, SystemTime};

use crossbeam_channel::{Receiver, RecvTimeoutError, TryRecvError};

use crate::daemon::sink::state_writer::Notes;
use crate::daemon::startup_state::memory::{RunFile, is_recording, report_aside};
use crate::runtime::clock::Clock;
use crate::runtime::faults::Faults;
use crate::runtime::metrics::Metrics;
use crate::runtime::view::CurrentConfig;
use stiction_engine::config::Retention;
use stiction_files::lock::SharedLock;
use stiction_files::rescue::{REMOVED, SAMPLES_KEY, take_samples_out, under_way};
use stiction_files::{End, RecordingReader};

/// Pause between two looks at the folder.
const EVERY: Duration = Duration::from_secs(30);
/// After a check, the thread rests this many times as long as the check took: it uses a third of one disk at most.
const REST: u32 = 2;
/// The clock is doubted if it is further than this ahead of the newest recording, ns: thirty days.
const DOUBT_NS: i64 = 30 * DAY_NS;
/// The clock is doubted if it advances by this much more than the running time, ns.
const JUMP_NS: i64 = DAY_NS;
/// How long nothing is then removed by age.
const WAIT: Duration = Duration::from_secs(86_400);
const DAY_NS: i64 = 86_400_000_000_000;
/// Free disk space below which a fault is raised, if it is also less than one part in [`MIN_FREE_PART`] of the disk: about a
/// day of samples of a thousand loops.
const MIN_FREE_BYTES: u64 = 10_000_000_000;
const MIN_FREE_PART: u64 = 20;

/// Inputs of the worker.
pub struct RetentionParts {
    /// The folder.
    pub dir: PathBuf,
    /// Prefix of this daemon; recordings of other prefixes are left alone.
    pub prefix: String,
    /// The run whose open files are in use.
    pub run_id: String,
    /// The configuration in force, which says what may be kept.
    pub config: CurrentConfig,
    /// The folder's lock.
    pub lock: SharedLock,
    /// Where files found complete are noted; `None` in a demonstration.
    pub notes: Option<Notes>,
    /// Files that earlier runs found complete, by name.
    pub verified: BTreeMap<String, String>,
    /// Counters.
    pub metrics: Arc<Metrics>,
    /// Faults.
    pub faults: Arc<Faults>,
    /// The time.
    pub clock: Clock,
}

/// Size and time of last change of a file: while both stay the same, the content is taken to be the same.
type FileStamp = (u64, i64);

/// One recording, with what retention needs to know.
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
pub fn start(parts: RetentionParts, stop: Receiver<()>) -> std::io::Result<JoinHandle<()>> {
    let mut worker = RetentionWorker::new(parts);
    std::thread::Builder::new().name("retention".into()).spawn(move || {
        super::gaps::yield_to_all();
        let faults = worker.parts.faults.clone();
        loop {
            // Whatever goes wrong with one file, the others must still be maintained.
            let done = catch_unwind(AssertUnwindSafe(|| {
                worker.keep();
                worker.check(&stop)
            }));
            match done {
                Ok(true) => return,
                Ok(false) => faults.clear("retention worker"),
                Err(_) => {
                    faults.raise("retention worker", "retention has stopped: a check panicked, see the log");
                }
            }
            if stop.recv_timeout(EVERY) != Err(RecvTimeoutError::Timeout) {
                return;
            }
        }
    })
}

/// The work without its thread, so that a test or simulation can call it directly.
pub struct RetentionWorker {
    parts: RetentionParts,
    /// Cached facts about each file, by name, size and time of change.
    known: HashMap<(PathBuf, u64, i64), Option<Kept>>,
    /// Files that were read to the end.
    checked: HashMap<PathBuf, FileStamp>,
    damaged: BTreeMap<PathBuf, String>,
    doubt: Doubt,
}

impl RetentionWorker {
    /// A worker for which files that an earlier run found complete count as checked.
    #[must_use]
    pub fn new(parts: RetentionParts) -> Self {
        let verified = parts.verified.iter().filter_map(|(name, look)| Some((parts.dir.join(name), look_of(look)?)));
        Self {
            checked: verified.collect(),
            known: HashMap::new(),
            damaged: BTreeMap::new(),
            doubt: Doubt::new(parts.clock.now_ns(), parts.clock.now()),
            parts,
        }
    }

    /// Goes through the folder once and removes what exceeds the retention.
    pub fn keep(&mut self) {
        match self.parts.lock.renew() {
            Ok(true) => self.parts.faults.clear("lock"),
            // The reason for having no lock was logged at the start.
            Ok(false) => {}
            Err(error) => self.parts.faults.raise("lock", error.to_string()),
        }
        report_aside(&self.parts.dir, &self.parts.faults);
        let files = self.files();
        tell_room(&self.parts.dir, files.iter().map(|k| k.bytes).sum(), &self.parts.faults);
        let retention = self.parts.config.get().retention;
        let newest_before = files.iter().filter(|k| k.file.run_id != self.parts.run_id).map(|k| k.modified_ns).max();
        let sure = self.doubt.look(self.parts.clock.now_ns(), self.parts.clock.now(), newest_before);
        match sure {
            Some(_) => self.parts.faults.clear("clock"),
            None => self.parts.faults.raise(
                "clock",
                "the clock is far ahead of the recordings: nothing is removed by age for a day; set the clock",
            ),
        }
        for step in plan(&files, &retention, sure) {
            self.carry_out(&step);
        }
    }

    /// All recordings of this prefix, oldest first.
    fn files(&mut self) -> Vec<Kept> {
        let entries = fs::read_dir(&self.parts.dir).into_iter().flatten().flatten();
        let mut files = Vec::new();
        let mut seen = HashMap::new();
        for path in entries.map(|e| e.path()).filter(|p| p.is_file() && is_recording(p)) {
            let Ok(there) = fs::metadata(&path) else { continue };
            let modified_ns = there.modified().map_or(0, ns_of);
            let key = (path.clone(), there.len(), modified_ns);
            let kept = self.known.remove(&key).unwrap_or_else(|| read(&path, &self.parts, there.len(), modified_ns));
            files.extend(kept.clone());
            seen.insert(key, kept);
        }
        self.known = seen;
        let key = |k: &Kept| (k.file.run_number, k.file.started_ns, k.file.segment, k.file.index);
        files.sort_by_key(key);
        files
    }

    fn carry_out(&self, step: &Step) {
        let (metrics, faults) = (&self.parts.metrics, &self.parts.faults);
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

    /// Reads the finished files that were not read yet, resting between them; true if the daemon stops.
    fn check(&mut self, stop: &Receiver<()>) -> bool {
        for path in self.unchecked() {
            let started = Instant::now();
            self.check_one(&path, stop);
            if stop.recv_timeout(started.elapsed() * REST) != Err(RecvTimeoutError::Timeout) {
                return true;
            }
        }
        false
    }

    /// Reads the finished files that were not read yet, without rests.
    pub fn check_all(&mut self) {
        // The sender stays open, so nothing stops it early.
        let (_open, stop) = crossbeam_channel::bounded(0);
        for path in self.unchecked() {
            self.check_one(&path, &stop);
        }
    }

    /// Finished files that were not read yet, newest first. Drops cached facts about files that no longer exist.
    fn unchecked(&mut self) -> Vec<PathBuf> {
        let files = self.files();
        let there: HashMap<&Path, FileStamp> =
            files.iter().map(|k| (k.file.path.as_path(), (k.bytes, k.modified_ns))).collect();
        let notes = self.parts.notes.as_ref();
        self.checked.retain(|path, _| {
            let stays = there.contains_key(path.as_path());
            if !stays && let Some(notes) = notes {
                notes.forget_verified(&name_of(path));
            }
            stays
        });
        self.damaged.retain(|path, _| there.contains_key(path.as_path()));
        self.tell_damaged();
        let is_new = |k: &&Kept| !k.open && self.checked.get(&k.file.path) != Some(&(k.bytes, k.modified_ns));
        files.iter().rev().filter(is_new).map(|k| k.file.path.clone()).collect()
    }

    fn check_one(&mut self, path: &Path, stop: &Receiver<()>) {
        let Some(look) = fs::metadata(path).ok().map(|there| (there.len(), there.modified().map_or(0, ns_of))) else {
            return;
        };
        self.parts.metrics.recordings_checked.inc();
        match fault_of(path, stop) {
            Checked::Stopped => return,
            Checked::Whole => {
                self.damaged.remove(path);
                if let Some(notes) = &self.parts.notes {
                    notes.verified(&name_of(path), &text_of(look));
                }
            }
            Checked::Damaged(why) => drop(self.damaged.insert(path.to_owned(), why)),
        }
        self.checked.insert(path.to_owned(), look);
        self.tell_damaged();
    }

    fn tell_damaged(&self) {
        let faults = &self.parts.faults;
        self.parts.metrics.recordings_damaged.set(self.damaged.len() as i64);
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

/// Raises a fault while the disk is nearly full, early enough to act.
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

/// The fault for a nearly full disk, by its free bytes, its size and the bytes of recordings; `None` while there is room.
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

/// Result of reading a file.
enum Checked {
    Whole,
    Damaged(String),
    /// The daemon stops; the file was not read to the end.
    Stopped,
}

/// Reads a finished file to the end. A file cut off by a crash counts as complete as far as it goes.
fn fault_of(path: &Path, stop: &Receiver<()>) -> Checked {
    let part = path.extension().is_some_and(|e| e == "part");
    let mut reader = match RecordingReader::open(path) {
        Ok(reader) => reader,
        Err(error) => return Checked::Damaged(error.to_string()),
    };
    for count in 0_u64.. {
        match reader.next_item() {
            // A large file must not delay the daemon's end.
            Ok(Some(_)) if count.is_multiple_of(4096) && stop.try_recv() == Err(TryRecvError::Disconnected) => {
                return Checked::Stopped;
            }
            Ok(Some(_)) => {}
            Ok(None) => break,
            Err(error) => return Checked::Damaged(error.to_string()),
        }
    }
    match reader.end() {
        Some(End::Damaged { reason }) => Checked::Damaged(reason.clone()),
        Some(End::Cut { reason }) if !part => Checked::Damaged(reason.clone()),
        _ => Checked::Whole,
    }
}

fn name_of(path: &Path) -> String {
    path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default()
}

fn text_of((bytes, modified_ns): FileStamp) -> String {
    format!("{bytes} {modified_ns}")
}

fn look_of(text: &str) -> Option<FileStamp> {
    let (bytes, modified_ns) = text.split_once(' ')?;
    Some((bytes.parse().ok()?, modified_ns.parse().ok()?))
}

fn read(path: &Path, parts: &RetentionParts, bytes: u64, modified_ns: i64) -> Option<Kept> {
    let reader = RecordingReader::open(path).ok()?;
    let metadata = reader.metadata();
    if metadata.get("prefix") != Some(&parts.prefix) {
        return None;
    }
    let file = RunFile::of(path, metadata)?;
    let open = file.run_id == parts.run_id && path.extension().is_some_and(|e| e == "part");
    let results_only = metadata.get(SAMPLES_KEY).is_some_and(|word| word == REMOVED);
    // Left half done by an earlier attempt.
    let _ = fs::remove_file(under_way(&finished_name(path)));
    Some(Kept { file, bytes, modified_ns, results_only, open })
}

/// The recording's name once it is finished.
fn finished_name(path: &Path) -> PathBuf {
    if path.extension().is_some_and(|e| e == "part") { path.with_extension("") } else { path.to_owned() }
}

fn ns_of(time: SystemTime) -> i64 {
    time.duration_since(SystemTime::UNIX_EPOCH).map_or(0, |d| i64::try_from(d.as_nanos()).unwrap_or(i64::MAX))
}

/// One removal.
#[derive(Debug, Clone, PartialEq, Eq)]
enum Step {
    TakeSamplesOut { path: PathBuf, why: &'static str },
    Remove { path: PathBuf, why: &'static str },
}

/// Removals that the retention requires, for files given oldest first. `now_ns` is `None` while the clock is in doubt.
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

/// Whether the wall clock can be trusted: a clock that is years ahead must not cause everything to be removed at once.
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

    /// The time, unless it is in doubt. `newest_ns`: time of the newest recording of an earlier run.
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
    use crate::daemon::sink::state_writer::StateWriter;
    use stiction_files::disk::SystemDisk;

    fn kept(index: u32, bytes: u64, age_days: i64, results_only: bool) -> Kept {
        let path = PathBuf::from(format!("{index}.mcap"));
        let file = RunFile { path, run_number: 1, started_ns: 0, run_id: "r".into(), segment: 0, index };
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

    fn worker(dir: &Path, verified: BTreeMap<String, String>, notes: Option<Notes>) -> RetentionWorker {
        RetentionWorker::new(RetentionParts {
            dir: dir.to_owned(),
            prefix: "p".into(),
            run_id: "now".into(),
            config: CurrentConfig::new(stiction_engine::config::Config::with_prefix("p")),
            lock: SharedLock::default(),
            notes,
            verified,
            metrics: Arc::default(),
            faults: Arc::default(),
            clock: Clock::system(),
        })
    }

    fn recording(dir: &Path, index: u32) {
        let metadata = [("prefix", "p"), ("started_ns", "1"), ("run_id", "r"), ("shard", "0")]
            .map(|(k, v)| (k.to_owned(), v.to_owned()))
            .into_iter()
            .chain([("file_index".to_owned(), index.to_string())])
            .collect();
        stiction_files::RecordingFile::create(dir, &format!("r{index}"), &metadata).unwrap().finish().unwrap();
    }

    #[test]
    fn files_found_whole_are_not_read_again_after_a_restart_unless_they_changed() {
        let dir = tempfile::tempdir().unwrap();
        (0..3).for_each(|index| recording(dir.path(), index));
        let run = |verified| {
            let (faults, metrics) = (Arc::<Faults>::default(), Arc::<Metrics>::default());
            let (state_writer, mut store) = StateWriter::pair(
                dir.path(),
                "p",
                (None, Default::default()),
                Arc::new(SystemDisk),
                faults.clone(),
                metrics.clone(),
            );
            let mut worker = worker(dir.path(), verified, Some(state_writer.notes()));
            worker.keep();
            worker.check_all();
            assert!(store.turn());
            let checked = worker.parts.metrics.recordings_checked.get();
            (checked, worker.damaged.len(), worker.checked.len())
        };
        let stored = || {
            let (faults, metrics) = (Faults::default(), Metrics::default());
            crate::daemon::startup_state::memory::restore(&SystemDisk, dir.path(), "p", &faults, &metrics).verified
        };
        assert_eq!(run(BTreeMap::new()), (3, 0, 3));
        assert_eq!(stored().len(), 3);
        assert_eq!(run(stored()), (0, 0, 3), "known by name, size and time of change");
        // One is cut short, one is missing, one is new.
        let hurt = fs::read(dir.path().join("r0.mcap")).unwrap();
        fs::write(dir.path().join("r0.mcap"), &hurt[..hurt.len() - 9]).unwrap();
        fs::remove_file(dir.path().join("r1.mcap")).unwrap();
        recording(dir.path(), 3);
        assert_eq!(run(stored()), (2, 1, 3));
        let names: Vec<String> = stored().into_keys().collect();
        assert!(
            names.contains(&"r2.mcap".to_owned())
                && names.contains(&"r3.mcap".to_owned())
                && !names.contains(&"r1.mcap".to_owned()),
            "{names:?}"
        );
        assert_eq!(run(stored()).0, 1, "a damaged file is read again");
    }

    #[test]
    fn samples_go_first_by_age_and_bytes_and_results_much_later() {
        let files = [kept(0, 10, 500, true), kept(1, 10, 90, true), kept(2, 10, 70, false), kept(3, 10, 9, false)];
        let retention = Retention { raw_days: 60.0, raw_bytes: 0, results_days: 400.0, results_bytes: 0 };
        assert_eq!(names(&plan(&files, &retention, Some(0))), ["thin 2.mcap", "remove 0.mcap"]);
        // By bytes, the oldest are removed first, and no more than necessary.
        let many: Vec<Kept> = (0..5).map(|k| kept(k, 10, 1, false)).collect();
        let retention = Retention { raw_days: 0.0, raw_bytes: 30, results_days: 0.0, results_bytes: 0 };
        assert_eq!(names(&plan(&many, &retention, Some(0))), ["thin 0.mcap", "thin 1.mcap"]);
        // The file in use counts, but is kept.
        let mut one = vec![kept(0, 100, 99, false)];
        one[0].open = true;
        let strict = Retention { raw_days: 1.0, raw_bytes: 1, results_days: 1.0, results_bytes: 1 };
        assert!(plan(&one, &strict, Some(0)).is_empty());
        // Without a trusted clock only bytes count.
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
