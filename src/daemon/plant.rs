//! Compares the loops of a plant on a low-priority thread, one comparison after the other.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, Sender};

use super::gaps::yield_to_all;
use stiction::plantwide::GroupDocument;
use stiction_engine::engine::{Comparison, Misplaced};

/// Result of a comparison.
#[derive(Debug)]
pub struct Compared {
    /// The comparison.
    pub comparison: Comparison,
    /// The groups; `None` if the comparison failed.
    pub groups: Option<Vec<GroupDocument>>,
    /// Loops with a signal under the wrong name or of the wrong sign.
    pub misplaced: Vec<(Arc<str>, Misplaced)>,
    /// How long it took.
    pub took: Duration,
}

/// The caller's ends of the channels. The thread ends when this is dropped.
pub struct Comparer {
    /// Takes comparisons.
    pub requests: Sender<Comparison>,
    /// Gives results.
    pub answers: Receiver<Compared>,
}

impl Comparer {
    /// Starts the thread for the daemon of this id.
    ///
    /// # Errors
    /// The system refuses a thread.
    pub fn start(daemon: &str) -> std::io::Result<Self> {
        let (comparer, requests, finished) = Self::ends();
        let daemon = daemon.to_owned();
        std::thread::Builder::new().name("plant".into()).spawn(move || {
            yield_to_all();
            for comparison in requests {
                if finished.send(compare(comparison, &daemon)).is_err() {
                    return;
                }
            }
        })?;
        Ok(comparer)
    }

    /// This end, and the two ends that the thread would hold: the receiver of comparisons and the sender of results.
    #[must_use]
    pub fn ends() -> (Self, Receiver<Comparison>, Sender<Compared>) {
        let (requests, waiting) = crossbeam_channel::bounded(1);
        let (finished, answers) = crossbeam_channel::unbounded();
        (Self { requests, answers }, waiting, finished)
    }
}

/// Runs a comparison for the daemon of this id.
#[must_use]
pub fn compare(comparison: Comparison, daemon: &str) -> Compared {
    let began = Instant::now();
    let groups = catch_unwind(AssertUnwindSafe(|| comparison.compute(Some(daemon)))).ok();
    let misplaced = catch_unwind(AssertUnwindSafe(|| comparison.misplaced())).unwrap_or_default();
    Compared { comparison, groups, misplaced, took: began.elapsed() }
}
