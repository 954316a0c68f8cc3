//! Stores the documents that wait for receivers, so that a restart loses none.
//!
//! A document goes to its receivers once it is on disk. If the disk hangs it goes after a second, and if the disk refuses it
//! goes at once; it is stored as soon as the store accepts it.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use super::dead::{DEAD_LETTERS, DeadLetters};
use super::ledger::{Batch, Ledger, Letter, key_of};
use super::{Item, LOSS_SHOWN};
use crate::daemon::sink::mark::Mark;
use crate::daemon::startup_state::memory::ASIDE;
use crate::runtime::faults::Faults;
use crate::runtime::metrics::Metrics;
use stiction_files::disk::Disk;
use stiction_files::store::{OUTBOX_NAME, StateStore, StoreError, Stored};

/// Pause after a disk error.
const RETRY: Duration = Duration::from_secs(2);
/// Name of its fault.
const FAULT: &str = "outbox";

/// The thread that writes the store.
pub(super) struct Keep {
    path: PathBuf,
    disk: Arc<dyn Disk>,
    store: Option<StateStore>,
    ledger: Arc<Ledger>,
    mark: Mark,
    dead: DeadLetters,
    /// Whether the queues have received what an earlier run left.
    taken_over: bool,
    faults: Arc<Faults>,
    metrics: Arc<Metrics>,
}

impl Drop for Keep {
    fn drop(&mut self) {
        // So that nobody waits for a thread that has ended.
        self.mark.close();
    }
}

impl Keep {
    /// Opens the store, and passes what an earlier run left there to its queues.
    pub fn open(
        dir: &Path,
        disk: Arc<dyn Disk>,
        ledger: Arc<Ledger>,
        mark: Mark,
        faults: Arc<Faults>,
        metrics: Arc<Metrics>,
    ) -> Self {
        let (path, dead) = (dir.join(OUTBOX_NAME), DeadLetters::new(dir));
        let mut keep = Self { path, disk, store: None, ledger, mark, dead, taken_over: false, faults, metrics };
        keep.turn();
        keep
    }

    /// Works until the ledger is closed.
    pub fn run(&mut self) {
        loop {
            // A store that is not open may hold waiting documents, so try again even if nothing new comes.
            let pause = self.store.is_none().then_some(RETRY);
            let batch = self.ledger.take_within(pause);
            let is_last = batch.is_last;
            if is_last {
                self.close_queues();
            }
            self.write(batch);
            if is_last {
                return;
            }
        }
    }

    /// Ends the receivers' threads.
    pub fn close_queues(&self) {
        self.ledger.queues.iter().for_each(|queue| queue.close());
    }

    /// Writes what waits now, without waiting for more.
    pub fn turn(&mut self) {
        let batch = self.ledger.take();
        self.write(batch);
    }

    /// Drops the store, as after a disk error.
    #[cfg(test)]
    pub fn forget_store(&mut self) {
        self.store = None;
    }

    /// Whether the store holds exactly the waiting documents.
    pub fn is_stored(&self) -> bool {
        self.ledger.is_stored()
    }

    fn write(&mut self, mut batch: Batch) {
        // Deleting the folder deletes the open store's file, and later writes would be lost.
        if self.store.as_ref().is_some_and(|store| !store.is_linked()) {
            self.store = None;
        }
        for letter in std::mem::take(&mut batch.letters) {
            batch.gone.insert(key_of(&letter.queue, letter.seq));
            self.append(&letter);
        }
        match self.save(&mut batch) {
            Ok(()) => {
                self.faults.clear(FAULT);
                self.ledger.stored(&batch);
            }
            Err(why) => {
                self.store = None;
                self.faults.raise(FAULT, why.as_str());
                self.ledger.refused(batch, &why);
            }
        }
    }

    fn save(&mut self, batch: &mut Batch) -> Result<(), String> {
        let store = match self.store.take() {
            Some(store) => store,
            None => self.reopen(batch)?,
        };
        if !batch.puts.is_empty() || !batch.gone.is_empty() {
            let json = |item: &Arc<Item>| serde_json::to_vec(item.as_ref()).unwrap_or_default();
            let puts: Vec<(&str, Vec<u8>)> = batch.puts.iter().map(|(key, item)| (key.as_str(), json(item))).collect();
            let puts = puts.iter().map(|(key, json)| (*key, json.as_slice()));
            store.change(puts, batch.gone.iter().map(String::as_str)).map_err(|e| e.to_string())?;
        }
        self.store = Some(store);
        Ok(())
    }

