//! One receiver's thread: sends one document at a time, and decides after failures whether the receiver or the document is at
//! fault.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::time::{Duration, Instant};

use super::ledger::{Ledger, Letter};
use super::queue::{Next, Queue, Tried};
use super::{Failure, IDLE, Item, LOSS_SHOWN, Target};
use crate::runtime::clock::Clock;
use crate::runtime::faults::Faults;
use crate::runtime::metrics::Metrics;

/// Pauses after a failure: the first, and the longest after doubling.
pub(super) const FIRST_PAUSE: Duration = if cfg!(test) { Duration::from_millis(20) } else { Duration::from_secs(1) };
const LONGEST_PAUSE: Duration = if cfg!(test) { Duration::from_millis(100) } else { Duration::from_secs(60) };
/// Failed attempts after which other documents are tried, to see whether the receiver or this document is at fault.
const ATTEMPTS: u32 = 4;
/// A document is given up if it failed this often right after the receiver had taken another one, over at least this time: of
/// several machines behind one address some may be down, or come back later than others.
const PASSED: u32 = 4;
const PASSED_FOR: Duration = if cfg!(test) { Duration::from_millis(200) } else { Duration::from_secs(600) };
/// If no other document could be tried, a document is given up after this many refusals, over at least a day.
const REFUSED: u32 = if cfg!(test) { 20 } else { 1440 };
const REFUSED_FOR: Duration = if cfg!(test) { Duration::from_millis(200) } else { Duration::from_secs(86_400) };

/// Makes the target of a receiver, not yet connected.
pub type MakeTarget = Box<dyn Fn() -> anyhow::Result<Box<dyn Target>> + Send>;

/// Outcome of a step.
pub(super) enum Step {
    /// Go on with the next document.
    Next,
    /// Go on after this pause.
    Wait(Duration),
    /// Nothing waits.
    Idle,
    /// The queue is closed.
    Closed,
}

/// A failed attempt that may be repeated.
struct NotNow {
    why: String,
    /// The pause requested by the receiver.
    pause: Option<Duration>,
    /// Whether the receiver responded.
    answered: bool,
}

/// Everything that a receiver's thread owns.
pub(super) struct Worker {
    pub queue: Arc<Queue>,
    pub ledger: Arc<Ledger>,
    pub faults: Arc<Faults>,
    pub metrics: Arc<Metrics>,
    pub clock: Clock,
    pub make: MakeTarget,
    /// The connection; `None` before the first document and after a panic.
    pub target: Option<Box<dyn Target>>,
    /// Pause after the next failure.
    pub pause: Duration,
    /// Number of documents of other loops that were tried in place of the first one.
    pub round: usize,
}

impl Worker {
    /// Works until the queue is closed. After a panic it continues with a new connection.
    pub fn supervise(&mut self) {
        while catch_unwind(AssertUnwindSafe(|| self.run())).is_err() {
            self.restart();
            if self.queue.pause(FIRST_PAUSE) {
                return;
            }
        }
    }

    fn restart(&mut self) {
        self.target = None;
        self.metrics.delivery_restarts.inc();
        let name = &self.queue.name;
        let text = format!("{name}: the thread that delivers panicked and was restarted; the log shows where");
        self.faults.raise_for(&format!("restart of {name}"), text, LOSS_SHOWN);
    }

    fn run(&mut self) {
        loop {
            match self.step(IDLE) {
                Step::Next => {}
                Step::Wait(pause) => {
                    if self.queue.pause(pause) {
                        return;
                    }
                }
                Step::Idle => {}
                Step::Closed => return,
            }
        }
    }

