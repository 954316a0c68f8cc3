//! The pending changes to the document store. Producers and the receivers' threads note them without waiting for a disk; the
//! writing thread carries them out.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use super::queue::Queue;
use super::{Item, LOSS_SHOWN};
use crate::daemon::sink::mark::Mark;
use crate::runtime::clock::Clock;
use crate::runtime::faults::Faults;
use crate::runtime::metrics::Metrics;

/// How long a document may wait for the disk before it goes to its receivers anyway.
pub(super) const HELD: Duration = Duration::from_secs(1);
/// Most documents that wait to be written to the dead-letter file; further ones stay in the store and are tried again after a
/// restart.
const LETTERS: usize = 1000;

/// A document that a receiver refused permanently.
pub(super) struct Letter {
    pub queue: String,
    pub seq: u64,
    pub item: Arc<Item>,
    pub attempts: u32,
    pub why: String,
}

/// The next changes to write.
#[derive(Default)]
pub(super) struct Batch {
    pub puts: BTreeMap<String, Arc<Item>>,
    pub gone: BTreeSet<String>,
    pub letters: Vec<Letter>,
    /// Number of the newest document in it, for the queues and for the state store.
    pub last_seq: u64,
    pub last_number: u64,
    /// Whether this is the last batch.
    pub is_last: bool,
}

#[derive(Default)]
struct Inner {
    puts: BTreeMap<String, Arc<Item>>,
    gone: BTreeSet<String>,
    letters: Vec<Letter>,
    /// Number of the next document, above those of all earlier runs.
    next: u64,
    /// Since when the current batch is being written, and how many of its documents are not stored.
    writing: Option<(Instant, usize)>,
    /// Number of the newest document taken by the writing thread.
    taken: u64,
    is_closed: bool,
}

impl Inner {
    fn is_stored(&self) -> bool {
        self.puts.is_empty() && self.gone.is_empty() && self.letters.is_empty() && self.writing.is_none()
    }

    fn settle(&mut self, key: String) {
        if self.puts.remove(&key).is_none() {
            self.gone.insert(key);
        }
    }
}

/// Pending changes, shared by the threads.
pub(super) struct Ledger {
    inner: Mutex<Inner>,
    wake: Condvar,
    pub queues: Vec<Arc<Queue>>,
    mark: Mark,
    clock: Clock,
    faults: Arc<Faults>,
    metrics: Arc<Metrics>,
}

pub(super) fn key_of(queue: &str, seq: u64) -> String {
    // Twenty digits hold every `u64`, so keys sort as numbers do.
    format!("{queue}\n{seq:020}")
}

