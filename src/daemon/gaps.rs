//! Gap diagnoses on one thread of the lowest priority, with a bounded queue; answers come through a channel.
//!
//! The thread does not use the workers of the estimates. It starts a search, and continues after each round, only while no
//! window waits for a worker; on Linux it also has the lowest scheduling priority. A search that waits too long ends with its
//! result so far, or is skipped; the engine's thread records either as an input, which replay follows.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use crossbeam_channel::{Receiver, Sender};

use stiction::core::gap::Executor;
use stiction_engine::engine::{GapRequest, LoopId, PublishedGap, SkipReason};

/// Requests that may wait. Beyond that a person is refused, and the daemon's own requests are skipped.
pub const QUEUE: usize = 64;
/// Pause before the next check whether windows wait.
const PAUSE: Duration = Duration::from_millis(50);
/// Pauses in one diagnosis, in total, after which it is ended: a quarter of an hour.
const PATIENCE: u32 = 18_000;

/// Outcome of a request.
#[derive(Debug)]
pub enum Outcome {
    /// A document, and the number of evaluations after which the search was ended early, if it was.
    Done(Box<PublishedGap>, Option<u64>),
    /// No document: the reason, and its text.
    Skipped(SkipReason, String),
}

/// A finished request.
#[derive(Debug)]
pub struct Diagnosed {
    /// The loop.
    pub id: LoopId,
    /// The request's number.
    pub number: u64,
    /// The answer.
    pub outcome: Outcome,
}

/// The caller's ends of the channels. The thread ends at the next pause of its search after this is dropped.
pub struct Diagnoser {
    /// Requests go in here.
    pub requests: Sender<GapRequest>,
    /// Answers come out here, in order.
    pub answers: Receiver<Diagnosed>,
    stop: Arc<AtomicBool>,
}

impl Drop for Diagnoser {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
    }
}

impl Diagnoser {
    /// Starts the thread; `busy` says whether windows wait for a worker.
    ///
    /// # Errors
    /// The system refuses a thread.
    pub fn start(busy: impl Fn() -> bool + Send + Sync + 'static) -> std::io::Result<Self> {
        let (diagnoser, jobs, finished) = Self::ends();
        let stopped = diagnoser.stop.clone();
        std::thread::Builder::new().name("gap".into()).spawn(move || {
            yield_to_all();
            for request in jobs {
                let gate = Gate::new(&busy, || std::thread::sleep(PAUSE), &stopped, PATIENCE);
                let (id, number) = (request.id, request.number);
                let answer = Diagnosed { id, number, outcome: diagnose(&request, &gate) };
                if finished.send(answer).is_err() {
                    return;
                }
            }
        })?;
        Ok(diagnoser)
    }

    /// This end, and the two ends that the thread would hold: the receiver of requests and the sender of answers.
    #[must_use]
    pub fn ends() -> (Self, Receiver<GapRequest>, Sender<Diagnosed>) {
        let (requests, jobs) = crossbeam_channel::bounded::<GapRequest>(QUEUE);
        let (finished, answers) = crossbeam_channel::unbounded();
        (Self { requests, answers, stop: Arc::default() }, jobs, finished)
    }
}

/// Gives this thread the lowest priority of the system, on Linux only.
pub(super) fn yield_to_all() {
    #[cfg(target_os = "linux")]
    if let Err(error) = rustix::process::setpriority_process(Some(rustix::thread::gettid()), 19) {
        tracing::debug!(%error, "gap diagnoses run at the usual priority");
    }
}

fn diagnose(request: &GapRequest, gate: &Gate<'_>) -> Outcome {
    if !gate.open() {
        return Outcome::Skipped(SkipReason::QueueFull, "the machine is too busy for it: ask again later".to_owned());
    }
    match catch_unwind(AssertUnwindSafe(|| request.compute(gate))) {
        Ok(Ok(document)) => Outcome::Done(Box::new(document), gate.cut()),
        Ok(Err(error)) => Outcome::Skipped(SkipReason::Failed, error.to_string()),
        Err(_) => Outcome::Skipped(SkipReason::Failed, "the search failed; see the log".to_owned()),
    }
}

