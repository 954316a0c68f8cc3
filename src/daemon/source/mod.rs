//! Source of samples: the bus, through a bounded queue that the engine drains.

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

/// A message as it arrived, before any of it is interpreted.
#[derive(Debug)]
pub struct Message {
    /// Key, encoding and bytes.
    pub buf: MessageBuf,
    /// The bus's time stamp, ns since 1970.
    pub bus_ns: Option<i64>,
    /// Id of the publisher, if the message has one.
    pub sender: Option<u64>,
    /// When it arrived, ns since 1970.
    pub arrival_ns: i64,
    /// Its bytes of the queue's budget.
    pub room: Room,
    /// Its part of its key's share of the queue.
    pub share: Share,
}

/// Requests that may wait for the engine: more than can wait from all askers.
pub const CONTROL_QUEUE: usize = 2 * askers::WAITING;

/// The entrance to the engine's queue: never waits, and counts the messages it has no room for.
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
    /// The encoding stated by the message, if any.
    pub encoding: Option<&'a str>,
    /// The bus's time stamp, ns since 1970.
    pub bus_ns: Option<i64>,
    /// Id of the publisher, if the message has one.
    pub sender: Option<u64>,
}

impl Intake {
    /// An entrance to this queue, with this budget and these shares of it.
    #[must_use]
    pub fn new(
        queue: Sender<Message>,
        (budget, shares): (Budget, Shares),
        metrics: Arc<Metrics>,
        clock: Clock,
    ) -> Self {
        Self { queue, budget, shares, pool: BufferPool::default(), metrics, clock }
    }

    /// Counts a deletion, which has no meaning here.
    pub fn delete(&self) {
        self.metrics.deletes.inc();
    }

    /// Takes a message of this many bytes; the payload is copied only if there is room for it. Once the buffer pool has grown
    /// to the usual number of waiting messages, this allocates no memory.
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
