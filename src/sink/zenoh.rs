//! Puts documents onto the bus and keeps the last one of each key for queries.
//!
//! A thread of its own: a slow bus holds up nobody but itself. The queue drops estimates and health when it is full
//! (the queryable still has the newest that went through); alarms wait for a place.

use std::sync::{Arc, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use crossbeam_channel::{Receiver, Sender};
use zenoh::Wait;
use zenoh::qos::{CongestionControl, Priority};

use crate::daemon::metrics::Metrics;
use crate::daemon::queue::{Budget, Room};
use crate::sink::signing::Signer;
use crate::source::zenoh::{LastValue, LastValues, encoding_of};
use stiction_monitor::codec::topic::Kind;

/// Documents that may wait for the bus.
pub const QUEUE: usize = 16_384;
/// Bytes that may wait for it.
pub const QUEUE_BYTES: usize = 128 << 20;
/// How long an alarm waits for a place in the queue.
const ALARM_PATIENCE: Duration = Duration::from_secs(2);

/// One document on its way out.
#[derive(Debug)]
pub struct Publication {
    /// Its key.
    pub key: String,
    /// What it is.
    pub kind: Kind,
    /// Its JSON; empty where the last one is no longer this daemon's to answer with.
    pub document: Vec<u8>,
}

impl Publication {
    /// What is said under a key is no longer so: queries are not answered with it any more. Nothing goes out.
    #[must_use]
    pub const fn removal(key: String, kind: Kind) -> Self {
        Self { key, kind, document: Vec::new() }
    }

    /// Whether it is one.
    #[must_use]
    pub const fn is_removal(&self) -> bool {
        self.document.is_empty()
    }
}

/// The way to the publisher's thread.
#[derive(Clone)]
pub struct Publisher {
    queue: Sender<(Publication, Option<Room>)>,
    budget: Budget,
    metrics: Arc<Metrics>,
}

impl Publisher {
    /// Starts the thread. It ends when every `Publisher` is gone and the queue is empty.
    ///
    /// # Errors
    /// The system refuses a thread.
    pub fn start(
        session: zenoh::Session,
        last: LastValues,
        signer: Option<Arc<Signer>>,
        metrics: Arc<Metrics>,
    ) -> std::io::Result<(Self, JoinHandle<()>)> {
        let (publisher, waiting) = Self::pair(metrics.clone());
        let thread = std::thread::Builder::new().name("publish".into());
        let handle = thread.spawn(move || publish_all(&session, &waiting, &last, signer.as_deref(), &metrics))?;
        Ok((publisher, handle))
    }

    /// Both ends without a thread or a session.
    #[must_use]
    pub fn pair(metrics: Arc<Metrics>) -> (Self, Receiver<(Publication, Option<Room>)>) {
        let (queue, waiting) = crossbeam_channel::bounded(QUEUE);
        (Self { queue, budget: Budget::new(QUEUE_BYTES), metrics }, waiting)
    }

    /// Hands a document over.
    pub fn publish(&self, publication: Publication) {
        let bytes = size_of::<Publication>() + publication.key.len() + publication.document.len();
        let patience =
            if matches!(publication.kind, Kind::Alarm | Kind::State) { ALARM_PATIENCE } else { Duration::ZERO };
        let room = self.budget.take(bytes);
        // An alarm is small, and goes out whatever else waits.
        let lost = (room.is_none() && publication.kind != Kind::Alarm)
            || self.queue.send_timeout((publication, room), patience).is_err();
        if lost {
            self.metrics.dropped_output.inc();
        }
    }

    /// Documents that wait.
    #[must_use]
    pub fn waiting(&self) -> usize {
        self.queue.len()
    }

    /// Bytes that wait, and that may.
    #[must_use]
    pub fn bytes(&self) -> [usize; 2] {
        [self.budget.used(), self.budget.limit()]
    }
}

fn publish_all(
    session: &zenoh::Session,
    waiting: &Receiver<(Publication, Option<Room>)>,
    last: &LastValues,
    signer: Option<&Signer>,
    metrics: &Metrics,
) {
    for (publication, _room) in waiting {
        if publication.is_removal() {
            last.write().unwrap_or_else(PoisonError::into_inner).remove(&publication.key);
            continue;
        }
        let Publication { key, kind, document } = publication;
        let attachment: Option<Arc<[u8]>> = signer.map(|signer| signer.attachment(&key, &document).into());
        let shared = LastValue { document: document.as_slice().into(), attachment: attachment.clone() };
        last.write().unwrap_or_else(PoisonError::into_inner).insert(key.clone(), shared);
        let (priority, congestion) = match kind {
            Kind::Alarm | Kind::State => (Priority::InteractiveHigh, CongestionControl::Block),
            Kind::Health => (Priority::Background, CongestionControl::Drop),
            _ => (Priority::Data, CongestionControl::Block),
        };
        let attachment = attachment.map(|bytes| bytes.to_vec());
        let put = session.put(&key, document).encoding(encoding_of(&key)).attachment(attachment);
        match put.priority(priority).congestion_control(congestion).wait() {
            Ok(()) => {
                metrics.published.inc();
            }
            Err(error) => {
                metrics.dropped_output.inc();
                tracing::warn!(%key, %error, "a document could not be published; queries still answer it");
            }
        }
    }
}
