//! One receiver's thread: sends one document after the other, and decides which of the two is at fault when that fails.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::time::Duration;

use crossbeam_channel::Sender;

use super::dead::{DEAD_LETTERS, DeadLetters};
use super::keep::Change;
use super::queue::{Next, Queue};
use super::{Failure, IDLE, Item, LOSS_SHOWN, Target};
use crate::daemon::faults::Faults;
use crate::daemon::metrics::Metrics;

/// Pauses after a failure: the first, and what they double up to.
const FIRST_PAUSE: Duration = if cfg!(test) { Duration::from_millis(20) } else { Duration::from_secs(1) };
const LONGEST_PAUSE: Duration = if cfg!(test) { Duration::from_millis(100) } else { Duration::from_secs(60) };
/// Failed attempts after which other documents show whether the receiver or this document is at fault.
const ATTEMPTS: u32 = 4;
/// Attempts after which a document is given up that was answered with a refusal and beside which nothing else could be
/// tried: those of a day.
const MOST_ATTEMPTS: u32 = if cfg!(test) { 20 } else { 1440 };

/// Makes what sends to a receiver; nothing is connected yet.
pub(super) type MakeTarget = Box<dyn Fn() -> anyhow::Result<Box<dyn Target>> + Send>;

/// Why a document was not taken now.
struct NotNow {
    why: String,
    /// The pause that the receiver asks for.
    pause: Option<Duration>,
    /// Whether the receiver said so.
    answered: bool,
}

/// What a receiver's thread works with.
pub(super) struct Worker {
    pub queue: Arc<Queue>,
    pub changes: Sender<Change>,
    pub dead: Arc<DeadLetters>,
    pub faults: Arc<Faults>,
    pub metrics: Arc<Metrics>,
    pub make: MakeTarget,
}

impl Worker {
    /// Works until the queue is closed. After a panic it goes on with a new connection.
    pub fn supervise(&self, first: Box<dyn Target>) {
        let mut target = Some(first);
        while catch_unwind(AssertUnwindSafe(|| self.run(&mut target))).is_err() {
            self.restart(&mut target);
            if self.queue.pause(FIRST_PAUSE) {
                return;
            }
        }
    }

    fn restart(&self, target: &mut Option<Box<dyn Target>>) {
        *target = None;
        self.metrics.delivery_restarts.inc();
        let name = &self.queue.name;
        let text = format!("{name}: the thread that delivers panicked and was restarted; the log shows where");
        self.faults.raise_for(&format!("restart of {name}"), text, LOSS_SHOWN);
    }

    fn run(&self, target: &mut Option<Box<dyn Target>>) {
        let (mut pause, mut round) = (FIRST_PAUSE, 0);
        loop {
            let (seq, item) = match self.queue.next(IDLE) {
                Next::Closed => return,
                Next::Nothing => {
                    if let Some(target) = target {
                        target.rest();
                    }
                    continue;
                }
                Next::Send(seq, item) => (seq, item),
            };
            let Err(failed) = self.attempt(target, seq, &item) else {
                (pause, round) = (FIRST_PAUSE, 0);
                continue;
            };
            let attempts = self.queue.attempts(seq);
            if attempts >= MOST_ATTEMPTS && failed.answered {
                self.give_up(seq, &item, &failed.why);
                continue;
            }
            if attempts >= ATTEMPTS
                && let Some((other_seq, other)) = self.queue.of_other_loop(seq, round)
            {
                round += 1;
                if self.attempt(target, other_seq, &other).is_ok() {
                    // The receiver takes others. It may have come back just now, so this one gets a last chance.
                    if let Err(NotNow { why, .. }) = self.attempt(target, seq, &item) {
                        self.give_up(seq, &item, &format!("{why}; it took other documents meanwhile"));
                    }
                    (pause, round) = (FIRST_PAUSE, 0);
                    continue;
                }
            }
            if self.queue.pause(failed.pause.unwrap_or(pause).min(LONGEST_PAUSE)) {
                return;
            }
            pause = (2 * pause).min(LONGEST_PAUSE);
        }
    }

    /// Sends one document once. `Ok` where it waits no longer: the receiver has it, or refuses it for good.
    fn attempt(&self, target: &mut Option<Box<dyn Target>>, seq: u64, item: &Item) -> Result<(), NotNow> {
        self.queue.count_attempt(seq);
        let sent = catch_unwind(AssertUnwindSafe(|| self.send(target, item))).unwrap_or_else(|_| {
            self.restart(target);
            Err(Failure::Later("sending it panicked; the log shows where".to_owned(), None))
        });
        match sent {
            Ok(()) => {
                self.metrics.delivered.inc();
                self.faults.clear(&self.fault());
                self.settled(seq);
                Ok(())
            }
            Err(Failure::Refused(why)) => {
                self.give_up(seq, item, &why);
                Ok(())
            }
            Err(Failure::Later(why, pause)) => Err(self.not_now(NotNow { why, pause, answered: true })),
            Err(Failure::Unanswered(why)) => Err(self.not_now(NotNow { why, pause: None, answered: false })),
        }
    }

    /// Counts a failed attempt and names the fault.
    fn not_now(&self, failed: NotNow) -> NotNow {
        self.metrics.delivery_failed.inc();
        let (name, waiting) = (&self.queue.name, self.queue.len());
        let text = format!("{name} does not take documents; {waiting} wait and are tried again: {}", failed.why);
        self.faults.raise(&self.fault(), text);
        failed
    }

    fn send(&self, target: &mut Option<Box<dyn Target>>, item: &Item) -> Result<(), Failure> {
        if target.is_none() {
            *target = Some((self.make)().map_err(|e| Failure::Unanswered(format!("{e:#}")))?);
        }
        target.as_mut().map_or(Ok(()), |target| target.send(item))
    }

    /// Puts a document into the dead-letter file.
    fn give_up(&self, seq: u64, item: &Item, why: &str) {
        self.metrics.delivery_refused.inc();
        let name = &self.queue.name;
        let kept = match self.dead.append(name, item, self.queue.attempts(seq), why) {
            Ok(()) => format!("it is in {DEAD_LETTERS}"),
            Err(error) => format!("{DEAD_LETTERS} could not be written: {error}"),
        };
        let text = format!("{name} refused {} {} of {} for good; {kept}: {why}", item.kind, item.id, item.loop_name);
        self.faults.raise_for(&format!("refused by {name}"), text, LOSS_SHOWN);
        self.faults.clear(&self.fault());
        self.settled(seq);
    }

    fn fault(&self) -> String {
        format!("deliver {}", self.queue.name)
    }

    /// The document waits no longer.
    fn settled(&self, seq: u64) {
        if self.queue.settle(seq) {
            let _ = self.changes.send(Change { queue: self.queue.name.clone(), seq });
        }
    }
}
