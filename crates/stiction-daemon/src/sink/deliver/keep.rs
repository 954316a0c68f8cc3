//! Keeps what waits for receivers in a store, and gives it to their queues once it is on the disk.
//!
//! While the disk refuses, documents are sent all the same and put into the store as soon as it takes them.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use crossbeam_channel::{never, select};

use super::queue::Queue;
use super::{Inputs, Item, LOSS_SHOWN};
use crate::restore::ASIDE;
use stiction_files::disk::Disk;
use stiction_files::store::{OUTBOX_NAME, StateStore, StoreError, Stored};
use stiction_runtime::faults::Faults;
use stiction_runtime::metrics::Metrics;

/// Documents of one transaction.
const BATCH: usize = 256;
/// Pause after an error of the disk.
const RETRY: Duration = Duration::from_secs(2);
/// Name of its fault.
const FAULT: &str = "outbox";

/// A document that waits no longer.
pub(super) struct Change {
    pub queue: String,
    pub seq: u64,
}

/// The thread that keeps the store.
pub(super) struct Keep {
    path: PathBuf,
    disk: Arc<dyn Disk>,
    store: Option<StateStore>,
    queues: Vec<Arc<Queue>>,
    /// What the store lacks, and what it holds too much.
    puts: BTreeMap<String, Vec<u8>>,
    gone: BTreeSet<String>,
    /// Number of the next document: above those of every run before.
    next: u64,
    /// Whether the queues have what an earlier run left.
    taken_over: bool,
    faults: Arc<Faults>,
    metrics: Arc<Metrics>,
}

fn key_of(queue: &str, seq: u64) -> String {
    // Twenty digits hold every number, so keys sort as numbers do.
    format!("{queue}\n{seq:020}")
}

impl Keep {
    /// Opens the store and gives what an earlier run left there to its queues.
    pub fn open(
        dir: &Path,
        disk: Arc<dyn Disk>,
        first: u64,
        queues: Vec<Arc<Queue>>,
        faults: Arc<Faults>,
        metrics: Arc<Metrics>,
    ) -> Self {
        let path = dir.join(OUTBOX_NAME);
        let (puts, gone) = (BTreeMap::new(), BTreeSet::new());
        let mut keep =
            Self { path, disk, store: None, queues, puts, gone, next: first, taken_over: false, faults, metrics };
        if let Err(why) = keep.reopen() {
            keep.faults.raise(FAULT, why);
        }
        keep
    }

    fn reopen(&mut self) -> Result<(), String> {
        let opened = match StateStore::open_on(self.disk.as_ref(), &self.path) {
            Err(StoreError::Broken { why, .. }) => {
                let mut aside = self.path.clone().into_os_string();
                aside.push(ASIDE);
                self.disk.rename(&self.path, Path::new(&aside)).map_err(|e| format!("{}: {e}", self.path.display()))?;
                self.metrics.quarantined.inc();
                let text = format!("{}: {why}; put aside, documents that waited there are lost", self.path.display());
                self.faults.raise_for("outbox broken", text, LOSS_SHOWN);
                StateStore::open_on(self.disk.as_ref(), &self.path)
            }
            opened => opened,
        };
        let cannot = |e: StoreError| format!("documents that wait for receivers cannot be kept: {e}");
        let store = opened.map_err(cannot)?;
        if !self.taken_over {
            self.take_over(store.load().map_err(cannot)?);
        }
        self.store = Some(store);
        Ok(())
    }

    /// What an earlier run left. Documents of receivers that are no longer named are dropped: nobody would ever take them.
    fn take_over(&mut self, stored: Stored) {
        self.taken_over = true;
        let mut dropped = stored.damaged as u64;
        for (key, json) in stored.values {
            let place = key.split_once('\n').and_then(|(name, seq)| Some((name, seq.parse::<u64>().ok()?)));
            let item = serde_json::from_slice::<Item>(&json).ok();
            let queue = place.and_then(|(name, _)| self.queues.iter().find(|q| q.name == name));
            if let (Some((_, seq)), Some(item), Some(queue)) = (place, item, queue) {
                self.next = self.next.max(seq + 1);
                queue.push(seq, Arc::new(item));
            } else {
                dropped += 1;
                self.gone.insert(key);
            }
        }
        if dropped > 0 {
            self.metrics.delivery_dropped.inc_by(dropped);
            tracing::warn!(dropped, "documents that waited for receivers no longer named, or damaged ones");
        }
    }

