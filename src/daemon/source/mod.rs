//! Where samples come from: the bus, behind a bounded queue that the engine drains.

pub mod askers;
pub mod descriptors;
pub mod keys;
pub mod message_buf;
pub mod presence;
pub mod queries;
pub mod replies;
pub mod shares;
pub mod zenoh;

use std::sync::Arc;

use crossbeam_channel::Sender;

use crate::runtime::clock::Clock;
use crate::runtime::metrics::Metrics;
use crate::runtime::queue::{Budget, Room};
use message_buf::{BufferPool, MessageBuf};
use shares::{Share, Shares};
use stiction_engine::codec::MAX_PAYLOAD;

/// One message as it arrived, before anything was read from it.
#[derive(Debug)]
pub struct Message {
    /// Key, encoding and bytes.
    pub buf: MessageBuf,
    /// The bus's time stamp, ns since 1970.
    pub bus_ns: Option<i64>,
    /// Who published it, if it says so.
    pub sender: Option<u64>,
    /// When it arrived, ns since 1970.
    pub arrival_ns: i64,
    /// Its bytes of the queue's budget.
    pub room: Room,
    /// Its part of what its key may hold of the queue.
    pub share: Share,
}

/// Requests that may wait for the engine: more than all who may ask have at a time.
pub const CONTROL_QUEUE: usize = 2 * askers::WAITING;

/// The way into the engine's queue: bounded, never waits, counts what finds no place.
#[derive(Clone)]
pub struct Intake {
    queue: Sender<Message>,
    budget: Budget,
    shares: Shares,
    pool: BufferPool,
    metrics: Arc<Metrics>,
    clock: Clock,
}

/// A message as the bus hands it over.
#[derive(Debug, Clone, Copy)]
pub struct Envelope<'a> {
    /// Its key.
    pub key: &'a str,
    /// The encoding that it says it has, if it says one.
    pub encoding: Option<&'a str>,
    /// The bus's time stamp, ns since 1970.
    pub bus_ns: Option<i64>,
    /// Who published it, if it says so.
    pub sender: Option<u64>,
}

impl Intake {
    /// Into this queue, within this budget and these shares of it.
    #[must_use]
    pub fn new(
        queue: Sender<Message>,
        (budget, shares): (Budget, Shares),
        metrics: Arc<Metrics>,
        clock: Clock,
    ) -> Self {
        Self { queue, budget, shares, pool: BufferPool::default(), metrics, clock }
    }

    /// A deletion: the plant has none that mean anything.
    pub fn delete(&self) {
        self.metrics.deletes.inc();
    }

    /// Takes a message of so many bytes; the payload is asked for only where there is room for it. Once as many messages
    /// have come as wait at a time, no memory is taken for a further one.
    pub fn take(&self, envelope: &Envelope<'_>, bytes: usize, payload: impl FnOnce(&mut Vec<u8>)) {
        self.metrics.messages.inc();
        if bytes > MAX_PAYLOAD {
            self.metrics.undecodable.inc();
            return;
        }
        let held = size_of::<Message>() + envelope.key.len() + envelope.encoding.map_or(0, str::len) + bytes;
        let Some(room) = self.budget.take(held) else {
            self.metrics.dropped_input.inc();
            return;
        };
        let free = [
            self.queue.capacity().unwrap_or(usize::MAX).saturating_sub(self.queue.len()),
            self.budget.limit().saturating_sub(self.budget.used()),
        ];
        let Some(share) = self.shares.take(envelope.key, held, free) else {
            self.metrics.dropped_input.inc();
            self.metrics.over_share.inc();
            return;
        };
        let message = Message {
            buf: self.pool.pack(envelope.key, envelope.encoding, payload),
            bus_ns: envelope.bus_ns,
            sender: envelope.sender,
            arrival_ns: self.clock.now_ns(),
            room,
            share,
        };
        if self.queue.try_send(message).is_err() {
            self.metrics.dropped_input.inc();
        }
    }
}
