//! Carries the loops' memory over a restart: alarm and gap watch, from the store in the folder of the recordings.
//!
//! If the store is missing or broken, the newest state of each loop is taken from the recordings, so that a run that ended
//! before it had written all states does not hide those of the run before. A file that cannot be read is renamed, counted and
//! reported as a fault; the daemon starts whatever it finds.

use std::collections::btree_map::Entry;
use std::collections::{BTreeMap, BTreeSet, HashSet};
use std::fs;
use std::mem;
use std::path::{Path, PathBuf};

use crate::daemon::to_json;
use crate::runtime::faults::Faults;
use crate::runtime::metrics::Metrics;
use crate::runtime::overview::KeptHealth;
use stiction_engine::alarm::State;
use stiction_engine::codec::topic::{Kind, Leaf, Topic};
use stiction_engine::config::Config;
use stiction_engine::engine::{Checkpoint, RecordedInput, StateDocument};
use stiction_files::disk::Disk;
use stiction_files::run::RunMetadata;
use stiction_files::store::{
    STORE_NAME, StateStore, StoreError, Stored, key_of, key_of_data_health, key_of_runs, loop_of, verified_of,
};
use stiction_files::{FileError, InputKind, Item, ReadError, RecordingReader};

/// Files read per segment of a run: the last one may have been cut off before its first flush.
const FILES_PER_SEGMENT: usize = 2;
/// Runs read, newest first, if the store is missing: runs that ended at once hold few states.
const RUNS: usize = 20;
/// Files read to find out which run was the last, if the store has everything else.
const NEWEST: usize = 8;
/// Number of runs that the store remembers: more than any loop's newest recordings span.
const RUNS_KEPT: usize = 1000;
/// Most runs that a folder can have had; a file with a larger number is not from here.
const MOST_RUNS: i64 = 1 << 40;
/// Suffix of a broken file that was renamed.
pub const ASIDE: &str = ".broken";

/// One recording file of a folder.
#[derive(Debug, Clone)]
pub struct RunFile {
    /// Where it is.
    pub path: PathBuf,
    /// Number of the run in the folder, by the store's count; 0 for runs from before they were counted.
    pub run_number: u64,
    /// Start of its run, ns.
    pub started_ns: i64,
    /// Id of its run.
    pub run_id: String,
    /// Its segment.
    pub segment: usize,
    /// Its number among the segment's files.
    pub index: u32,
}

impl RunFile {
    /// Reads a file's place in its run from its metadata; `None` for recordings by other programs.
    #[must_use]
    pub fn of(path: &Path, metadata: &BTreeMap<String, String>) -> Option<Self> {
        let number = |key: &str| metadata.get(key)?.parse::<i64>().ok();
        Some(Self {
            path: path.to_owned(),
            run_number: number("run_number").filter(|n| (0..MOST_RUNS).contains(n)).map_or(0, i64::unsigned_abs),
            started_ns: number("started_ns")?,
            run_id: metadata.get("run_id")?.clone(),
            segment: usize::try_from(number("shard")?).ok()?,
            index: u32::try_from(number("file_index")?).ok()?,
        })
    }
}

/// Whether a name is that of a recording, finished or not.
#[must_use]
pub fn is_recording(path: &Path) -> bool {
    let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    name.ends_with(".mcap") || name.ends_with(".mcap.part")
}

/// What a start found of earlier runs.
#[derive(Default)]
pub struct Restored {
    /// Memory by loop: alarms and gap watches, without the stream of points.
    pub memories: BTreeMap<String, Checkpoint>,
    /// The loops that had left the plant.
    pub left: BTreeSet<String>,
    /// The newest recording.
    newest: Option<PathBuf>,
    /// Runs that this store has noted.
    pub runs: OwnRuns,
    /// The store, if it could be opened.
    pub store: Option<StateStore>,
    /// Number of the run that begins now, from 1.
    pub run_number: u64,
    /// Recordings that an earlier run found complete, by name, with size and time of change.
    pub verified: BTreeMap<String, String>,
    /// What data health remembered.
    pub data_health: KeptHealth,
}