impl Ledger {
    pub fn new(
        first: u64,
        queues: Vec<Arc<Queue>>,
        (mark, clock): (Mark, Clock),
        faults: Arc<Faults>,
        metrics: Arc<Metrics>,
    ) -> Self {
        let inner = Mutex::new(Inner { next: first, ..Inner::default() });
        Self { inner, wake: Condvar::new(), queues, mark, clock, faults, metrics }
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Hands a document to the queues that want it. They hold it until it is stored, at most for [`HELD`].
    pub fn offer(&self, item: &Arc<Item>) {
        let held_until = self.clock.now() + HELD;
        let mut inner = self.lock();
        let mut wanted = false;
        for queue in self.queues.iter().filter(|queue| queue.wants(&item.kind)) {
            wanted = true;
            let seq = inner.next;
            inner.next += 1;
            inner.puts.insert(key_of(&queue.name, seq), item.clone());
            if let Some(given_up) = queue.push(seq, item.clone(), Some(held_until)) {
                self.overflow(queue);
                inner.settle(key_of(&queue.name, given_up));
            }
        }
        if wanted {
            self.mark.hand();
            drop(inner);
            self.wake.notify_one();
        }
    }

    /// A queue has dropped its oldest document.
    fn overflow(&self, queue: &Queue) {
        self.metrics.delivery_dropped.inc();
        let text = format!("more documents wait for {} than its queue holds: the oldest are lost", queue.name);
        self.faults.raise_for(&format!("overflow {}", queue.name), text, LOSS_SHOWN);
    }

    /// Queues a document that an earlier run left in the store.
    pub fn take_over(&self, queue: &Arc<Queue>, seq: u64, item: Arc<Item>) {
        let mut inner = self.lock();
        inner.next = inner.next.max(seq + 1);
        if let Some(given_up) = queue.push(seq, item, None) {
            self.overflow(queue);
            inner.settle(key_of(&queue.name, given_up));
        }
    }

    /// A document no longer waits.
    pub fn settle(&self, queue: &str, seq: u64) {
        self.lock().settle(key_of(queue, seq));
        self.wake.notify_one();
    }

    /// A document was refused permanently: it leaves the store once it is in the dead-letter file.
    pub fn bury(&self, letter: Letter) {
        let mut inner = self.lock();
        if inner.letters.len() < LETTERS {
            inner.letters.push(letter);
        }
        drop(inner);
        self.wake.notify_one();
    }

    /// Keys of the documents that were refused permanently but are not in the dead-letter file yet.
    pub fn unburied(&self) -> Vec<String> {
        self.lock().letters.iter().map(|letter| key_of(&letter.queue, letter.seq)).collect()
    }

    /// Takes the next changes to write, waiting up to `pause` for something new; for ever without one.
    pub fn take_within(&self, pause: Option<Duration>) -> Batch {
        let nothing = |inner: &mut Inner| {
            // After an error, failed changes are tried again only at the end of the pause.
            let has_more = if pause.is_some() { self.mark.handed() > inner.taken } else { !inner.is_stored() };
            !has_more && !inner.is_closed
        };
        let inner = match pause {
            None => self.wake.wait_while(self.lock(), nothing).unwrap_or_else(PoisonError::into_inner),
            Some(pause) => {
                self.wake.wait_timeout_while(self.lock(), pause, nothing).unwrap_or_else(PoisonError::into_inner).0
            }
        };
        self.take_of(inner)
    }

    /// Takes the changes to write now.
    pub fn take(&self) -> Batch {
        self.take_of(self.lock())
    }

    fn take_of(&self, mut inner: MutexGuard<'_, Inner>) -> Batch {
        let batch = Batch {
            puts: std::mem::take(&mut inner.puts),
            gone: std::mem::take(&mut inner.gone),
            letters: std::mem::take(&mut inner.letters),
            last_seq: inner.next.saturating_sub(1),
            last_number: self.mark.handed(),
            is_last: inner.is_closed,
        };
        inner.taken = batch.last_number;
        inner.writing = Some((self.clock.now(), batch.puts.len()));
        batch
    }

    /// The batch has been stored.
    pub fn stored(&self, batch: &Batch) {
        self.lock().writing = None;
        self.queues.iter().for_each(|queue| queue.release(batch.last_seq));
        self.mark.store(batch.last_number);
    }

    /// The disk refused the batch: it is written again later, and its documents are sent now.
    pub fn refused(&self, batch: Batch, why: &str) {
        let (last_seq, last_number) = (batch.last_seq, batch.last_number);
        let mut inner = self.lock();
        inner.writing = None;
        for (key, item) in batch.puts {
            if !inner.gone.contains(&key) {
                inner.puts.entry(key).or_insert(item);
            }
        }
        inner.gone.extend(batch.gone);
        drop(inner);
        self.queues.iter().for_each(|queue| queue.release(last_seq));
        self.mark.refuse(last_number, why);
    }

    /// Whether the store holds exactly the waiting documents.
    pub fn is_stored(&self) -> bool {
        self.lock().is_stored()
    }

    /// How long the disk has been writing the current batch, and how many of its documents are not stored; `None` while the
    /// disk responds.
    pub fn stall(&self) -> Option<(Duration, usize)> {
        let inner = self.lock();
        let (since, lacking) = inner.writing?;
        Some((self.clock.since(since), lacking + inner.puts.len())).filter(|(taken, _)| *taken >= HELD)
    }

    /// No more changes will come; the pending ones are written once more.
    pub fn close(&self) {
        self.lock().is_closed = true;
        self.wake.notify_one();
    }
}
