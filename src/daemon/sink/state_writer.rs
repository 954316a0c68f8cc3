//! Stores every loop's memory (alarm, acknowledgement, gap watch) beside the recordings, and notes which recordings were found
//! complete.
//!
//! Its thread holds only the newest state of each loop, so the number of loops bounds its queue; states that come together form
//! one transaction. A state is stored only after the documents that were handed over for receivers before it, so that no stored
//! state implies a document that was lost. A command is answered only when both are stored. While the disk refuses, states
//! wait, commands get that as their answer, and a fault is raised; nothing else stops.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use super::mark::Mark;
use crate::daemon::startup_state::memory::open_store;
use crate::runtime::faults::Faults;
use crate::runtime::metrics::Metrics;
use stiction_files::disk::Disk;
use stiction_files::store::{STORE_NAME, StateStore, key_of, key_of_data_health, key_of_verified};

/// How long the states of windows wait for others to join the transaction.
const GATHER: Duration = Duration::from_millis(200);
/// Pause after an error before the store is tried again.
const RETRY: Duration = Duration::from_secs(2);
/// How long a caller waits for the disk before the reply says that it does not respond.
const LATE: Duration = Duration::from_secs(3);
/// Name of its fault.
const FAULT: &str = "state";

/// Called once the state is on disk, or with the reason why it is not.
pub type Kept = Box<dyn FnOnce(Result<(), String>) + Send>;

/// A caller who waits for the disk.
struct Waiter {
    /// Number of this waiter among all so far.
    number: u64,
    since: Instant,
    kept: Kept,
}

/// Newest value of each key; `None` to delete it.
type States = BTreeMap<String, Option<Vec<u8>>>;

#[derive(Default)]
struct Pending {
    states: States,
    waiters: Vec<Waiter>,
    /// Number of waiters so far.
    asked: u64,
    /// Number of the newest document handed over before these states.
    after: u64,
    closed: bool,
}

/// States of one transaction.
struct Batch {
    states: States,
    /// Number of the last waiter for it.
    asked: u64,
    after: u64,
    is_last: bool,
}

impl Pending {
    fn take(&mut self) -> Batch {
        Batch { states: std::mem::take(&mut self.states), asked: self.asked, after: self.after, is_last: self.closed }
    }
}

#[derive(Default)]
struct Shared {
    /// Progress of the document store.
    mark: Mark,
    pending: Mutex<Pending>,
    wake: Condvar,
    /// The store was deleted, so every loop's state is needed again.
    wants_all: AtomicBool,
}

/// The engine's end.
pub struct StateWriter {
    shared: Arc<Shared>,
    prefix: String,
}

impl Drop for StateWriter {
    fn drop(&mut self) {
        self.shared.pending.lock().unwrap_or_else(PoisonError::into_inner).closed = true;
        self.shared.wake.notify_one();
    }
}

impl StateWriter {
    /// Starts the thread, which ends once the writer is dropped and all states are stored or cannot be. `store` is passed if it
    /// is already open; `mark` tracks the document store.
    ///
    /// # Errors
    /// The system refuses a thread.
    pub fn start(
        dir: &Path,
        prefix: &str,
        (store, mark): (Option<StateStore>, Mark),
        disk: Arc<dyn Disk>,
        faults: Arc<Faults>,
        metrics: Arc<Metrics>,
    ) -> std::io::Result<(Self, JoinHandle<()>)> {
        let (state_writer, mut worker) = Self::pair(dir, prefix, (store, mark), disk, faults, metrics);
        let thread = std::thread::Builder::new().name("state".into()).spawn(move || worker.run())?;
        Ok((state_writer, thread))
    }

    /// Both ends without a thread: the caller decides when the other end works.
    #[must_use]
    pub fn pair(
        dir: &Path,
        prefix: &str,
        (store, mark): (Option<StateStore>, Mark),
        disk: Arc<dyn Disk>,
        faults: Arc<Faults>,
        metrics: Arc<Metrics>,
    ) -> (Self, Worker) {
        let shared = Arc::new(Shared { mark, ..Shared::default() });
        let worker = Worker { path: dir.join(STORE_NAME), store, disk, shared: shared.clone(), faults, metrics };
        (Self { shared, prefix: prefix.to_owned() }, worker)
    }

    /// Stores a loop's state soon.
    pub fn keep(&self, loop_name: &str, json: Vec<u8>) {
        self.put(loop_name, Some(json), None);
    }