/// Memories of loops, by whether the loops are still there.
#[derive(Debug, Default)]
pub struct Memories {
    /// Of loops that continue.
    pub there: BTreeMap<String, Checkpoint>,
    /// Of loops that had left the plant with an active alarm, which is kept until they return.
    pub left: BTreeMap<String, Checkpoint>,
    /// Of loops that are no longer configured: their alarms end.
    pub removed: BTreeMap<String, Checkpoint>,
}

/// Which runs in a folder are this daemon's own. Recordings of another daemon may have been copied there.
#[derive(Debug, Clone, Default)]
pub struct OwnRuns {
    /// Their ids, oldest first.
    ids: Vec<String>,
    /// Number of runs counted by the store; 0 without a store that counts.
    counted: u64,
}

impl OwnRuns {
    /// Whether a run is this daemon's own, that is, noted in its store. Without a store any run may be.
    #[must_use]
    pub fn include(&self, file: &RunFile) -> bool {
        let is_counted = self.ids.is_empty() && file.run_number <= self.counted;
        self.counted == 0 || is_counted || self.ids.contains(&file.run_id)
    }

    /// The ids with this run added, as JSON for the store.
    fn and(&self, run_id: &str) -> Option<Vec<u8>> {
        let skipped = (self.ids.len() + 1).saturating_sub(RUNS_KEPT);
        let ids: Vec<&str> = self.ids.iter().map(String::as_str).chain([run_id]).skip(skipped).collect();
        to_json(&ids)
    }
}

/// What earlier runs under this prefix remembered. Never fails: what cannot be read becomes a fault. Everything is in the store
/// before this returns, so that a crash right afterwards loses nothing.
#[must_use]
pub fn restore(disk: &dyn Disk, dir: &Path, prefix: &str, faults: &Faults, metrics: &Metrics) -> Restored {
    let (store, stored) = match open_store(disk, dir, faults, metrics) {
        Ok((store, stored)) => (Some(store), stored),
        Err(why) => {
            faults.raise("state", format!("alarm states cannot be stored: {why}"));
            (None, Stored::default())
        }
    };
    let (mut memories, mut left) = (BTreeMap::new(), BTreeSet::new());
    let mut lost = stored.damaged;
    for (key, json) in &stored.values {
        let Some(name) = loop_of(prefix, key) else { continue };
        match serde_json::from_slice::<StateDocument>(json) {
            Ok(state) => {
                left.extend(state.left.then(|| name.to_owned()));
                memories.insert(name.to_owned(), Checkpoint { stream: None, ..state.checkpoint });
            }
            Err(_) => lost += 1,
        }
    }
    let from_store = memories.len();
    // A store created during a run holds only what has changed since; one completed at a start holds everything.
    let is_sealed = stored.values.contains_key(prefix);
    let is_whole = from_store > 0 && is_sealed && lost == 0;
    let number = |json: &Vec<u8>| std::str::from_utf8(json).ok()?.parse::<u64>().ok();
    let counted = stored.values.get(prefix).and_then(number).unwrap_or(0);
    let ids = stored.values.get(&key_of_runs(prefix)).and_then(|json| serde_json::from_slice(json).ok());
    let runs = OwnRuns { ids: ids.unwrap_or_default(), counted };
    let mut files = recordings_in(dir, prefix, is_whole, metrics);
    files.retain(|file| runs.include(file));
    if !is_whole {
        for (name, (memory, has_left)) in memories_in_recordings(&files, prefix) {
            if let Entry::Vacant(place) = memories.entry(name) {
                left.extend(has_left.then(|| place.key().clone()));
                place.insert(memory);
            }
        }
    }
    if lost > 0 {
        metrics.states_damaged.inc_by(lost as u64);
        let text =
            format!("{lost} stored alarm states were damaged: taken from the recordings as far as these hold them");
        faults.raise_for("store damaged", text, LOSS_SHOWN);
    }
    let seen = files.iter().map(|f| f.run_number).max().unwrap_or(0);
    let run_number = counted.max(seen) + 1;
    tracing::info!(loops = memories.len(), from_store, run_number, "states carried over");
    let text = |json: &Vec<u8>| String::from_utf8_lossy(json).into_owned();
    let verified = stored.values.iter().filter_map(|(key, json)| Some((verified_of(key)?.to_owned(), text(json))));
    let kept = stored.values.get(&key_of_data_health(prefix));
    let data_health = kept.and_then(|json| serde_json::from_slice(json).ok()).unwrap_or_default();
    let (verified, newest) = (verified.collect(), files.pop().map(|file| file.path));
    let mut restored = Restored { memories, left, newest, runs, store, run_number, verified, data_health };
    restored.seal(prefix, is_whole, faults);
    restored
}

