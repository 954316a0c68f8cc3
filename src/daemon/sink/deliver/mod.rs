//! Delivers documents to receivers outside the bus. Each receiver has a queue and gets one document at a time. A receiver that
//! is down is tried again until it is back; a document that it refuses goes to the dead-letter file and blocks nothing. Waiting
//! documents are stored with the recordings, so a restart loses none, but may send one twice, under the same identity.
//!
//! The engine's thread only hands documents over. One thread stores them before any receiver sees them, unless the disk takes
//! longer than a second. Each receiver has a thread, which may wait for it as long as it takes.

mod dead;
mod keep;
mod ledger;
mod queue;
mod webhook;
mod worker;

use std::path::Path;
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use anyhow::{Context, anyhow};
use serde::{Deserialize, Serialize};

use crate::daemon::sink::mark::Mark;
use crate::runtime::clock::Clock;
use crate::runtime::data_health::DataHealthDocument;
use crate::runtime::faults::Faults;
use crate::runtime::metrics::Metrics;
use keep::Keep;
use ledger::Ledger;
use queue::Queue;
use stiction::core::units::format_rfc3339;
use stiction_engine::alarm::AlarmDocument;
use stiction_engine::codec::topic::Kind;
use stiction_engine::config::{Config, Deliver};
use stiction_engine::short_hash;
use stiction_files::disk::Disk;
pub use worker::MakeTarget;
use worker::{Step, Worker};

/// How long a receiver may take for one document.
const SEND_WITHIN: Duration = Duration::from_secs(10);
/// How long a thread sleeps unless it is woken.
const IDLE: Duration = Duration::from_secs(20);
/// How long a loss remains among the faults.
const LOSS_SHOWN: Duration = Duration::from_secs(3600);

/// A document on its way to receivers.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Item {
    /// Its identity, by which a receiver can drop repeats.
    pub id: String,
    /// Its kind: `alarm`, `estimate`, `gap` or `data_health`.
    pub kind: String,
    /// Name of its schema.
    pub schema: String,
    /// Its loop.
    pub loop_name: String,
    /// The site's prefix.
    pub prefix: String,
    /// When it happened, RFC 3339, plant time.
    pub time: String,
    /// The document, JSON.
    pub document: String,
}

impl Item {
    /// A change of an alarm.
    #[must_use]
    pub fn alarm(prefix: &str, a: &AlarmDocument, json: &[u8]) -> Self {
        Self {
            id: a.event_id.clone(),
            kind: Kind::Alarm.name().to_owned(),
            schema: a.schema.to_owned(),
            loop_name: a.loop_name.clone(),
            prefix: prefix.to_owned(),
            time: a.changed.clone(),
            document: String::from_utf8_lossy(json).into_owned(),
        }
    }

    /// An estimate or a gap diagnosis, of a window that ended at this time.
    #[must_use]
    pub fn result(prefix: &str, loop_name: &str, kind: Kind, end_ns: i64, json: &[u8]) -> Self {
        Self {
            id: short_hash(&[prefix.as_bytes(), b"\n", loop_name.as_bytes(), b"\n", json].concat()),
            kind: kind.name().to_owned(),
            schema: kind.schema().to_owned(),
            loop_name: loop_name.to_owned(),
            prefix: prefix.to_owned(),
            time: format_rfc3339(end_ns),
            document: String::from_utf8_lossy(json).into_owned(),
        }
    }
}

impl Item {
    /// A summary of data health.
    #[must_use]
    pub fn data_health(prefix: &str, document: &DataHealthDocument, json: &[u8]) -> Self {
        Self {
            id: document.event_id.clone(),
            kind: Kind::DataHealth.name().to_owned(),
            schema: document.schema.to_owned(),
            loop_name: format!("@daemon/{}", document.daemon),
            prefix: prefix.to_owned(),
            time: format_rfc3339(document.due_ns),
            document: String::from_utf8_lossy(json).into_owned(),
        }
    }
}

/// Why a receiver did not take a document.
#[derive(Debug)]
pub enum Failure {
    /// It cannot take the document now; with the time to wait, if it gave one.
    Later(String, Option<Duration>),
    /// It did not respond.
    Unanswered(String),
    /// It will never take this document.
    Refused(String),
}

/// Sends documents to one receiver.
pub trait Target: Send {
    /// Sends one document; returns once the receiver has it, as far as the protocol shows.
    ///
    /// # Errors
    /// [`Failure`] says whether it is worth another attempt.
    fn send(&mut self, item: &Item) -> Result<(), Failure>;
}

/// The target for a receiver, not yet connected.
fn target(d: &Deliver) -> anyhow::Result<Box<dyn Target>> {
    Ok(Box::new(webhook::Webhook::new(d)?))
}

/// Checks a receiver's settings, as far as its files show.
///
/// # Errors
/// A file cannot be read or has the wrong content.
pub fn check(d: &Deliver) -> anyhow::Result<()> {
    target(d).map(drop)
}

/// The engine's end; clones hand over to the same receivers.
#[derive(Clone)]
pub struct Outbox(Arc<Handed>);

/// State shared by all clones; the last one to be dropped closes the ledger.
struct Handed {
    ledger: Arc<Ledger>,
    wanted: Vec<String>,
}

