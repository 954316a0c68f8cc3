//! Windows are cut and fitted here, off the engine's thread: a few workers, which take what the schedule says is next;
//! answers come back by channel.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, Sender};

use stiction_engine::engine::{LoopId, Request, WindowAnswer};

/// A window on its way to a worker.
#[derive(Debug)]
pub struct Job {
    /// The window to compute.
    pub request: Request,
    /// When the sample arrived that made it due, ns.
    pub arrival_ns: i64,
}

/// An answer on its way back.
#[derive(Debug)]
pub struct Answered {
    /// The loop.
    pub id: LoopId,
    /// Its window's place.
    pub seq: u64,
    /// The window's name, ns.
    pub end_ns: i64,
    /// When the sample arrived that made it due, ns.
    pub arrival_ns: i64,
    /// How long the window took.
    pub took: Duration,
    /// `None` where the fit failed.
    pub answer: Option<WindowAnswer>,
}

/// The workers' two ends. The threads end when `jobs` is gone.
pub struct Workers {
    /// Windows go in here.
    pub jobs: Sender<Job>,
    /// Answers come out here, in any order.
    pub answers: Receiver<Answered>,
}

/// Starts workers on all cores but one, at least one.
///
/// # Errors
/// The system refuses a thread.
pub fn start(count: Option<usize>) -> std::io::Result<Workers> {
    let cores = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    let count = count.unwrap_or(cores.saturating_sub(1)).max(1);
    // One at hand for each: what is further down the row can still be overtaken.
    let (jobs, waiting) = crossbeam_channel::bounded::<Job>(count);
    let (finished, answers) = crossbeam_channel::unbounded();
    for index in 0..count {
        let (waiting, finished) = (waiting.clone(), finished.clone());
        let thread = std::thread::Builder::new().name(format!("fit-{index}"));
        thread.spawn(move || {
            for Job { request, arrival_ns } in waiting {
                // A fit that breaks off must cost its window, not the worker and every later window of the loop.
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