    /// Works until no more can be handed over.
    pub fn run(&mut self, (handed, done): Inputs<'_>) {
        loop {
            // With everything stored there is nothing to try again; a store that is not open may hold what waits.
            let again =
                if self.is_stored() && self.store.is_some() { never() } else { crossbeam_channel::after(RETRY) };
            let mut fresh = Vec::new();
            let mut closed = false;
            select! {
                recv(handed) -> item => match item {
                    Ok(item) => fresh.push(item),
                    Err(_) => closed = true,
                },
                recv(done) -> change => if let Ok(change) = change { self.settled(&change) },
                recv(again) -> _ => {}
            }
            fresh.extend(handed.try_iter().take(BATCH));
            done.try_iter().for_each(|change| self.settled(&change));
            self.take(fresh);
            if closed {
                self.queues.iter().for_each(|queue| queue.close());
                done.try_iter().for_each(|change| self.settled(&change));
                self.save();
                return;
            }
        }
    }

    /// Takes all that waits now, without waiting for more.
    pub fn turn(&mut self, (handed, done): Inputs<'_>) {
        done.try_iter().for_each(|change| self.settled(&change));
        self.take(handed.try_iter().collect());
    }

    /// Whether the store holds what waits, and nothing else.
    pub fn is_stored(&self) -> bool {
        self.puts.is_empty() && self.gone.is_empty()
    }

    fn settled(&mut self, change: &Change) {
        let key = key_of(&change.queue, change.seq);
        if self.puts.remove(&key).is_none() {
            self.gone.insert(key);
        }
    }

    /// Stores documents, then gives them to the queues that want them.
    fn take(&mut self, fresh: Vec<Arc<Item>>) {
        let mut placed = Vec::new();
        for item in fresh {
            let json = serde_json::to_vec(item.as_ref()).unwrap_or_default();
            for queue in self.queues.iter().filter(|q| q.wants(&item.kind)) {
                self.puts.insert(key_of(&queue.name, self.next), json.clone());
                placed.push((queue.clone(), self.next, item.clone()));
                self.next += 1;
            }
        }
        self.save();
        for (queue, seq, item) in placed {
            if let Some(given_up) = queue.push(seq, item) {
                self.metrics.delivery_dropped.inc();
                let text = format!("more documents wait for {} than its queue holds: the oldest are lost", queue.name);
                self.faults.raise_for(&format!("overflow {}", queue.name), text, LOSS_SHOWN);
                self.settled(&Change { queue: queue.name.clone(), seq: given_up });
            }
        }
    }

    fn save(&mut self) {
        // A folder that was taken away takes the store along.
        if self.store.is_some() && !self.path.exists() {
            self.store = None;
            self.gone.clear();
            for queue in &self.queues {
                let waiting = queue.all();
                let rows = waiting.iter().map(|(seq, item)| (key_of(&queue.name, *seq), item));
                self.puts.extend(rows.map(|(key, item)| (key, serde_json::to_vec(item.as_ref()).unwrap_or_default())));
            }
        }
        if self.is_stored() && self.store.is_some() {
            return;
        }
        let opened = if self.store.is_none() { self.reopen() } else { Ok(()) };
        let saved = opened.and_then(|()| {
            let Some(store) = &self.store else { return Ok(()) };
            let puts = self.puts.iter().map(|(key, json)| (key.as_str(), json.as_slice()));
            store.change(puts, self.gone.iter().map(String::as_str)).map_err(|e| e.to_string())
        });
        match saved {
            Ok(()) => {
                self.puts.clear();
                self.gone.clear();
                self.faults.clear(FAULT);
            }
            Err(why) => {
                self.store = None;
                self.faults.raise(FAULT, why);
            }
        }
    }
}