/// How long a loss that has ended remains among the faults.
pub const LOSS_SHOWN: std::time::Duration = std::time::Duration::from_secs(3600);

impl Restored {
    /// The loops' memories, sorted by what the configuration makes of the loops. Loops of other shards are left out.
    pub fn take_memories(&mut self, config: &Config) -> Memories {
        let named: HashSet<&str> = config.loops.iter().map(|l| l.name.as_str()).collect();
        let named_before = self.named_before(&config.hash());
        let mut memories = Memories::default();
        for (name, memory) in mem::take(&mut self.memories).into_iter().filter(|(name, _)| config.shard.owns(name)) {
            let is_removed = !named.contains(&*name) && (!config.input.discover || named_before.contains(&name));
            let of = match (is_removed, self.left.contains(&name)) {
                (true, _) => &mut memories.removed,
                (false, true) => &mut memories.left,
                (false, false) => &mut memories.there,
            };
            of.insert(name, memory);
        }
        memories
    }

    /// The loops named in the newest recording's configuration, if that differs from the current one.
    fn named_before(&self, hash: &str) -> HashSet<String> {
        let named = |path: &PathBuf| {
            let reader = RecordingReader::open(path).ok()?;
            let is_other = reader.metadata().get("config_hash").is_some_and(|before| before != hash);
            let before = is_other.then(|| RunMetadata::of(path, reader.metadata()).ok()).flatten()?;
            Some(before.config.loops.into_iter().map(|l| l.name).collect())
        };
        self.newest.as_ref().and_then(named).unwrap_or_default()
    }

    /// Notes a run in the store before it records anything.
    pub fn note_run(&mut self, prefix: &str, run_id: &str) {
        let Some(runs) = self.runs.and(run_id) else { return };
        let Some(store) = self.store.take() else { return };
        // After an error the state writer reopens it.
        self.store = store.save([(key_of_runs(prefix).as_str(), runs.as_slice())]).is_ok().then_some(store);
    }

    /// Stores everything that is not in the store yet, before the run begins.
    fn seal(&mut self, prefix: &str, is_whole: bool, faults: &Faults) {
        let Some(store) = self.store.take() else { return };
        let missing = if is_whole { None } else { Some(&self.memories) };
        let states = missing.into_iter().flatten().filter_map(|(name, memory)| {
            let left = self.left.contains(name);
            let state = StateDocument { left, ..StateDocument::new(name, None, memory.clone()) };
            Some((key_of(prefix, name), to_json(&state)?))
        });
        let number = (prefix.to_owned(), self.run_number.to_string().into_bytes());
        let values: Vec<(String, Vec<u8>)> = states.chain([number]).collect();
        match store.save(values.iter().map(|(k, v)| (k.as_str(), v.as_slice()))) {
            Ok(()) => self.store = Some(store),
            Err(error) => faults.raise("state", format!("alarm states cannot be stored: {error}")),
        }
    }
}

