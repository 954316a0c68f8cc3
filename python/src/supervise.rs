//! Work on threads without Python's lock. The calling thread waits, reports progress and handles Ctrl-C; after an
//! interruption the work is asked to stop and not waited for.

use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::mpsc::{RecvTimeoutError, sync_channel};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;

/// How often Ctrl-C and progress are checked.
const LOOK: Duration = Duration::from_millis(50);

/// Progress of the work, and whether it should stop.
#[derive(Debug, Default)]
pub struct Watch {
    stop: AtomicBool,
    done: AtomicU64,
    total: AtomicU64,
}

impl Watch {
    /// Whether the caller is gone.
    pub fn stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// Sets the total.
    pub fn expect(&self, total: u64) {
        self.total.store(total, Ordering::Relaxed);
    }

    /// Sets the amount done.
    pub fn reached(&self, done: u64) {
        self.done.store(done, Ordering::Relaxed);
    }

    /// Adds one to the amount done.
    pub fn one_more(&self) {
        self.done.fetch_add(1, Ordering::Relaxed);
    }
}

/// Runs the work on its own thread.
///
/// # Errors
/// An exception of Ctrl-C or `progress`; an internal error.
pub fn supervised<R: Send + 'static>(
    py: Python<'_>,
    progress: Option<&Py<PyAny>>,
    work: impl FnOnce(&Watch) -> R + Send + 'static,
) -> PyResult<R> {
    let watch = Arc::new(Watch::default());
    let (send, answers) = sync_channel(1);
    let theirs = Arc::clone(&watch);
    std::thread::spawn(move || {
        // After an interruption there is no receiver.
        let _ = send.send(work(&theirs));
    });
    let answers = Mutex::new(answers);
    let mut told = None;
    let mut tell = |py: Python<'_>| -> PyResult<()> {
        let now = (watch.done.load(Ordering::Relaxed), watch.total.load(Ordering::Relaxed));
        if let Some(progress) = progress.filter(|_| now.1 > 0 && told.replace(now) != Some(now)) {
            progress.call1(py, now)?;
        }
        Ok(())
    };
    loop {
        let answer = py.detach(|| match answers.lock() {
            Ok(answers) => answers.recv_timeout(LOOK),
            Err(_) => Err(RecvTimeoutError::Disconnected),
        });
        match answer {
            Ok(answer) => {
                tell(py)?;
                return Ok(answer);
            }
            Err(RecvTimeoutError::Disconnected) => {
                return Err(PyRuntimeError::new_err("internal error in stiction; please report it with the record"));
            }
            Err(RecvTimeoutError::Timeout) => {
                if let Err(raised) = py.check_signals().and_then(|()| tell(py)) {
                    watch.stop.store(true, Ordering::Relaxed);
                    return Err(raised);
                }
            }
        }
    }
}

/// Runs `job(0)` to `job(jobs - 1)` on this many threads and waits for all.
pub fn on_threads(threads: usize, jobs: usize, job: &(dyn Fn(usize) + Sync)) {
    let next = AtomicUsize::new(0);
    let share = || {
        loop {
            let index = next.fetch_add(1, Ordering::Relaxed);
            if index >= jobs {
                return;
            }
            job(index);
        }
    };
    std::thread::scope(|scope| {
        // This thread works too.
        for _ in 1..threads.min(jobs) {
            scope.spawn(share);
        }
        share();
    });
}

/// The requested number of threads, or one per core.
pub fn threads(asked: Option<usize>) -> usize {
    asked.unwrap_or_else(|| std::thread::available_parallelism().map_or(1, std::num::NonZero::get)).max(1)
}