    /// Opens the store. Whatever happened to it meanwhile, afterwards it holds exactly the waiting documents together with this
    /// batch.
    fn reopen(&mut self, batch: &mut Batch) -> Result<StateStore, String> {
        let opened = match StateStore::open_on(self.disk.as_ref(), &self.path) {
            Err(StoreError::Broken { why, .. }) => {
                let mut aside = self.path.clone().into_os_string();
                aside.push(ASIDE);
                self.disk.rename(&self.path, Path::new(&aside)).map_err(|e| format!("{}: {e}", self.path.display()))?;
                self.metrics.quarantined.inc();
                let lost = if self.taken_over { "" } else { ", documents that waited there are lost" };
                let text = format!("{}: {why}; put aside{lost}", self.path.display());
                self.faults.raise_for("outbox broken", text, LOSS_SHOWN);
                StateStore::open_on(self.disk.as_ref(), &self.path)
            }
            opened => opened,
        };
        let cannot = |e: StoreError| format!("documents that wait for receivers cannot be kept: {e}");
        let store = opened.map_err(cannot)?;
        let stored = store.load().map_err(cannot)?;
        if self.taken_over {
            self.compare(&stored, batch);
        } else {
            self.take_over(stored, batch);
        }
        Ok(store)
    }

    /// Takes over what an earlier run left. Documents for receivers that are no longer configured are dropped, as nothing would
    /// ever take them.
    fn take_over(&mut self, stored: Stored, batch: &mut Batch) {
        self.taken_over = true;
        let mut dropped = stored.damaged as u64;
        for (key, json) in stored.values {
            let place = key.split_once('\n').and_then(|(name, seq)| Some((name, seq.parse::<u64>().ok()?)));
            let item = serde_json::from_slice::<Item>(&json).ok();
            let queue = place.and_then(|(name, _)| self.ledger.queues.iter().find(|q| q.name == name));
            if let (Some((_, seq)), Some(item), Some(queue)) = (place, item, queue) {
                self.ledger.take_over(queue, seq, Arc::new(item));
            } else {
                dropped += 1;
                batch.gone.insert(key);
            }
        }
        if dropped > 0 {
            self.metrics.delivery_dropped.inc_by(dropped);
            tracing::warn!(dropped, "documents that waited for receivers no longer named, or damaged ones");
        }
    }

    /// Adds to the batch what the store lacks of the queues, and removes what it should no longer hold: the store may be a new
    /// one, or an error may have hidden whether the last change was written.
    fn compare(&self, stored: &Stored, batch: &mut Batch) {
        let waiting = self.ledger.queues.iter().flat_map(|queue| {
            queue.all().into_iter().map(|(seq, item)| (key_of(&queue.name, seq), item)).collect::<Vec<_>>()
        });
        let mut too_much: BTreeSet<&String> = stored.values.keys().collect();
        for (key, item) in waiting {
            if !too_much.remove(&key) {
                batch.puts.entry(key).or_insert(item);
            }
        }
        let unburied = self.ledger.unburied();
        batch.gone.extend(too_much.into_iter().filter(|key| !unburied.contains(key)).cloned());
        batch.gone.retain(|key| stored.values.contains_key(key));
    }

    /// Puts a document into the dead-letter file.
    fn append(&self, Letter { queue, item, attempts, why, .. }: &Letter) {
        let kept = match self.dead.append(queue, item, *attempts, why) {
            Ok(()) => format!("it is in {DEAD_LETTERS}"),
            Err(error) => format!("{DEAD_LETTERS} could not be written: {error}"),
        };
        self.metrics.delivery_refused.inc();
        let text = format!("{queue} refused {} {} of {} for good; {kept}: {why}", item.kind, item.id, item.loop_name);
        self.faults.raise_for(&format!("refused by {queue}"), text, LOSS_SHOWN);
    }
}
