//! Fits off the engine's thread: a few workers, which take what the schedule says is next, answers by channel.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, Sender};

use stiction::verdict::Assessment;
use stiction_monitor::engine::{LoopId, Request};

/// An answer on its way back.
#[derive(Debug)]
pub struct Answered {
    /// The loop.
    pub id: LoopId,
    /// Its window's place.
    pub seq: u64,
    /// The window's name, ns.
    pub end_ns: i64,
    /// How long the fit took.
    pub took: Duration,
    /// What the window says; `None` where the fit broke off.
    pub assessment: Option<Assessment>,
}

/// The workers' two ends. The threads end when `requests` is gone.
pub struct Workers {
    /// Requests go in here.
    pub requests: Sender<Request>,
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
    let (requests, jobs) = crossbeam_channel::bounded::<Request>(count);
    let (finished, answers) = crossbeam_channel::unbounded();
    for index in 0..count {
        let (jobs, finished) = (jobs.clone(), finished.clone());
        let thread = std::thread::Builder::new().name(format!("fit-{index}"));
        thread.spawn(move || {
            for request in jobs {
                // A fit that breaks off must cost its window, not the worker and every later window of the loop.
                let began = Instant::now();
                let assessment = catch_unwind(AssertUnwindSafe(|| request.compute())).ok();
                let (id, seq, end_ns, took) = (request.id, request.seq, request.end_ns, began.elapsed());
                let answer = Answered { id, seq, end_ns, took, assessment };
                if finished.send(answer).is_err() {
                    return;
                }
            }
        })?;
    }
    Ok(Workers { requests, answers })
}