    /// A loop has left the plant: deletes its state.
    pub fn forget(&self, loop_name: &str) {
        self.put(loop_name, None, None);
    }

    /// Stores a state at once; `kept` is called when it is on disk.
    pub fn keep_then(&self, loop_name: &str, json: Vec<u8>, now: Instant, kept: Kept) {
        self.put(loop_name, Some(json), Some((now, kept)));
    }

    /// Tells those who have waited long that the disk does not respond.
    pub fn reply_late(&self, now: Instant) {
        let is_late = |waiter: &Waiter| now.saturating_duration_since(waiter.since) >= LATE;
        for waiter in self.shared.take_waiters(is_late) {
            let s = now.saturating_duration_since(waiter.since).as_secs();
            (waiter.kept)(Err(format!("the disk has not answered for {s} s")));
        }
    }

    /// A handle for notes about recordings and data health.
    #[must_use]
    pub fn notes(&self) -> Notes {
        Notes(self.shared.clone())
    }

    /// Whether every loop's state must be stored again; true only once.
    #[must_use]
    pub fn wants_all(&self) -> bool {
        self.shared.wants_all.swap(false, Ordering::Relaxed)
    }

    fn put(&self, loop_name: &str, json: Option<Vec<u8>>, kept: Option<(Instant, Kept)>) {
        self.shared.put(key_of(&self.prefix, loop_name), json, kept);
    }
}

impl Shared {
    /// Removes and returns the waiters that satisfy the condition.
    fn take_waiters(&self, is_so: impl Fn(&Waiter) -> bool) -> Vec<Waiter> {
        let mut pending = self.pending.lock().unwrap_or_else(PoisonError::into_inner);
        let (taken, left) = std::mem::take(&mut pending.waiters).into_iter().partition(is_so);
        pending.waiters = left;
        taken
    }

    fn put(&self, key: String, json: Option<Vec<u8>>, kept: Option<(Instant, Kept)>) {
        let mut pending = self.pending.lock().unwrap_or_else(PoisonError::into_inner);
        pending.states.insert(key, json);
        pending.after = self.mark.handed();
        let urgent = kept.is_some();
        if let Some((since, kept)) = kept {
            pending.asked += 1;
            let number = pending.asked;
            pending.waiters.push(Waiter { number, since, kept });
        }
        let first = pending.states.len() == 1;
        drop(pending);
        if urgent || first {
            self.wake.notify_one();
        }
    }
}

/// Notes in the same store: about recordings found complete, and about data health.
pub struct Notes(Arc<Shared>);

impl Notes {
    /// A recording was found complete; `look` identifies its state.
    pub fn verified(&self, file: &str, look: &str) {
        self.0.put(key_of_verified(file), Some(look.into()), None);
    }

    /// What data health remembers for a prefix.
    pub fn data_health(&self, prefix: &str, json: Vec<u8>) {
        self.0.put(key_of_data_health(prefix), Some(json), None);
    }

    /// A recording no longer exists.
    pub fn forget_verified(&self, file: &str) {
        self.0.put(key_of_verified(file), None, None);
    }
}

/// The end that writes, on its thread.
pub struct Worker {
    path: PathBuf,
    store: Option<StateStore>,
    disk: Arc<dyn Disk>,
    shared: Arc<Shared>,
    faults: Arc<Faults>,
    metrics: Arc<Metrics>,
}

impl Worker {
    fn run(&mut self) {
        loop {
            let batch = self.next();
            let is_last = batch.is_last;
            let documents = self.shared.mark.wait(batch.after);
            let saved = self.settle(batch, &documents);
            if is_last {
                return;
            }
            if !saved {
                self.pause();
            }
        }
    }

    /// Stores what waits now, without waiting for more; true if it could. States that follow unstored documents wait for the
    /// next turn.
    pub fn turn(&mut self) -> bool {
        let mut pending = self.shared.pending.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(documents) = self.shared.mark.look(pending.after) else { return true };
        let batch = pending.take();
        drop(pending);
        self.settle(batch, &documents)
    }

    /// Number of waiting states.
    #[must_use]
    pub fn waiting(&self) -> usize {
        self.shared.pending.lock().unwrap_or_else(PoisonError::into_inner).states.len()
    }

