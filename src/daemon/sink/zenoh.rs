//! Publishes documents on the bus, and keeps the last one of each key for queries.
//!
//! Nothing waits for its thread. When the queue is full it is *overrun*: from then until the queue is empty, only the newest
//! document of each key is kept, and is sent after the queue. So a document may be replaced by a later one of its key, which is
//! counted, but each alarm's last change is sent.
//!
//! It does not wait for readers either. A reader that is too slow misses documents. Alarms that it missed are sent again a
//! little later; Zenoh closes the link of a reader that takes no alarm for five seconds.

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

/// Most documents that may wait for the bus.
pub const QUEUE: usize = 16_384;
/// Bytes that may wait for it, and as many again for documents that come during an overrun.
pub const QUEUE_BYTES: usize = 128 << 20;
/// Delays after which an alarm is sent again to readers that missed it.
const AGAIN_AFTER: [Duration; 2] = [Duration::from_secs(1), Duration::from_secs(6)];
/// Most alarms that may wait to be sent again.
const AGAIN: usize = 1024;
/// How long slow readers remain a fault after the last missed document.
const SLOW_SHOWN: Duration = Duration::from_secs(60);

/// One document on its way out.
#[derive(Debug)]
pub struct Publication {
    /// Its key.
    pub key: String,
    /// Its kind.
    pub kind: Kind,
    /// Its JSON. `None` withdraws the last document: queries are no longer answered with it, and nothing is sent.
    pub document: Option<Vec<u8>>,
}

impl Publication {
    /// Bytes that it occupies while it waits.
    fn bytes(&self) -> usize {
        size_of::<Self>() + self.key.len() + self.document.as_ref().map_or(0, Vec::len)
    }

    /// Whether it is sent whatever else waits: alarms and removals are small.
    fn is_urgent(&self) -> bool {
        self.kind == Kind::Alarm || self.document.is_none()
    }
}

type Waiting = (Publication, Option<Room>);

/// Documents that came while the queue was full: the newest of each key.
#[derive(Debug, Default)]
struct Overrun {
    is_on: bool,
    late: BTreeMap<String, Waiting>,
}

/// The engine's end, for handing documents over.
#[derive(Clone)]
pub struct Publisher {
    queue: Sender<Waiting>,
    budgets: [Budget; 2],
    overrun: Arc<Mutex<Overrun>>,
    metrics: Arc<Metrics>,
}

/// The other end, which gives documents in the order of sending.
pub struct Outgoing {
    queue: Receiver<Waiting>,
    overrun: Arc<Mutex<Overrun>>,
    late: VecDeque<Waiting>,
}

impl Publisher {
    /// Starts the thread, which ends when every `Publisher` is dropped and nothing waits.
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

    /// Number of waiting documents.
    #[must_use]
    pub fn waiting(&self) -> usize {
        self.queue.len() + self.overrun.lock().unwrap_or_else(PoisonError::into_inner).late.len()
    }

    /// Bytes waiting, and their limit.
    #[must_use]
    pub fn bytes(&self) -> [usize; 2] {
        [self.budgets.iter().map(Budget::used).sum(), self.budgets.iter().map(Budget::limit).sum()]
    }
}

impl Outgoing {
    /// The next document, if one comes before `until`.
    ///
    /// # Errors
    /// None came, or none can come any more.
    fn next_until(&mut self, until: Option<Instant>) -> Result<Publication, RecvTimeoutError> {
        if let Some(publication) = self.next_now() {
            return Ok(publication);
        }
        let got = match until {
            Some(until) => self.queue.recv_deadline(until),
            None => self.queue.recv().map_err(|_| RecvTimeoutError::Disconnected),
        };
        // An overrun may have begun, and its senders gone, while the queue was empty.
        got.map(|(publication, _room)| publication).or_else(|error| self.next_now().ok_or(error))
    }

    /// The next document if one waits: first from the queue, then from the overrun.
    pub fn next_now(&mut self) -> Option<Publication> {
        if let Some((publication, _room)) = self.late.pop_front() {
            return Some(publication);
        }
        if let Ok((publication, _room)) = self.queue.try_recv() {
            return Some(publication);
        }
        let mut overrun = self.overrun.lock().unwrap_or_else(PoisonError::into_inner);
        // Senders add to the queue under this lock, so what is in it now is older than the overrun.
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
    /// When a reader last had no room for a document.
    behind_at: Option<Instant>,
    /// Alarms that some reader missed: when to send them again, and how often that was done.
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

    /// Publishes a document; false if some reader did not take it at once.
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
        // Zenoh blocks for a while when a reader has no room; of several documents in a row only the first may show it.
        let taken = begun.elapsed() < NOT_TAKEN;
        if !taken {
            self.reader_is_behind();
        }
        taken
    }

    /// Counts a document that a reader had no room for. A busy machine may also stop this thread for as long now and then, so a
    /// single one is not a fault.
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

    /// Sends missed alarms again, with the current document under their key.
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
        // Nothing is ever taken: if publishing waited, this would not end.
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