/// Lets a search continue while nothing more urgent waits. It has one thread, and results do not depend on how often it waited.
pub struct Gate<'a> {
    busy: &'a (dyn Fn() -> bool + Sync),
    pause: Box<dyn Fn() + Sync + 'a>,
    stop: &'a AtomicBool,
    patience: AtomicU32,
    cut: Mutex<Option<u64>>,
}

impl<'a> Gate<'a> {
    /// A gate that calls `pause` while `busy` is true, at most `patience` times.
    pub fn new(
        busy: &'a (dyn Fn() -> bool + Sync),
        pause: impl Fn() + Sync + 'a,
        stop: &'a AtomicBool,
        patience: u32,
    ) -> Self {
        Self { busy, pause: Box::new(pause), stop, patience: patience.into(), cut: Mutex::new(None) }
    }

    /// Waits until nothing more urgent waits; false if that takes too long or the daemon stops.
    fn open(&self) -> bool {
        while !self.stop.load(Ordering::Relaxed) {
            if !(self.busy)() {
                return true;
            }
            let left = self.patience.load(Ordering::Relaxed);
            if left == 0 {
                return false;
            }
            self.patience.store(left - 1, Ordering::Relaxed);
            (self.pause)();
        }
        false
    }

    /// The evaluations after which it ended the search, if it did.
    fn cut(&self) -> Option<u64> {
        *self.cut.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Executor for Gate<'_> {
    fn run(&self, jobs: usize, job: &(dyn Fn(usize) + Sync)) {
        (0..jobs).for_each(job);
    }

    fn tick(&self, done: u64) -> bool {
        let open = self.open();
        if !open {
            self.cut.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(done);
        }
        open
    }
}

/// Ends a search after the given number of evaluations, as the live run did; `None` never ends it.
#[derive(Debug, Clone, Copy)]
pub struct Until(pub Option<u64>);

impl Executor for Until {
    fn run(&self, jobs: usize, job: &(dyn Fn(usize) + Sync)) {
        (0..jobs).for_each(job);
    }

    fn tick(&self, done: u64) -> bool {
        self.0.is_none_or(|cut| done < cut)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_search_waits_while_windows_wait_and_then_goes_on() {
        let (waiting, pauses, stop) = (AtomicU32::new(5), AtomicU32::new(0), AtomicBool::new(false));
        let busy = || waiting.load(Ordering::Relaxed) > 0;
        let pause = || {
            pauses.fetch_add(1, Ordering::Relaxed);
            waiting.fetch_sub(1, Ordering::Relaxed);
        };
        let gate = Gate::new(&busy, pause, &stop, 100);
        assert!(gate.tick(7) && gate.tick(8));
        assert_eq!((pauses.load(Ordering::Relaxed), gate.cut()), (5, None));
    }

    #[test]
    fn patience_ends_a_search_at_its_evaluations_and_a_replay_ends_it_there() {
        let (busy_from, ticks, stop) = (3, AtomicU32::new(0), AtomicBool::new(false));
        let busy = || ticks.load(Ordering::Relaxed) >= busy_from;
        let gate = Gate::new(&busy, || {}, &stop, 10);
        let search = |executor: &dyn Executor| {
            let mut done = 0;
            while done < 1000 {
                ticks.fetch_add(1, Ordering::Relaxed);
                done += 100;
                if !executor.tick(done) {
                    break;
                }
            }
            done
        };
        assert_eq!((search(&gate), gate.cut()), (300, Some(300)));
        assert_eq!((search(&Until(gate.cut())), search(&Until(None))), (300, 1000));
    }

    #[test]
    fn a_stop_ends_a_search_at_once() {
        let stop = AtomicBool::new(true);
        let gate = Gate::new(&|| false, || {}, &stop, 10);
        assert!(!gate.tick(40) && !gate.tick(50));
        assert_eq!(gate.cut(), Some(40));
    }
}