/// The recordings of this prefix; only the newest if they need only show which run was the last. Files that are no recordings
/// are renamed.
fn recordings_in(dir: &Path, prefix: &str, newest_alone: bool, metrics: &Metrics) -> Vec<RunFile> {
    let mut files = Vec::new();
    let entries = fs::read_dir(dir).into_iter().flatten().flatten();
    let mut paths: Vec<PathBuf> = entries.map(|e| e.path()).filter(|p| p.is_file() && is_recording(p)).collect();
    if newest_alone && paths.len() > NEWEST {
        // Two months of a hundred thousand loops make a hundred thousand files, so only the first bytes of the others are read.
        paths.sort_by_cached_key(|path| fs::metadata(path).and_then(|m| m.modified()).ok());
        for path in paths.drain(..paths.len() - NEWEST) {
            match InputKind::detect(&path) {
                Ok(InputKind::Mcap) => {}
                Err(FileError::Io { .. }) => tracing::warn!(file = %path.display(), "cannot be read and is left alone"),
                Ok(_) | Err(_) => put_aside(&path, metrics),
            }
        }
    }
    for path in paths {
        match RecordingReader::open(&path) {
            Ok(reader) if reader.metadata().get("prefix").is_some_and(|p| p == prefix) => {
                files.extend(RunFile::of(&path, reader.metadata()));
            }
            Ok(_) => {}
            Err(ReadError::NotMcap { .. }) => put_aside(&path, metrics),
            Err(error) => tracing::warn!(%error, "a recording cannot be read and is left alone"),
        }
    }
    files.sort_by(|a, b| {
        (a.run_number, a.started_ns, &a.run_id, a.segment, a.index).cmp(&(
            b.run_number,
            b.started_ns,
            &b.run_id,
            b.segment,
            b.index,
        ))
    });
    files
}

/// Opens a folder's store and reads it. A store that cannot be used is renamed and reported, and a new one is created.
///
/// # Errors
/// The reason why there is none now; a later attempt may succeed.
pub fn open_store(
    disk: &dyn Disk,
    dir: &Path,
    faults: &Faults,
    metrics: &Metrics,
) -> Result<(StateStore, Stored), String> {
    disk.create_folder(dir).map_err(|e| format!("{}: {e}", dir.display()))?;
    let path = dir.join(STORE_NAME);
    let open = || StateStore::open_on(disk, &path).and_then(|store| store.load().map(|stored| (store, stored)));
    let opened = open().or_else(|error| {
        if matches!(error, StoreError::Failed { .. }) {
            return Err(error);
        }
        put_aside(&path, metrics);
        let text = format!("{error}; it was renamed, and states come from the recordings or from memory");
        faults.raise_for("store broken", text, LOSS_SHOWN);
        open()
    });
    opened.map_err(|e| e.to_string())
}

/// Memory by loop name, and whether the loop had left the plant.
type Found = BTreeMap<String, (Checkpoint, bool)>;

/// The newest memory of every loop in the latest runs.
fn memories_in_recordings(files: &[RunFile], prefix: &str) -> Found {
    let mut memories = BTreeMap::new();
    for run in files.chunk_by(|a, b| a.run_id == b.run_id).rev().take(RUNS) {
        let mut of_run = BTreeMap::new();
        for segment in run.chunk_by(|a, b| a.segment == b.segment) {
            for file in &segment[segment.len().saturating_sub(FILES_PER_SEGMENT)..] {
                if let Err(error) = read_states(&file.path, prefix, &mut of_run) {
                    tracing::warn!(%error, "states could not be read to the end");
                }
            }
        }
        for (name, memory) in of_run {
            memories.entry(name).or_insert(memory);
        }
    }
    memories
}

fn read_states(path: &Path, prefix: &str, memories: &mut Found) -> Result<(), ReadError> {
    let mut reader = RecordingReader::open(path)?;
    while let Some(item) = reader.next_item()? {
        let Item::Message(message) = item else { continue };
        let Some(topic) = Topic::parse(Some(prefix), message.topic()) else { continue };
        if topic.leaf == Leaf::Document(Kind::State)
            && let Ok(state) = serde_json::from_slice::<StateDocument>(message.data)
        {
            memories.insert(state.loop_name, (Checkpoint { stream: None, ..state.checkpoint }, false));
        } else if topic.leaf == Leaf::Document(Kind::Input)
            && let Some(memory) = memories.get_mut(topic.loop_name)
            && matches!(serde_json::from_slice(message.data), Ok(RecordedInput::Forget))
        {
            memory.1 = memory.0.alarm.shown() != State::Normal;
        }
    }
    Ok(())
}