impl Drop for Handed {
    fn drop(&mut self) {
        self.ledger.close();
    }
}

impl Outbox {
    /// Starts the threads; `None` if no receiver is configured. The storing thread ends when the `Outbox` is dropped; the
    /// receivers' threads end with it, or with the process if a receiver holds them up.
    ///
    /// # Errors
    /// A receiver's file cannot be used, or the system refuses a thread.
    pub fn start(
        config: &Config,
        dir: &Path,
        (disk, mark): (Arc<dyn Disk>, &Mark),
        faults: &Arc<Faults>,
        metrics: &Arc<Metrics>,
    ) -> anyhow::Result<Option<(Self, JoinHandle<()>)>> {
        if config.deliver.is_empty() {
            return Ok(None);
        }
        let place = (disk, Clock::system(), mark.clone());
        let make = |d: &Deliver| {
            let entry = d.clone();
            Box::new(move || target(&entry)) as MakeTarget
        };
        let (outbox, delivery) = Self::pair(config, dir, place, make, faults, metrics)?;
        let Delivery { mut keep, workers, .. } = delivery;
        for (mut worker, _) in workers {
            let thread = std::thread::Builder::new().name(format!("to-{}", worker.queue.name));
            thread.spawn(move || worker.supervise())?;
        }
        let thread = std::thread::Builder::new().name("outbox".into());
        let handle = thread.spawn(move || keep.run()).map_err(|e| anyhow!(e))?;
        Ok(Some((outbox, handle)))
    }

    /// Both ends without threads: the caller decides when the other end works, and makes the targets.
    ///
    /// # Errors
    /// A receiver cannot be made.
    pub fn pair(
        config: &Config,
        dir: &Path,
        (disk, clock, mark): (Arc<dyn Disk>, Clock, Mark),
        make: impl Fn(&Deliver) -> MakeTarget,
        faults: &Arc<Faults>,
        metrics: &Arc<Metrics>,
    ) -> anyhow::Result<(Self, Delivery)> {
        let queues = config.deliver.iter().map(|d| Arc::new(Queue::new(d, &clock, metrics))).collect::<Vec<_>>();
        // So that the numbers of this run are above those in the store even if it cannot be read yet.
        let first = u64::try_from(clock.now_ns()).unwrap_or_default();
        let place = (mark.clone(), clock.clone());
        let ledger = Arc::new(Ledger::new(first, queues.clone(), place, faults.clone(), metrics.clone()));
        let mut workers = Vec::new();
        for (d, queue) in config.deliver.iter().zip(queues) {
            let make = make(d);
            let target = Some(make().with_context(|| format!("[[deliver]] {}", d.name))?);
            let worker = Worker {
                queue,
                ledger: ledger.clone(),
                faults: faults.clone(),
                metrics: metrics.clone(),
                clock: clock.clone(),
                make,
                target,
                pause: worker::FIRST_PAUSE,
                round: 0,
            };
            workers.push((worker, clock.now()));
        }
        let mut wanted: Vec<String> = config.deliver.iter().flat_map(|d| d.documents.clone()).collect();
        wanted.sort();
        wanted.dedup();
        let keep = Keep::open(dir, disk, ledger.clone(), mark, faults.clone(), metrics.clone());
        Ok((Self(Arc::new(Handed { ledger, wanted })), Delivery { keep, workers, clock }))
    }

    /// Whether any receiver wants documents of this kind.
    #[must_use]
    pub fn wants(&self, kind: Kind) -> bool {
        self.0.wanted.iter().any(|wanted| wanted == kind.name())
    }

    /// Hands a document over; never waits.
    pub fn offer(&self, item: Item) {
        self.0.ledger.offer(&Arc::new(item));
    }

    /// Why documents are sent without being stored; `None` while the disk responds.
    #[must_use]
    pub fn stall(&self) -> Option<String> {
        let (taken, lacking) = self.0.ledger.stall()?;
        let s = taken.as_secs();
        let what = "they are sent all the same, and those that wait are lost if the daemon ends before it answers";
        Some(format!("the disk has not answered for {s} s: {lacking} documents for receivers are not stored; {what}"))
    }
}

/// The other end of an [`Outbox`], without threads.
pub struct Delivery {
    keep: Keep,
    /// Receivers, each with the time of its next attempt.
    workers: Vec<(Worker, Instant)>,
    clock: Clock,
}

impl Delivery {
    /// Stores what was handed over, and sends nothing.
    pub fn store(&mut self) {
        self.keep.turn();
    }

    /// Stores what was handed over and sends what waits; true if all of it is stored.
    pub fn turn(&mut self) -> bool {
        self.keep.turn();
        for (worker, not_before) in &mut self.workers {
            while self.clock.now() >= *not_before {
                match worker.step(Duration::ZERO) {
                    Step::Next => {}
                    Step::Wait(pause) => *not_before = self.clock.now() + pause,
                    Step::Idle | Step::Closed => break,
                }
            }
        }
        self.keep.turn();
        self.keep.is_stored()
    }

    /// Number of documents that wait for receivers.
    #[must_use]
    pub fn waiting(&self) -> usize {
        self.workers.iter().map(|(worker, _)| worker.queue.len()).sum()
    }
}

#[cfg(test)]
mod tests;
