//! Work on threads without Python's lock. The calling thread waits, tells the progress and hears Ctrl-C; after an
//! interruption the work is told to stop and nobody waits for it.

use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::mpsc::{RecvTimeoutError, sync_channel};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;

/// How often Ctrl-C and the progress are looked at.
const LOOK: Duration = Duration::from_millis(50);

/// What the work says of itself, and whether it is to stop.
#[derive(Debug, Default)]
pub struct Watch {
    stop: AtomicBool,
    done: AtomicU64,
    total: AtomicU64,
}

impl Watch {
    /// Whether the caller has gone.
    pub fn stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// So much will be done.
    pub fn expect(&self, total: u64) {
        self.total.store(total, Ordering::Relaxed);
    }

    /// So much is done.
    pub fn reached(&self, done: u64) {
        self.done.store(done, Ordering::Relaxed);
    }

    /// One more is done.
    pub fn one_more(&self) {
        self.done.fetch_add(1, Ordering::Relaxed);
    }
}

/// Does the work on a thread of its own.
///
/// # Errors
/// What Ctrl-C or `progress` raised; a fault of ours in the work.
pub fn supervised<R: Send + 'static>(
    py: Python<'_>,
    progress: Option<&Py<PyAny>>,
    work: impl FnOnce(&Watch) -> R + Send + 'static,
) -> PyResult<R> {
    let watch = Arc::new(Watch::default());
    let (send, answers) = sync_channel(1);
    let theirs = Arc::clone(&watch);
    std::thread::spawn(move || {
        // Nobody listens any more after an interruption.
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
                return Err(PyRuntimeError::new_err("a fault inside stiction; please report it with the record"));
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

/// Runs `job(0)` to `job(jobs - 1)` on so many threads, and returns when all are done.
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

/// As many threads as asked for, else as there are cores.
pub fn threads(asked: Option<usize>) -> usize {
    asked.unwrap_or_else(|| std::thread::available_parallelism().map_or(1, std::num::NonZero::get)).max(1)
}
