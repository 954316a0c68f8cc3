//! Windows are cut and fitted here, off the engine's thread, by a few workers that take the next window of the schedule;
//! answers come back through a channel.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, Sender};

use stiction_engine::engine::{LoopId, Request, WindowAnswer};

/// A window for a worker.
#[derive(Debug)]
pub struct Job {
    /// The window to compute.
    pub request: Request,
    /// Arrival time of the sample that made it due, ns.
    pub arrival_ns: i64,
}

/// A computed window.
#[derive(Debug)]
pub struct Answered {
    /// The loop.
    pub id: LoopId,
    /// Its window's sequence number.
    pub seq: u64,
    /// End of the window, which identifies it, ns.
    pub end_ns: i64,
    /// Arrival time of the sample that made it due, ns.
    pub arrival_ns: i64,
    /// How long the window took.
    pub took: Duration,
    /// `None` if the fit failed.
    pub answer: Option<WindowAnswer>,
}

/// The caller's ends of the channels. The threads end when `jobs` is dropped.
pub struct Workers {
    /// Takes windows.
    pub jobs: Sender<Job>,
    /// Gives answers, in any order.
    pub answers: Receiver<Answered>,
}

/// Starts `count` workers, by default on all cores but one, and at least one.
///
/// # Errors
/// The system refuses a thread.
pub fn start(count: Option<usize>) -> std::io::Result<Workers> {
    let cores = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    let count = count.unwrap_or(cores.saturating_sub(1)).max(1);
    // One window in advance for each worker: those further back can still be overtaken.
    let (jobs, waiting) = crossbeam_channel::bounded::<Job>(count);
    let (finished, answers) = crossbeam_channel::unbounded();
    for index in 0..count {
        let (waiting, finished) = (waiting.clone(), finished.clone());
        let thread = std::thread::Builder::new().name(format!("fit-{index}"));
        thread.spawn(move || {
            for Job { request, arrival_ns } in waiting {
                // A fit that panics must cost only its window, not the worker and all later windows of the loop.
                let began = Instant::now();
                let answer = catch_unwind(AssertUnwindSafe(|| request.compute())).ok();
                let (id, seq, end_ns, took) = (request.id, request.seq, request.end_ns, began.elapsed());
                let answered = Answered { id, seq, end_ns, arrival_ns, took, answer };
                if finished.send(answered).is_err() {
                    return;
                }
            }
        })?;
    }
    Ok(Workers { jobs, answers })
}
