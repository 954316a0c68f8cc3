//! Manual analysis of files: opened or uploaded, cut into sections, estimated and diagnosed as by the commands.
//!
//! [`shelf`] keeps files, [`upload`] receives them, [`record`] draws from them; [`request`] defines the options of a job,
//! [`preview`] shows the data that it would use, [`jobs`] queues it, [`work`] runs it, [`documents`] describes it; [`choices`]
//! lists the options; [`serve`] serves the page.
//!
//! The daemon is not involved: `stictiond workbench` is a separate process, so that whatever a file does to the program that
//! reads it, the plant is still monitored.

mod alone;
mod choices;
mod documents;
mod fault;
mod jobs;
mod names;
mod preview;
mod reading;
mod record;
mod request;
mod routes;
mod sampling;
mod shelf;
mod upload;
mod work;

use std::sync::Arc;

use axum::Router;
use tokio::sync::Semaphore;

use crate::web::table;
use jobs::Jobs;
use shelf::{Limits, Shelf};
use stiction_files::ReadOptions;
use stiction_files::inputs::Unit;

pub use alone::serve;
pub use fault::Fault;
pub use reading::{OPTIONS, ReadingWords};
pub use routes::operations;

/// Most streams of jobs at a time.
const STREAMS: usize = 32;
/// Records read for drawing at a time: each takes memory for its whole loop.
const DRAWN: usize = 4;

/// Files and jobs.
pub struct Workbench {
    shelf: Arc<Shelf>,
    jobs: Arc<Jobs>,
    uploads: Semaphore,
    streams: Arc<Semaphore>,
    drawing: Semaphore,
}

/// The state of every handler.
pub type Bench = Arc<Workbench>;

impl Workbench {
    /// An empty workbench, whose threads wait for jobs until it is dropped.
    #[must_use]
    pub fn start() -> Bench {
        let shelf = Arc::new(Shelf::new(Limits::default()));
        let files = shelf.clone();
        Arc::new(Self {
            jobs: Jobs::start(move |job| work::run(job, &files)),
            shelf,
            uploads: Semaphore::new(upload::AT_A_TIME),
            streams: Arc::new(Semaphore::new(STREAMS)),
            drawing: Semaphore::new(DRAWN),
        })
    }

    /// Opens files of this machine. `words` are the reading options as typed.
    ///
    /// # Errors
    /// They cannot be read.
    pub fn open(&self, unit: Unit, options: ReadOptions, words: ReadingWords) -> Result<usize, Fault> {
        self.shelf.give(unit, options, words).map(|info| info.loops.len())
    }

    /// Cancels running jobs and deletes uploads.
    pub fn close(&self) {
        self.jobs.end();
        self.shelf.clear();
    }
}

impl Drop for Workbench {
    fn drop(&mut self) {
        self.close();
    }
}

/// Everything under `/workbench`.
pub fn router(bench: Bench) -> Router {
    table::router(&operations()).with_state(bench)
}
