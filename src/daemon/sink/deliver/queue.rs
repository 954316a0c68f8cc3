//! Documents that wait for one receiver, oldest first.

use std::collections::{HashSet, VecDeque};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use super::Item;
use crate::runtime::clock::Clock;
use crate::runtime::metrics::{Label, Metrics};
use stiction_engine::config::Deliver;

/// Next step of a receiver's thread.
pub(super) enum Next {
    /// Send this document.
    Send(u64, Arc<Item>),
    /// Nothing to send for now.
    Nothing,
    /// The thread must end.
    Closed,
}

/// The attempts to send a document so far.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Tried {
    /// Number of attempts.
    pub sent: u32,
    /// How often the receiver refused it for now, and the first time.
    pub refused: u32,
    pub refused_at: Option<Instant>,
    /// How often the receiver took another document just before this one failed, and the first time.
    pub passed: u32,
    pub passed_at: Option<Instant>,
}

struct Entry {
    seq: u64,
    item: Arc<Item>,
    /// Latest time until which it waits to be stored; `None` once it is stored or the disk has refused it.
    held_until: Option<Instant>,
    tried: Tried,
}

#[derive(Default)]
struct Waiting {
    entries: VecDeque<Entry>,
    closed: bool,
}

impl Waiting {
    fn place(&self, seq: u64) -> Option<usize> {
        self.entries.binary_search_by_key(&seq, |entry| entry.seq).ok()
    }
}

/// The queue of one receiver.
pub(super) struct Queue {
    /// The receiver's name.
    pub name: String,
    documents: Vec<String>,
    limit: usize,
    waiting: Mutex<Waiting>,
    wake: Condvar,
    clock: Clock,
    metrics: Arc<Metrics>,
}

impl Queue {
    pub fn new(d: &Deliver, clock: &Clock, metrics: &Arc<Metrics>) -> Self {
        let (name, documents, limit) = (d.name.clone(), d.documents.clone(), d.queue);
        let (waiting, wake) = (Mutex::default(), Condvar::new());
        Self { name, documents, limit, waiting, wake, clock: clock.clone(), metrics: metrics.clone() }
    }

    fn lock(&self) -> MutexGuard<'_, Waiting> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub fn wants(&self, kind: &str) -> bool {
        self.documents.iter().any(|wanted| wanted == kind)
    }

    /// Inserts a document behind those with lower numbers. It is not sent before it is released or `held_until` has passed. If
    /// there are too many, drops and returns the oldest, since newer documents describe the current state.
    pub fn push(&self, seq: u64, item: Arc<Item>, held_until: Option<Instant>) -> Option<u64> {
        let mut waiting = self.lock();
        let place = waiting.entries.partition_point(|entry| entry.seq < seq);
        waiting.entries.insert(place, Entry { seq, item, held_until, tried: Tried::default() });
        let over = waiting.entries.len() > self.limit;
        let given_up = if over { waiting.entries.pop_front().map(|entry| entry.seq) } else { None };
        self.show(waiting.entries.len());
        drop(waiting);
        self.wake.notify_one();
        given_up
    }

    /// Documents up to this number no longer wait for the disk.
    pub fn release(&self, seq: u64) {
        let mut waiting = self.lock();
        waiting.entries.iter_mut().take_while(|entry| entry.seq <= seq).for_each(|entry| entry.held_until = None);
        drop(waiting);
        self.wake.notify_one();
    }

    /// The oldest document, which stays in the queue until it is settled; waits for one.
    pub fn next(&self, patience: Duration) -> Next {
        let until = self.clock.now() + patience;
        let mut waiting = self.lock();
        loop {
            let now = self.clock.now();
            let wait = match waiting.entries.front() {
                _ if waiting.closed => return Next::Closed,
                Some(Entry { seq, item, held_until, .. }) => match held_until.filter(|until| now < *until) {
                    None => return Next::Send(*seq, item.clone()),
                    Some(held_until) => held_until.min(until).saturating_duration_since(now),
                },
                None => until.saturating_duration_since(now),
            };
            if now >= until {
                return Next::Nothing;
            }
            waiting = self.wake.wait_timeout(waiting, wait).unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    /// Notes the result of an attempt, if the document still waits.
    pub fn note(&self, seq: u64, note: impl FnOnce(&mut Tried)) {
        let mut waiting = self.lock();
        if let Some(place) = waiting.place(seq) {
            note(&mut waiting.entries[place].tried);
        }
    }

    /// The attempts to send a document so far.
    pub fn tried(&self, seq: u64) -> Tried {
        let waiting = self.lock();
        waiting.place(seq).map(|place| waiting.entries[place].tried).unwrap_or_default()
    }

    /// The oldest document of another loop, a different loop in each `round`. Sending it before this one keeps the order within
    /// every loop.
    pub fn of_other_loop(&self, seq: u64, round: usize) -> Option<(u64, Arc<Item>)> {
        let (waiting, now) = (self.lock(), self.clock.now());
        let this = &waiting.entries[waiting.place(seq)?];
        let mut seen = HashSet::from([this.item.loop_name.as_str()]);
        let firsts = waiting.entries.iter().filter(|entry| seen.insert(entry.item.loop_name.as_str()));
        let free: Vec<_> = firsts.filter(|entry| entry.held_until.is_none_or(|until| until <= now)).collect();
        free.get(round % free.len().max(1)).map(|entry| (entry.seq, entry.item.clone()))
    }

    /// Removes a document that no longer waits; false if it had already been dropped.
    pub fn settle(&self, seq: u64) -> bool {
        let mut waiting = self.lock();
        let Some(place) = waiting.place(seq) else { return false };
        waiting.entries.remove(place);
        self.show(waiting.entries.len());
        true
    }

    /// Waits after a failure; true if the thread must end.
    pub fn pause(&self, time: Duration) -> bool {
        let waiting = self.lock();
        let (waiting, _) =
            self.wake.wait_timeout_while(waiting, time, |w| !w.closed).unwrap_or_else(PoisonError::into_inner);
        waiting.closed
    }

    pub fn close(&self) {
        self.lock().closed = true;
        self.wake.notify_all();
    }

    pub fn len(&self) -> usize {
        self.lock().entries.len()
    }

    /// All waiting documents.
    pub fn all(&self) -> Vec<(u64, Arc<Item>)> {
        self.lock().entries.iter().map(|entry| (entry.seq, entry.item.clone())).collect()
    }

    fn show(&self, length: usize) {
        self.metrics.delivery_waiting.get_or_create(&Label { name: self.name.clone() }).set(length as i64);
    }
}
