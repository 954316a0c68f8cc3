//! Puts documents onto the bus and keeps the last one of each key for queries.
//!
//! Nobody waits for its thread. When its queue is full it is overrun: from then until the queue is empty
//! the newest document of each key is kept instead, and goes out after it. So a document may be replaced by a later one of
//! its key, counted, but each alarm's last change goes out.
//!
//! Readers are not waited for either. Documents that are too much for a reader are dropped for it, except for alarms, which
//! are sent again a little later; Zenoh closes the link of a reader that takes no alarm for five seconds.

use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, RecvTimeoutError, Sender};
use zenoh::Wait;
use zenoh::qos::{CongestionControl, Priority};

use crate::daemon::source::zenoh::{NOT_TAKEN, encoding_of};
use crate::runtime::faults::Faults;
use crate::runtime::last_values::{LastValue, LastValues};
use crate::runtime::metrics::Metrics;
use crate::runtime::queue::{Budget, Room};
use stiction_engine::codec::topic::Kind;

/// Documents that may wait for the bus.
pub const QUEUE: usize = 16_384;
/// Bytes that may wait for it, and as many of documents that came while it was overrun.
pub const QUEUE_BYTES: usize = 128 << 20;
/// After so long an alarm goes out again for readers that did not take it, so often.
const AGAIN_AFTER: [Duration; 2] = [Duration::from_secs(1), Duration::from_secs(6)];
/// Alarms that may wait for that.
const AGAIN: usize = 1024;
/// How long slow readers stay a fault after the last document that one of them did not take.
const SLOW_SHOWN: Duration = Duration::from_secs(60);

/// One document on its way out.
#[derive(Debug)]
pub struct Publication {
    /// Its key.
    pub key: String,
    /// What it is.
    pub kind: Kind,
    /// Its JSON. None where the last one is no longer this daemon's to answer with: queries are not answered with it any
    /// more, and nothing goes out.
    pub document: Option<Vec<u8>>,
}

impl Publication {
    /// Bytes that it holds while it waits.
    fn bytes(&self) -> usize {
        size_of::<Self>() + self.key.len() + self.document.as_ref().map_or(0, Vec::len)
    }

    /// Whether it goes out whatever else waits: alarms and removals are small.
    fn is_urgent(&self) -> bool {
        self.kind == Kind::Alarm || self.document.is_none()
    }
}

type Waiting = (Publication, Option<Room>);

/// What came while the queue was full: the newest document of each key.
#[derive(Debug, Default)]
struct Overrun {
    is_on: bool,
    late: BTreeMap<String, Waiting>,
}

/// The engine's end: the way to the publisher's thread.
#[derive(Clone)]
pub struct Publisher {
    queue: Sender<Waiting>,
    budgets: [Budget; 2],
    overrun: Arc<Mutex<Overrun>>,
    metrics: Arc<Metrics>,
}

/// The other end: documents in the order in which they go out.
pub struct Outgoing {
    queue: Receiver<Waiting>,
    overrun: Arc<Mutex<Overrun>>,
    late: VecDeque<Waiting>,
}

impl Publisher {
    /// Starts the thread. It ends when every `Publisher` is gone and nothing waits.
    ///
    /// # Errors
    /// The system refuses a thread.
    pub fn start(
        session: zenoh::Session,
        last: LastValues,
        (metrics, faults): (Arc<Metrics>, Arc<Faults>),
    ) -> std::io::Result<(Self, JoinHandle<()>)> {
        let (publisher, mut outgoing) = Self::pair(metrics.clone());
        let mut bus = Bus { session, last, metrics, faults, behind_at: None, again: VecDeque::new() };
        let thread = std::thread::Builder::new().name("publish".into());
        let handle = thread.spawn(move || bus.publish_all(&mut outgoing))?;
        Ok((publisher, handle))
    }

    /// Both ends without a thread or a session.
    #[must_use]
    pub fn pair(metrics: Arc<Metrics>) -> (Self, Outgoing) {
        let (queue, waiting) = crossbeam_channel::bounded(QUEUE);
        let overrun = Arc::<Mutex<Overrun>>::default();
        let outgoing = Outgoing { queue: waiting, overrun: overrun.clone(), late: VecDeque::new() };
        (Self { queue, budgets: [QUEUE_BYTES; 2].map(Budget::new), overrun, metrics }, outgoing)
    }

