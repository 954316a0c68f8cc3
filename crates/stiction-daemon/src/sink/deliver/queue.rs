//! What waits for one receiver, oldest first.

use std::collections::{BTreeMap, HashSet, VecDeque};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use super::Item;
use stiction_monitor::config::Deliver;
use stiction_runtime::metrics::{Label, Metrics};

/// What a receiver's thread does next.
pub(super) enum Next {
    /// Sends this.
    Send(u64, Arc<Item>),
    /// Nothing for a while.
    Nothing,
    /// Ends.
    Closed,
}

#[derive(Default)]
struct Waiting {
    items: VecDeque<(u64, Arc<Item>)>,
    /// How often each was sent in vain.
    attempts: BTreeMap<u64, u32>,
    closed: bool,
}

/// The queue of one receiver.
pub(super) struct Queue {
    /// The receiver's name.
    pub name: String,
    documents: Vec<String>,
    limit: usize,
    waiting: Mutex<Waiting>,
    wake: Condvar,
    metrics: Arc<Metrics>,
}

impl Queue {
    pub fn new(d: &Deliver, metrics: &Arc<Metrics>) -> Self {
        let (name, documents, limit) = (d.name.clone(), d.documents.clone(), d.queue);
        Self { name, documents, limit, waiting: Mutex::default(), wake: Condvar::new(), metrics: metrics.clone() }
    }

    fn lock(&self) -> MutexGuard<'_, Waiting> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub fn wants(&self, kind: &str) -> bool {
        self.documents.iter().any(|wanted| wanted == kind)
    }

    /// Puts one behind those with lower numbers. Gives the oldest up where there are too many: the newest says how things stand.
    pub fn push(&self, seq: u64, item: Arc<Item>) -> Option<u64> {
        let mut waiting = self.lock();
        let place = waiting.items.partition_point(|(s, _)| *s < seq);
        waiting.items.insert(place, (seq, item));
        let over = waiting.items.len() > self.limit;
        let given_up = if over { waiting.items.pop_front().map(|(seq, _)| seq) } else { None };
        if let Some(seq) = given_up {
            waiting.attempts.remove(&seq);
        }
        self.show(waiting.items.len());
        drop(waiting);
        self.wake.notify_one();
        given_up
    }

    /// The oldest, which stays where it is until it is settled; waits for one.
    pub fn next(&self, patience: Duration) -> Next {
        let waiting = self.lock();
        let empty = |w: &mut Waiting| w.items.is_empty() && !w.closed;
        let (waiting, _) =
            self.wake.wait_timeout_while(waiting, patience, empty).unwrap_or_else(PoisonError::into_inner);
        match waiting.items.front() {
            _ if waiting.closed => Next::Closed,
            Some((seq, item)) => Next::Send(*seq, item.clone()),
            None => Next::Nothing,
        }
    }

    /// Counts an attempt to send a document.
    pub fn count_attempt(&self, seq: u64) {
        *self.lock().attempts.entry(seq).or_default() += 1;
    }

    /// How often a document was sent.
    pub fn attempts(&self, seq: u64) -> u32 {
        self.lock().attempts.get(&seq).copied().unwrap_or_default()
    }

    /// The first document of another loop, each loop in turn by `round`: to send it before this one keeps the order within
    /// every loop.
    pub fn of_other_loop(&self, seq: u64, round: usize) -> Option<(u64, Arc<Item>)> {
        let waiting = self.lock();
        let (_, this) = waiting.items.iter().find(|(s, _)| *s == seq)?;
        let mut seen = HashSet::from([this.loop_name.as_str()]);
        let firsts: Vec<_> = waiting.items.iter().filter(|(_, item)| seen.insert(&item.loop_name)).collect();
        Some((*firsts.get(round % firsts.len().max(1))?).clone())
    }

    /// Takes away a document that waits no longer; false where it had been given up meanwhile.
    pub fn settle(&self, seq: u64) -> bool {
        let mut waiting = self.lock();
        waiting.attempts.remove(&seq);
        let Some(place) = waiting.items.iter().position(|(s, _)| *s == seq) else { return false };
        waiting.items.remove(place);
        self.show(waiting.items.len());
        true
    }

    /// Waits after a failure; true where it is time to end.
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
        self.lock().items.len()
    }

    /// All that waits.
    pub fn all(&self) -> Vec<(u64, Arc<Item>)> {
        self.lock().items.iter().cloned().collect()
    }

    fn show(&self, length: usize) {
        self.metrics.delivery_waiting.get_or_create(&Label { name: self.name.clone() }).set(length as i64);
    }
}