    /// Stores states and replies to those who wait for them, including what happened to the documents before them.
    fn settle(&mut self, Batch { states, asked, .. }: Batch, documents: &Result<(), String>) -> bool {
        let saved = if states.is_empty() { self.reopen() } else { self.save(&states) };
        match &saved {
            Ok(()) => self.faults.clear(FAULT),
            Err(why) => {
                self.metrics.state_errors.inc();
                self.faults.raise(FAULT, format!("alarm states cannot be stored: {why}"));
                self.put_back(states);
            }
        }
        for waiter in self.shared.take_waiters(|waiter| waiter.number <= asked) {
            (waiter.kept)(saved.clone().and_then(|()| documents.clone()));
        }
        saved.is_ok()
    }

    /// Waits for states, then a little for more, unless a caller waits for a reply.
    fn next(&self) -> Batch {
        let idle_still = |p: &Pending| p.states.is_empty() && !p.closed;
        let idle = |p: &mut Pending| idle_still(p);
        let pending = self.shared.pending.lock().unwrap_or_else(PoisonError::into_inner);
        let pending = if self.store.is_some() {
            self.shared.wake.wait_while(pending, idle).unwrap_or_else(PoisonError::into_inner)
        } else {
            // Tries again to open a failed store even without new states: otherwise its fault would outlast its cause.
            let waited = self.shared.wake.wait_timeout_while(pending, RETRY, idle);
            waited.unwrap_or_else(PoisonError::into_inner).0
        };
        if idle_still(&pending) {
            return Batch { states: BTreeMap::new(), asked: 0, after: 0, is_last: false };
        }
        let gathering = |p: &mut Pending| p.waiters.is_empty() && !p.closed;
        let (mut pending, _) =
            self.shared.wake.wait_timeout_while(pending, GATHER, gathering).unwrap_or_else(PoisonError::into_inner);
        pending.take()
    }

    /// Opens the store if it is not open.
    fn reopen(&mut self) -> Result<(), String> {
        if self.store.is_none() {
            self.store = Some(self.open()?);
        }
        Ok(())
    }

    /// Opens the store. If it is new, every loop's state is requested again.
    fn open(&self) -> Result<StateStore, String> {
        let folder = self.path.parent().unwrap_or_else(|| Path::new("."));
        let (store, _) = open_store(self.disk.as_ref(), folder, &self.faults, &self.metrics)?;
        self.shared.wants_all.store(true, Ordering::Relaxed);
        Ok(store)
    }

    fn save(&mut self, states: &States) -> Result<(), String> {
        // Deleting the folder deletes the open store's file, and later writes would be lost.
        if self.store.as_ref().is_some_and(|store| !store.is_linked()) {
            self.store = None;
        }
        let store = match self.store.take() {
            Some(store) => store,
            None => self.open()?,
        };
        let kept = states.iter().filter_map(|(key, json)| Some((key.as_str(), json.as_ref()?.as_slice())));
        let gone = states.iter().filter(|(_, json)| json.is_none()).map(|(key, _)| key.as_str());
        store.change(kept, gone).map_err(|e| e.to_string())?;
        self.metrics.states_stored.inc_by(states.len() as u64);
        // On an error above, it is reopened next time.
        self.store = Some(store);
        Ok(())
    }

    /// Keeps states that could not be stored, unless newer ones have come.
    fn put_back(&self, states: States) {
        let mut pending = self.shared.pending.lock().unwrap_or_else(PoisonError::into_inner);
        for (key, json) in states {
            pending.states.entry(key).or_insert(json);
        }
    }