    /// Hands a document over; never waits.
    pub fn publish(&self, publication: Publication) {
        let [queued, late] = &self.budgets;
        if publication.bytes() > queued.limit() {
            self.metrics.dropped_output.inc();
            return;
        }
        let mut overrun = self.overrun.lock().unwrap_or_else(PoisonError::into_inner);
        let publication = if overrun.is_on {
            publication
        } else {
            let room = queued.take(publication.bytes());
            if room.is_none() && !publication.is_urgent() {
                publication
            } else {
                match self.queue.try_send((publication, room)) {
                    Ok(()) => return,
                    Err(refused) => refused.into_inner().0,
                }
            }
        };
        if !std::mem::replace(&mut overrun.is_on, true) {
            tracing::error!("the bus cannot keep up: only the newest document of each key goes out until it does");
        }
        let room = late.take(publication.bytes());
        let is_lost = room.is_none() && !publication.is_urgent();
        if is_lost || overrun.late.insert(publication.key.clone(), (publication, room)).is_some() {
            self.metrics.dropped_output.inc();
        }
    }

    /// Documents that wait.
    #[must_use]
    pub fn waiting(&self) -> usize {
        self.queue.len() + self.overrun.lock().unwrap_or_else(PoisonError::into_inner).late.len()
    }

    /// Bytes that wait, and that may.
    #[must_use]
    pub fn bytes(&self) -> [usize; 2] {
        [self.budgets.iter().map(Budget::used).sum(), self.budgets.iter().map(Budget::limit).sum()]
    }
}

impl Outgoing {
    /// What goes out next, if it comes until then.
    ///
    /// # Errors
    /// Nothing came, or nothing can come any more.
    fn next_until(&mut self, until: Option<Instant>) -> Result<Publication, RecvTimeoutError> {
        if let Some(publication) = self.next_now() {
            return Ok(publication);
        }
        let got = match until {
            Some(until) => self.queue.recv_deadline(until),
            None => self.queue.recv().map_err(|_| RecvTimeoutError::Disconnected),
        };
        // While the queue was empty an overrun may have begun and ended with its senders.
        got.map(|(publication, _room)| publication).or_else(|error| self.next_now().ok_or(error))
    }

    /// What goes out next, if something waits: first the queue, then what came while it was full.
    pub fn next_now(&mut self) -> Option<Publication> {
        if let Some((publication, _room)) = self.late.pop_front() {
            return Some(publication);
        }
        if let Ok((publication, _room)) = self.queue.try_recv() {
            return Some(publication);
        }
        let mut overrun = self.overrun.lock().unwrap_or_else(PoisonError::into_inner);
        // The engine's end adds to the queue under this lock: what it holds now is older than what is late.
        if let Ok((publication, _room)) = self.queue.try_recv() {
            return Some(publication);
        }
        overrun.is_on = false;
        let late = std::mem::take(&mut overrun.late);
        drop(overrun);
        self.late.extend(late.into_values());
        self.late.pop_front().map(|(publication, _room)| publication)
    }
}

/// The publisher's thread.
struct Bus {
    session: zenoh::Session,
    last: LastValues,
    metrics: Arc<Metrics>,
    faults: Arc<Faults>,
    /// When a document last met a reader without room.
    behind_at: Option<Instant>,
    /// Alarms that some reader did not take, when they go out again, and how often they have.
    again: VecDeque<(Instant, String, usize)>,
}

impl Bus {
    fn publish_all(&mut self, outgoing: &mut Outgoing) {
        loop {
            let until = self.again.front().map(|(at, ..)| *at);
            match outgoing.next_until(until) {
                Ok(publication) => self.publish(publication),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return,
            }
            self.repeat_alarms();
        }
    }

    fn publish(&mut self, Publication { key, kind, document }: Publication) {
        let Some(document) = document else {
            self.last.write().unwrap_or_else(PoisonError::into_inner).remove(&key);
            return;
        };
        let value = LastValue { document: document.into() };
        self.last.write().unwrap_or_else(PoisonError::into_inner).insert(key.clone(), value.clone());
        if !self.put(&key, kind, value) && kind == Kind::Alarm {
            self.put_off(key, 0);
        }
    }

    /// Puts a document onto the bus; false where some reader did not take it at once.
    fn put(&mut self, key: &str, kind: Kind, value: LastValue) -> bool {
        let (priority, congestion) = match kind {
            Kind::Alarm => (Priority::InteractiveHigh, CongestionControl::BlockFirst),
            Kind::Health => (Priority::Background, CongestionControl::Drop),
            _ => (Priority::Data, CongestionControl::Drop),
        };
        let put = self.session.put(key, value.document).encoding(encoding_of(key));
        let begun = Instant::now();
        if let Err(error) = put.priority(priority).congestion_control(congestion).wait() {
            self.metrics.dropped_output.inc();
            tracing::warn!(%key, %error, "a document could not be published; queries still answer it");
            return true;
        }
        self.metrics.published.inc();
        // Zenoh takes its time where a reader has no room, the first time of many.
        let taken = begun.elapsed() < NOT_TAKEN;
        if !taken {
            self.reader_is_behind();
        }
        taken
    }