    /// Sends the document that has waited longest, if one comes within this time.
    pub fn step(&mut self, patience: Duration) -> Step {
        let (seq, item) = match self.queue.next(patience) {
            Next::Closed => return Step::Closed,
            Next::Nothing => return Step::Idle,
            Next::Send(seq, item) => (seq, item),
        };
        let Err(failed) = self.attempt(seq, &item) else { return self.went_on() };
        let tried = self.queue.tried(seq);
        if failed.answered && tried.refused >= REFUSED && self.is_past(tried.refused_at, REFUSED_FOR) {
            self.give_up(seq, &item, &failed.why);
            return self.went_on();
        }
        if tried.sent >= ATTEMPTS
            && let Some((other_seq, other)) = self.queue.of_other_loop(seq, self.round)
        {
            self.round += 1;
            if self.attempt(other_seq, &other).is_ok() {
                self.try_beside(seq, &item);
                return self.went_on();
            }
        }
        let pause = failed.pause.unwrap_or(self.pause).clamp(FIRST_PAUSE, LONGEST_PAUSE);
        self.pause = (2 * self.pause).min(LONGEST_PAUSE);
        Step::Wait(pause)
    }

    /// Tries a document again just after the receiver took another one, since the receiver may have recovered at that moment. A
    /// document that fails repeatedly in this way is itself at fault.
    fn try_beside(&mut self, seq: u64, item: &Arc<Item>) {
        let Err(NotNow { why, .. }) = self.attempt(seq, item) else { return };
        let now = self.clock.now();
        self.queue.note(seq, |tried| {
            tried.passed += 1;
            tried.passed_at.get_or_insert(now);
        });
        let tried = self.queue.tried(seq);
        if tried.passed >= PASSED && self.is_past(tried.passed_at, PASSED_FOR) {
            self.give_up(seq, item, &format!("{why}; it took other documents meanwhile"));
        }
    }

    fn is_past(&self, begun: Option<Instant>, lasting: Duration) -> bool {
        begun.is_some_and(|begun| self.clock.since(begun) >= lasting)
    }

    const fn went_on(&mut self) -> Step {
        (self.pause, self.round) = (FIRST_PAUSE, 0);
        Step::Next
    }

    /// Sends one document once. `Ok` if it no longer waits: the receiver has it, or refuses it permanently.
    fn attempt(&mut self, seq: u64, item: &Arc<Item>) -> Result<(), NotNow> {
        self.queue.note(seq, |tried| tried.sent += 1);
        let sent = catch_unwind(AssertUnwindSafe(|| self.send(item))).unwrap_or_else(|_| {
            self.restart();
            Err(Failure::Later("sending it panicked; the log shows where".to_owned(), None))
        });
        match sent {
            Ok(()) => {
                self.metrics.delivered.inc();
                self.faults.clear(&self.fault());
                if self.queue.settle(seq) {
                    self.ledger.settle(&self.queue.name, seq);
                }
                Ok(())
            }
            Err(Failure::Refused(why)) => {
                self.give_up(seq, item, &why);
                Ok(())
            }
            Err(Failure::Later(why, pause)) => {
                let now = self.clock.now();
                self.queue.note(seq, |tried| {
                    tried.refused += 1;
                    tried.refused_at.get_or_insert(now);
                });
                Err(self.not_now(NotNow { why, pause, answered: true }))
            }
            Err(Failure::Unanswered(why)) => Err(self.not_now(NotNow { why, pause: None, answered: false })),
        }
    }

    /// Counts a failed attempt and raises the fault.
    fn not_now(&self, failed: NotNow) -> NotNow {
        self.metrics.delivery_failed.inc();
        let (name, waiting) = (&self.queue.name, self.queue.len());
        let text = format!("{name} does not take documents; {waiting} wait and are tried again: {}", failed.why);
        self.faults.raise(&self.fault(), text);
        failed
    }

    fn send(&mut self, item: &Item) -> Result<(), Failure> {
        let target = match &mut self.target {
            Some(target) => target,
            place => place.insert((self.make)().map_err(|e| Failure::Unanswered(format!("{e:#}")))?),
        };
        target.send(item)
    }

    /// A document goes to the dead-letter file.
    fn give_up(&self, seq: u64, item: &Arc<Item>, why: &str) {
        self.faults.clear(&self.fault());
        let Tried { sent: attempts, .. } = self.queue.tried(seq);
        let (queue, item, why) = (self.queue.name.clone(), item.clone(), why.to_owned());
        if self.queue.settle(seq) {
            self.ledger.bury(Letter { queue, seq, item, attempts, why });
        }
    }

    fn fault(&self) -> String {
        format!("deliver {}", self.queue.name)
    }
}