    /// Waits before the next attempt; a caller who waits is served at once.
    fn pause(&self) {
        let calm = |p: &mut Pending| p.waiters.is_empty() && !p.closed;
        let pending = self.shared.pending.lock().unwrap_or_else(PoisonError::into_inner);
        drop(self.shared.wake.wait_timeout_while(pending, RETRY, calm));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use stiction_files::disk::SystemDisk;
    use stiction_files::lock::{FolderLock, LockedDisk, SharedLock};

    fn state_writer(dir: &Path) -> (StateWriter, JoinHandle<()>, Arc<Faults>) {
        let faults = Arc::new(Faults::default());
        let (state_writer, thread) =
            StateWriter::start(dir, "p", (None, Mark::default()), Arc::new(SystemDisk), faults.clone(), Arc::default())
                .unwrap();
        (state_writer, thread, faults)
    }

    fn asked(state_writer: &StateWriter, json: &str) -> Result<(), String> {
        let (reply, answered) = std::sync::mpsc::channel();
        state_writer.keep_then("A", json.into(), Instant::now(), Box::new(move |kept| reply.send(kept).unwrap()));
        answered.recv().unwrap()
    }

    #[test]
    fn an_answer_means_that_it_is_on_the_disk_and_the_newest_state_stands() {
        let dir = tempfile::tempdir().unwrap();
        let (state_writer, thread, faults) = state_writer(dir.path());
        state_writer.keep("B", b"1".to_vec());
        asked(&state_writer, "1").unwrap();
        asked(&state_writer, "2").unwrap();
        let copy = dir.path().join("copy");
        std::fs::copy(dir.path().join(STORE_NAME), &copy).unwrap();
        let stored = StateStore::open(&copy).unwrap().load().unwrap().values;
        assert_eq!((stored["p\nA"].as_slice(), stored["p\nB"].as_slice()), (b"2".as_slice(), b"1".as_slice()));
        assert!(faults.list().is_empty());
        drop(state_writer);
        thread.join().unwrap();
    }

    #[test]
    fn of_a_loop_that_has_left_nothing_is_kept() {
        let dir = tempfile::tempdir().unwrap();
        let (state_writer, thread, _) = state_writer(dir.path());
        state_writer.keep("B", b"1".to_vec());
        asked(&state_writer, "1").unwrap();
        state_writer.forget("B");
        asked(&state_writer, "2").unwrap();
        drop(state_writer);
        thread.join().unwrap();
        let stored = StateStore::open(&dir.path().join(STORE_NAME)).unwrap().load().unwrap().values;
        assert_eq!(stored.keys().collect::<Vec<_>>(), ["p\nA"]);
    }

    #[test]
    fn while_the_disk_refuses_people_are_told_and_nothing_is_forgotten() {
        let dir = tempfile::tempdir().unwrap();
        // A file in place of the folder.
        let place = dir.path().join("rec");
        std::fs::write(&place, b"").unwrap();
        let (state_writer, thread, faults) = state_writer(&place);
        assert!(asked(&state_writer, "1").is_err());
        assert_eq!(faults.list().len(), 1);
        state_writer.keep("B", b"7".to_vec());
        std::fs::remove_file(&place).unwrap();
        asked(&state_writer, "2").unwrap();
        drop(state_writer);
        thread.join().unwrap();
        assert!(faults.list().is_empty());
        let stored = StateStore::open(&place.join(STORE_NAME)).unwrap().load().unwrap().values;
        assert_eq!((stored["p\nA"].as_slice(), stored["p\nB"].as_slice()), (b"2".as_slice(), b"7".as_slice()));
    }

    #[test]
    fn a_folder_that_was_taken_away_is_made_again() {
        let dir = tempfile::tempdir().unwrap();
        let place = dir.path().join("rec");
        let (state_writer, thread, _) = state_writer(&place);
        asked(&state_writer, "1").unwrap();
        assert!(
            state_writer.wants_all() && !state_writer.wants_all(),
            "a store that was not there lacks what others may have held"
        );
        std::fs::remove_dir_all(&place).unwrap();
        asked(&state_writer, "2").unwrap();
        assert!(state_writer.wants_all() && !state_writer.wants_all());
        drop(state_writer);
        thread.join().unwrap();
        let stored = StateStore::open(&place.join(STORE_NAME)).unwrap().load().unwrap().values;
        assert_eq!(stored["p\nA"], b"2");
    }

    #[test]
    fn a_folder_that_was_moved_away_and_is_held_by_another_daemon_keeps_nothing() {
        let dir = tempfile::tempdir().unwrap();
        let place = dir.path().join("rec");
        std::fs::create_dir(&place).unwrap();
        let disk = Arc::new(LockedDisk::new(SharedLock::new(Some(FolderLock::take(&place).unwrap()))));
        let faults = Arc::new(Faults::default());
        let (state_writer, thread) =
            StateWriter::start(&place, "p", (None, Mark::default()), disk, faults.clone(), Arc::default()).unwrap();
        asked(&state_writer, "1").unwrap();
        std::fs::rename(&place, dir.path().join("moved")).unwrap();
        std::fs::create_dir(&place).unwrap();
        let other = FolderLock::take(&place).unwrap();
        let theirs = StateStore::open(&place.join(STORE_NAME)).unwrap();
        assert!(asked(&state_writer, "2").unwrap_err().contains("running daemon"));
        assert!(theirs.load().unwrap().values.is_empty() && faults.list().len() == 1);
        drop((theirs, other));
        asked(&state_writer, "3").unwrap();
        assert!(faults.list().is_empty());
        drop(state_writer);
        thread.join().unwrap();
    }
}