/// Renames a file that cannot be used; an empty one is deleted.
fn put_aside(path: &Path, metrics: &Metrics) {
    if fs::metadata(path).is_ok_and(|m| m.len() == 0) {
        // Cut off before its first byte reached the disk, so deleting it loses nothing.
        let _ = fs::remove_file(path);
        return;
    }
    let mut aside = path.as_os_str().to_owned();
    aside.push(ASIDE);
    metrics.quarantined.inc();
    match fs::rename(path, &aside) {
        Ok(()) => tracing::warn!(file = %path.display(), "not a recording; renamed to .broken"),
        Err(error) => tracing::warn!(file = %path.display(), %error, "not a recording, and cannot be renamed"),
    }
}

/// Reports the renamed broken files until somebody moves them away.
pub fn report_aside(dir: &Path, faults: &Faults) {
    let entries = fs::read_dir(dir).into_iter().flatten().flatten();
    let aside: Vec<String> =
        entries.map(|e| e.file_name().to_string_lossy().into_owned()).filter(|name| name.ends_with(ASIDE)).collect();
    match aside.iter().min() {
        None => faults.clear("aside"),
        Some(first) => {
            let (n, dir) = (aside.len(), dir.display());
            let remedy = "look at them, then move them elsewhere";
            faults.raise("aside", format!("{n} broken files are in {dir}, such as {first}: {remedy}"));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use stiction_engine::codec::topic;
    use stiction_files::RecordingFile;
    use stiction_files::disk::SystemDisk;

    fn state(name: &str, raised: bool) -> Vec<u8> {
        let text = if raised { r#""unack","active":true"# } else { r#""normal","active":false"# };
        let alarm = format!(
            r#"{{"state":{text},"history_for":7,"history_against":0,"class":null,"worse_windows":0,"raised_ns":5,"window_end_ns":5}}"#
        );
        format!(r#"{{"schema":"s","loop":"{name}","window_end_ns":null,"alarm":{alarm},"stream":null}}"#).into_bytes()
    }

    fn record(dir: &Path, number: u64, started_ns: i64, states: &[(&str, bool)]) {
        let run = format!("r{number}-{started_ns}");
        let pairs = [
            ("prefix", "p".to_owned()),
            ("run_id", run.clone()),
            ("run_number", number.to_string()),
            ("started_ns", started_ns.to_string()),
            ("shard", "0".to_owned()),
            ("file_index", "0".to_owned()),
        ];
        let metadata = pairs.into_iter().map(|(k, v)| (k.to_owned(), v)).collect();
        let mut file = RecordingFile::create(dir, &run, &metadata).unwrap();
        for (name, raised) in states {
            file.write(&topic::result("p", name, Kind::State), Kind::State, 1, 1, &state(name, *raised)).unwrap();
        }
        file.flush().unwrap();
    }

    fn raised(restored: &Restored) -> Vec<&str> {
        let active = restored.memories.iter().filter(|(_, memory)| memory.alarm.active);
        active.map(|(name, _)| name.as_str()).collect()
    }

    fn start(dir: &Path) -> Restored {
        restore(&SystemDisk, dir, "p", &Faults::default(), &Metrics::default())
    }

    #[test]
    fn a_run_number_that_no_folder_can_have_makes_no_run_the_newest() {
        let dir = tempfile::tempdir().unwrap();
        record(dir.path(), 3, 100, &[("A", true)]);
        record(dir.path(), u64::MAX, 200, &[("A", false)]);
        record(dir.path(), i64::MAX as u64, 300, &[("A", false)]);
        let first = start(dir.path());
        assert_eq!((raised(&first), first.run_number), (vec!["A"], 4));
    }

    #[test]
    fn a_run_that_ended_before_its_states_were_written_hides_nothing() {
        let dir = tempfile::tempdir().unwrap();
        record(dir.path(), 1, 100, &[("A", true), ("B", true)]);
        record(dir.path(), 2, 200, &[("B", false)]);
        record(dir.path(), 3, 300, &[]);
        let first = start(dir.path());
        assert_eq!((raised(&first), first.run_number), (vec!["A"], 4));
        drop(first);
        // The store now holds everything, so the recordings can go.
        for entry in fs::read_dir(dir.path()).unwrap().flatten().filter(|e| is_recording(&e.path())) {
            fs::remove_file(entry.path()).unwrap();
        }
        let second = start(dir.path());
        assert_eq!((raised(&second), second.run_number), (vec!["A"], 5));
    }

    #[test]
    fn a_store_that_was_begun_anew_under_a_run_hides_nothing_of_the_recordings() {
        let dir = tempfile::tempdir().unwrap();
        record(dir.path(), 1, 100, &[("A", true), ("B", true)]);
        let (store, _) = open_store(&SystemDisk, dir.path(), &Faults::default(), &Metrics::default()).unwrap();
        store.save([(key_of("p", "B").as_str(), state("B", false).as_slice())]).unwrap();
        drop(store);
        assert_eq!(raised(&start(dir.path())), ["A"], "B's is newer in the store");
    }

    #[test]
    fn a_run_under_a_clock_that_was_ahead_is_not_the_newest_for_ever() {
        let dir = tempfile::tempdir().unwrap();
        record(dir.path(), 1, 9_000, &[("A", false)]);
        record(dir.path(), 2, 100, &[("A", true)]);
        assert_eq!(raised(&start(dir.path())), ["A"]);
    }

    #[test]
    fn a_store_that_was_cut_or_flipped_anywhere_is_read_or_begun_anew_and_takes_states_again() {
        let dir = tempfile::tempdir().unwrap();
        record(dir.path(), 1, 100, &[("A", true), ("B", true)]);
        drop(start(dir.path()));
        let path = dir.path().join(STORE_NAME);
        let whole = fs::read(&path).unwrap();
        for k in 0..160_usize {
            let mut bytes = whole.clone();
            if k % 4 == 0 {
                bytes.truncate(whole.len() * k / 160);
            } else {
                // Most of the file is free space: three of four flips hit its first pages, where the data are.
                let span = if k % 4 == 1 { whole.len() } else { 32_768.min(whole.len()) };
                let bit = k.wrapping_mul(7_919_113) % (8 * span);
                bytes[bit / 8] ^= 1 << (bit % 8);
            }
            fs::write(&path, &bytes).unwrap();
            let restored = start(dir.path());
            assert_eq!(raised(&restored), ["A", "B"], "{k}");
            restored.store.expect("a store").save([("p\nC", b"1".as_slice())]).unwrap();
            let again = StateStore::open(&path).unwrap().load().unwrap();
            assert!(again.values.contains_key("p\nC"), "{k}");
        }
    }

    #[test]
    fn a_broken_store_is_put_aside_and_named_until_it_is_taken_away() {
        let dir = tempfile::tempdir().unwrap();
        record(dir.path(), 1, 100, &[("A", true)]);
        fs::write(dir.path().join(STORE_NAME), vec![7_u8; 5000]).unwrap();
        fs::write(dir.path().join("x.mcap"), b"no recording").unwrap();
        let (faults, metrics) = (Faults::default(), Metrics::default());
        let restored = restore(&SystemDisk, dir.path(), "p", &faults, &metrics);
        assert!(restored.store.is_some());
        assert_eq!((raised(&restored), metrics.quarantined.get()), (vec!["A"], 2));
        report_aside(dir.path(), &faults);
        assert!(faults.list().iter().any(|f| f.contains("2 broken files")), "{:?}", faults.list());
        for name in [format!("{STORE_NAME}{ASIDE}"), format!("x.mcap{ASIDE}")] {
            fs::remove_file(dir.path().join(name)).unwrap();
        }
        report_aside(dir.path(), &faults);
        assert!(!faults.list().iter().any(|f| f.contains("aside in")), "{:?}", faults.list());
    }
}
