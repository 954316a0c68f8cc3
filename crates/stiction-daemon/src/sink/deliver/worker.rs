//! One receiver's thread: sends one document after the other, and decides which of the two is at fault when that fails.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::time::Duration;

use crossbeam_channel::Sender;

use super::dead::{DEAD_LETTERS, DeadLetters};
use super::keep::Change;
use super::queue::{Next, Queue};
use super::{Failure, IDLE, Item, LOSS_SHOWN, Target};
use stiction_runtime::faults::Faults;
use stiction_runtime::metrics::Metrics;

/// Pauses after a failure: the first, and what they double up to.
pub(super) const FIRST_PAUSE: Duration = if cfg!(test) { Duration::from_millis(20) } else { Duration::from_secs(1) };
const LONGEST_PAUSE: Duration = if cfg!(test) { Duration::from_millis(100) } else { Duration::from_secs(60) };
/// Failed attempts after which other documents show whether the receiver or this document is at fault.
const ATTEMPTS: u32 = 4;
/// Attempts after which a document is given up that was answered with a refusal and beside which nothing else could be
/// tried: those of a day.
const MOST_ATTEMPTS: u32 = if cfg!(test) { 20 } else { 1440 };

/// Makes what sends to a receiver; nothing is connected yet.
pub type MakeTarget = Box<dyn Fn() -> anyhow::Result<Box<dyn Target>> + Send>;

/// What comes after a step.
pub(super) enum Step {
    /// The next one.
    Next,
    /// The next one after this pause.
    Wait(Duration),
    /// Nothing waits.
    Idle,
    /// The queue is closed.
    Closed,
}

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
    /// The connection; none before the first document and after a panic.
    pub target: Option<Box<dyn Target>>,
    /// Pause after the next failure.
    pub pause: Duration,
    /// Documents of other loops that were tried beside the first one.
    pub round: usize,
}

impl Worker {
    /// Works until the queue is closed. After a panic it goes on with a new connection.
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

    /// Sends what waits longest, if anything comes within this time.
    pub fn step(&mut self, patience: Duration) -> Step {
        let (seq, item) = match self.queue.next(patience) {
            Next::Closed => return Step::Closed,
            Next::Nothing => return Step::Idle,
            Next::Send(seq, item) => (seq, item),
        };
        let Err(failed) = self.attempt(seq, &item) else { return self.went_on() };
        let attempts = self.queue.attempts(seq);
        if attempts >= MOST_ATTEMPTS && failed.answered {
            self.give_up(seq, &item, &failed.why);
            return self.went_on();
        }
        if attempts >= ATTEMPTS
            && let Some((other_seq, other)) = self.queue.of_other_loop(seq, self.round)
        {
            self.round += 1;
            if self.attempt(other_seq, &other).is_ok() {
                // The receiver takes others. It may have come back just now, so this one gets a last chance.
                if let Err(NotNow { why, .. }) = self.attempt(seq, &item) {
                    self.give_up(seq, &item, &format!("{why}; it took other documents meanwhile"));
                }
                return self.went_on();
            }
        }
        let pause = failed.pause.unwrap_or(self.pause).min(LONGEST_PAUSE);
        self.pause = (2 * self.pause).min(LONGEST_PAUSE);
        Step::Wait(pause)
    }

    const fn went_on(&mut self) -> Step {
        (self.pause, self.round) = (FIRST_PAUSE, 0);
        Step::Next
    }

    /// Sends one document once. `Ok` where it waits no longer: the receiver has it, or refuses it for good.
    fn attempt(&mut self, seq: u64, item: &Item) -> Result<(), NotNow> {
        self.queue.count_attempt(seq);
        let sent = catch_unwind(AssertUnwindSafe(|| self.send(item))).unwrap_or_else(|_| {
            self.restart();
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

    fn send(&mut self, item: &Item) -> Result<(), Failure> {
        let target = match &mut self.target {
            Some(target) => target,
            place => place.insert((self.make)().map_err(|e| Failure::Unanswered(format!("{e:#}")))?),
        };
        target.send(item)
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