    /// Counts a document that met a reader without room. A busy machine may stop this thread for as long now and then, so that
    /// a single one is no fault.
    fn reader_is_behind(&mut self) {
        self.metrics.readers_behind.inc();
        let count = self.metrics.readers_behind.get();
        let before = self.behind_at.replace(Instant::now());
        if before.is_some_and(|at| at.elapsed() < SLOW_SHOWN) {
            let what = "a reader of the bus is too slow for them and misses documents; queries answer the last ones";
            self.faults.raise_for("slow readers", format!("{count} documents met congestion: {what}"), SLOW_SHOWN);
        }
    }

    fn put_off(&mut self, key: String, done: usize) {
        if let Some(after) = AGAIN_AFTER.get(done).filter(|_| self.again.len() < AGAIN) {
            let at = Instant::now() + *after;
            let place = self.again.partition_point(|(other, ..)| *other <= at);
            self.again.insert(place, (at, key, done + 1));
        }
    }

    /// Sends alarms again that some reader did not take: what is under their keys now.
    fn repeat_alarms(&mut self) {
        while self.again.front().is_some_and(|(at, ..)| *at <= Instant::now()) {
            let Some((_, key, done)) = self.again.pop_front() else { return };
            let last = self.last.read().unwrap_or_else(PoisonError::into_inner).get(&key).cloned();
            if let Some(value) = last
                && !self.put(&key, Kind::Alarm, value)
            {
                self.put_off(key, done);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn publication(key: &str, kind: Kind, text: &str) -> Publication {
        Publication { key: key.to_owned(), kind, document: Some(text.into()) }
    }

    fn drained(outgoing: &mut Outgoing) -> Vec<(String, Option<Vec<u8>>)> {
        std::iter::from_fn(|| outgoing.next_now()).map(|p| (p.key, p.document)).collect()
    }

    #[test]
    fn a_full_queue_holds_nobody_up_and_the_newest_of_each_key_goes_out_after_it() {
        let metrics = Arc::new(Metrics::default());
        let (publisher, mut outgoing) = Publisher::pair(metrics.clone());
        // Nobody takes anything: were this to wait, it would not end.
        for number in 0..QUEUE + 10_000 {
            publisher.publish(publication(&format!("a{}", number % 100), Kind::Alarm, &number.to_string()));
        }
        publisher.publish(Publication { key: "a7".to_owned(), kind: Kind::Alarm, document: None });
        assert_eq!(publisher.waiting(), QUEUE + 100);
        let out = drained(&mut outgoing);
        assert_eq!(out.len() as u64 + metrics.dropped_output.get(), QUEUE as u64 + 10_001);
        let last: BTreeMap<String, Option<Vec<u8>>> = out.into_iter().collect();
        let newest = |k: usize| (QUEUE + 9_900..QUEUE + 10_000).find(|number| number % 100 == k).unwrap().to_string();
        assert!((0..100).filter(|k| *k != 7).all(|k| last[&format!("a{k}")] == Some(newest(k).into_bytes())));
        assert_eq!((&last["a7"], publisher.bytes()[0]), (&None, 0));
        publisher.publish(publication("a7", Kind::Alarm, "again"));
        assert_eq!(drained(&mut outgoing).len(), 1, "the overrun is over");
    }

    #[test]
    fn documents_are_bounded_in_bytes_and_alarms_go_out_whatever_waits() {
        let metrics = Arc::new(Metrics::default());
        let (publisher, mut outgoing) = Publisher::pair(metrics.clone());
        let large = "x".repeat(10 << 20);
        (0..60).for_each(|k| publisher.publish(publication(&format!("e{k}"), Kind::Estimate, &large)));
        assert!(publisher.bytes()[0] <= publisher.bytes()[1] && metrics.dropped_output.get() == 36);
        publisher.publish(publication("a", Kind::Alarm, "unack"));
        let out = drained(&mut outgoing);
        assert_eq!(out.last().unwrap().0, "e23");
        assert!(out.iter().any(|(key, _)| key == "a"));
    }
}
