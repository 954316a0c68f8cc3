//! The end of a run: waits for the threads, and reports those and the recordings that did not end cleanly.

use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use anyhow::bail;
use sd_notify::NotifyState;

use super::engine_thread::notify_system;
use crate::daemon::sink::recorder::Progress;

/// How long the threads may take to end, or make no progress: with the steps after it, shutdown takes at most five seconds,
/// even on a busy machine.
const STOP_WITHIN: Duration = Duration::from_secs(3);
/// How long the recorder may take in any case: it has one file for every thousand loops to finish. A file that is left
/// unfinished is not lost, but is neither sealed nor indexed.
const RECORDER_WITHIN: Duration = Duration::from_secs(60);
/// How long it may go without progress between two files.
const STANDS_WITHIN: Duration = Duration::from_secs(15);
/// How often a long shutdown is reported to the system.
const NOTIFY_EVERY: Duration = Duration::from_secs(1);
/// Name of the thread that keeps the recording folder, and how long it may take to end.
pub const RETENTION: &str = "retention";
const RETENTION_WITHIN: Duration = Duration::from_millis(300);
/// Interval between checks whether the threads still run.
const THREADS_EVERY: Duration = Duration::from_secs(1);
/// The same during shutdown.
const LOOK_AGAIN: Duration = Duration::from_millis(5);

/// A thread of the daemon, with its name.
pub type NamedThread = (&'static str, JoinHandle<()>);

/// Returns when a thread has ended unexpectedly: with a part of its threads the daemon would look alive, and nothing would
/// restart it.
pub async fn unasked_end(threads: &[NamedThread]) -> &'static str {
    loop {
        if let Some((name, _)) = threads.iter().find(|(_, thread)| thread.is_finished()) {
            tracing::error!(thread = name, "ended unasked: the daemon ends too, so that it can be started again");
            return name;
        }
        tokio::time::sleep(THREADS_EVERY).await;
    }
}

/// Waits for the threads to end, for a limited time.
///
/// # Errors
/// Names every thread that panicked, hangs or ended unexpectedly, and every recording that is not finished.
pub async fn join(threads: Vec<NamedThread>, unasked: Option<&str>, progress: &Progress) -> anyhow::Result<()> {
    let mut patience = Patience::new(Instant::now(), STOP_WITHIN, progress.steps());
    let mut wrong: Vec<String> = unasked.map(|name| format!("the {name} thread ended unasked")).into_iter().collect();
    for (name, thread) in threads {
        wait_for(name, &thread, &mut patience, progress).await;
        if thread.is_finished() {
            if thread.join().is_err() {
                wrong.push(format!("the {name} thread panicked"));
            }
        } else if name != RETENTION {
            wrong.push(format!("the {name} thread did not end in time"));
        }
    }
    let files = progress.unfinished();
    if !files.is_empty() {
        let remedy = "each is readable up to its last flush, see stictiond recover";
        wrong.push(format!("recordings not finished ({remedy}): {}", files.join(", ")));
    }
    if wrong.is_empty() {
        return Ok(());
    }
    bail!(wrong.join("; "))
}

/// Waits until a thread has ended or the time is up.
async fn wait_for(name: &str, thread: &JoinHandle<()>, patience: &mut Patience, progress: &Progress) {
    // This thread holds nothing that a crash could harm, and with its low priority it gets a core last on a busy machine.
    let short = (name == RETENTION).then(|| Instant::now() + RETENTION_WITHIN);
    let mut notified = Instant::now();
    while !thread.is_finished() {
        let now = Instant::now();
        if patience.is_over(now, progress.steps()) || short.is_some_and(|until| now >= until) {
            return;
        }
        if now >= notified + NOTIFY_EVERY {
            notified = now;
            let longer = u32::try_from((2 * STANDS_WITHIN).as_micros()).unwrap_or(u32::MAX);
            notify_system(&[NotifyState::ExtendTimeoutUsec(longer)]);
        }
        tokio::time::sleep(LOOK_AGAIN).await;
    }
}

/// How long to wait for threads: a fixed time, extended while the recorder makes progress.
struct Patience {
    begun: Instant,
    until: Instant,
    limit: Duration,
    done: [u64; 2],
}

impl Patience {
    fn new(now: Instant, limit: Duration, done: [u64; 2]) -> Self {
        Self { begun: now, until: now + limit, limit, done }
    }

    /// Whether to give up, given the number of steps that the recorder has done.
    fn is_over(&mut self, now: Instant, done: [u64; 2]) -> bool {
        if done != self.done && now < self.begun + RECORDER_WITHIN {
            // A disk that has finished a file works, so it may take longer over the next one.
            let stands = if done[1] > 0 { STANDS_WITHIN.max(self.limit) } else { self.limit };
            (self.done, self.until) = (done, self.until.max(now + stands));
        }
        now >= self.until
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_recorder_that_goes_on_is_waited_for_and_one_that_stands_is_not() {
        let start = Instant::now();
        let at = |ms: u64| start + Duration::from_millis(ms);
        let mut patience = Patience::new(start, Duration::from_secs(3), [5, 0]);
        assert!(!patience.is_over(at(2900), [5, 0]));
        assert!(!patience.is_over(at(2999), [6, 0]), "an item was taken");
        assert!(!patience.is_over(at(5990), [6, 0]) && patience.is_over(at(5999), [6, 0]));
        let mut patience = Patience::new(start, Duration::from_secs(3), [5, 0]);
        assert!(!patience.is_over(at(2000), [5, 1]), "a file was finished");
        assert!(!patience.is_over(at(16_900), [5, 1]) && patience.is_over(at(17_000), [5, 1]));
        let mut patience = Patience::new(start, Duration::from_secs(3), [0, 0]);
        let until = (0..200).find(|s| patience.is_over(at(1000 * s), [0, *s])).unwrap();
        assert_eq!(until, 74, "not for ever");
    }

    fn joined(threads: Vec<NamedThread>, unasked: Option<&str>, progress: &Progress) -> anyhow::Result<()> {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        runtime.block_on(join(threads, unasked, progress))
    }

    #[test]
    fn a_thread_that_hangs_and_the_recording_that_it_leaves_are_named() {
        let (release, hang) = std::sync::mpsc::channel::<()>();
        let hangs = std::thread::spawn(move || assert!(hang.recv().is_err()));
        let panics = std::thread::spawn(|| panic!("on purpose"));
        let ends = std::thread::spawn(|| {});
        let progress = Progress::default();
        progress.open(0, "rec/a.mcap.part".into());
        progress.open(1, "rec/b.mcap.part".into());
        progress.fail(1, "no space");
        let threads = vec![("recorder", hangs), ("state", panics), ("publisher", ends)];
        let error = joined(threads, None, &progress).unwrap_err().to_string();
        for part in [
            "the recorder thread did not end in time",
            "the state thread panicked",
            "rec/a.mcap.part, rec/b.mcap.part: no space",
        ] {
            assert!(error.contains(part), "{error}");
        }
        assert!(!error.contains("publisher"), "{error}");
        drop(release);
        let ended = vec![("engine", std::thread::spawn(|| {}))];
        assert!(joined(ended, Some("engine"), &Progress::default()).unwrap_err().to_string().contains("unasked"));
        assert!(joined(Vec::new(), None, &Progress::default()).is_ok());
    }
}
