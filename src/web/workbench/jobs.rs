//! The queue of jobs: bounded, with a few threads, progress and cancellation. Recent results are kept.

use std::collections::VecDeque;
use std::panic::AssertUnwindSafe;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use schemars::JsonSchema;
use serde::Serialize;
use serde_json::Value;
use tokio::sync::watch;

use super::fault::Fault;
use super::request::Task;
use crate::runtime::cores::{Watch, cores};
use stiction_engine::analysis::predictions::Row;

/// Most jobs that may wait.
const WAITING: usize = 16;
/// Most jobs kept with their results.
const KEPT: usize = 48;

/// State of a job.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
#[allow(missing_docs)] // the names say it
pub enum State {
    Queued,
    Running,
    Done,
    Failed,
    Cancelled,
}

impl State {
    /// Whether the job has ended.
    #[must_use]
    pub const fn over(self) -> bool {
        matches!(self, Self::Done | Self::Failed | Self::Cancelled)
    }
}

/// Progress of a job.
#[derive(Debug, Clone, PartialEq, Default, Serialize, JsonSchema)]
pub struct Progress {
    /// Finished steps, plus the finished fraction of the current one.
    pub done: f64,
    /// Total number of steps.
    pub of: Option<f64>,
    /// The current step.
    pub words: String,
}

/// A picture of a result.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct Drawn {
    /// Its name in URLs, unique within the job.
    pub id: String,
    /// Its title.
    pub title: String,
    /// What it shows and how to read it.
    pub caption: String,
    /// Whether it takes the page's whole width.
    pub wide: bool,
    /// Order of the requested model, if one was requested.
    pub order: Option<u8>,
    /// A mark of what it shows: pictures with the same mark are alike.
    pub content: String,
    /// The SVG element.
    #[serde(skip)]
    pub svg: Arc<str>,
}

impl Drawn {
    /// The SVG as a separate file, which needs a namespace; inside a page it does not.
    #[must_use]
    pub fn standing_alone(&self) -> String {
        self.svg.replacen("<svg ", "<svg xmlns=\"http://www.w3.org/2000/svg\" ", 1)
    }
}

/// Numbers of an error map, OP units.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, JsonSchema)]
pub struct MapNumbers {
    /// Order of the process.
    pub order: u8,
    /// OP's span, the upper limit of `fs + fd`.
    pub s0: f64,
    /// Smallest and largest fs of the suggested region.
    pub fs: [f64; 2],
    /// The same for fd.
    pub fd: [f64; 2],
    /// fs and fd of the cell with the smallest error.
    pub least: [f64; 2],
    /// Root mean squared error of that cell, PV units.
    pub least_rms: Option<f64>,
}

/// Results of a section.
#[derive(Debug, Clone, Default)]
pub struct SectionResult {
    /// The section in words.
    pub section: String,
    /// The run, such as `fopdt`; `None` for a gap.
    pub model: Option<&'static str>,
    /// The document as the command prints it.
    pub document: Value,
    /// The text as the command prints it.
    pub text: String,
    /// The most important facts, as sentences.
    pub words: Vec<Said>,
    /// Notes on the section.
    pub notes: Vec<String>,
    /// Its pictures.
    pub pictures: Vec<Drawn>,
    /// The numbers of its error maps.
    pub maps: Vec<MapNumbers>,
    /// Index of the job's report that shows it.
    pub report: Option<usize>,
    /// For a gap: measured PV and free runs.
    pub predictions: Option<Arc<Vec<Row>>>,
}

/// One fact in plain words.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, JsonSchema)]
pub struct Said {
    /// Its subject, such as `Size`.
    pub about: &'static str,
    /// The sentence.
    pub text: String,
}

/// State and results of a job.
#[derive(Debug, Clone)]
pub struct Made {
    /// Its state.
    pub state: State,
    /// Its progress.
    pub progress: Progress,
    /// Results so far.
    pub results: Vec<SectionResult>,
    /// Reports, HTML.
    pub reports: Vec<Arc<String>>,
    /// Why it failed.
    pub error: Option<String>,
    began: Option<Instant>,
    elapsed_ms: f64,
}

/// A job.
pub struct Job {
    /// Its name in URLs.
    pub id: String,
    /// The checked request.
    pub task: Task,
    /// Equivalent command lines, one for each run.
    pub command: Vec<String>,
    cancel: AtomicBool,
    made: Mutex<Made>,
    changed: watch::Sender<u64>,
}

impl Job {
    fn made(&self) -> MutexGuard<'_, Made> {
        self.made.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Its current state.
    #[must_use]
    pub fn now(&self) -> Made {
        let mut made = self.made().clone();
        if let Some(began) = made.began.filter(|_| !made.state.over()) {
            made.elapsed_ms = began.elapsed().as_secs_f64() * 1e3;
        }
        made
    }

    /// A receiver that is notified of every change.
    #[must_use]
    pub fn listen(&self) -> watch::Receiver<u64> {
        self.changed.subscribe()
    }

    /// Changes the state, unless the job has ended.
    pub fn change(&self, how: impl FnOnce(&mut Made)) {
        {
            let mut made = self.made();
            if made.state.over() {
                return;
            }
            how(&mut made);
            if let Some(began) = made.began {
                made.elapsed_ms = began.elapsed().as_secs_f64() * 1e3;
            }
        }
        self.changed.send_modify(|count| *count += 1);
    }

    /// Cancels it: at once for those who wait; its thread notices at the next step.
    fn cancel(&self) {
        self.cancel.store(true, Ordering::Relaxed);
        self.change(|made| {
            made.state = State::Cancelled;
            made.progress.words = "cancelled".to_owned();
        });
    }

    /// Whether it was cancelled.
    #[must_use]
    pub fn cancelled(&self) -> bool {
        self.cancel.load(Ordering::Relaxed)
    }
}

impl Made {
    /// Run time, ms.
    #[must_use]
    pub const fn elapsed_ms(&self) -> f64 {
        self.elapsed_ms
    }
}

/// A step of a running job; reports its progress.
pub struct Step<'j> {
    /// The job.
    pub job: &'j Job,
    /// Number of steps before it, and in total.
    pub place: [usize; 2],
    /// Its description.
    pub words: String,
    /// What is counted in it, such as `models`.
    pub counted: &'static str,
}

impl Step<'_> {
    /// Reports that the step begins.
    pub fn begin(&self) {
        self.show(0.0, self.words.clone());
    }

    fn show(&self, share: f64, words: String) {
        let [done, of] = self.place.map(|steps| steps as f64);
        self.job.change(|made| made.progress = Progress { done: done + share.clamp(0.0, 1.0), of: Some(of), words });
    }
}

impl Watch for Step<'_> {
    fn reached(&self, done: u64, of: u64, _: &str) {
        let share = if of == 0 { 0.0 } else { done as f64 / of as f64 };
        self.show(share, format!("{}: {done} of at most {of} {}", self.words, self.counted));
    }

    fn go_on(&self) -> bool {
        !self.job.cancelled()
    }
}

#[derive(Default)]
struct Inner {
    jobs: VecDeque<Arc<Job>>,
    waiting: VecDeque<Arc<Job>>,
    next: u64,
    ended: bool,
}

/// All jobs, and the threads that run them.
pub struct Jobs {
    inner: Mutex<Inner>,
    wake: Condvar,
}

impl Jobs {
    /// Starts the threads that run `work`: one for every two cores, at most two, to leave cores for everything else.
    #[must_use]
    pub fn start(work: impl Fn(&Job) -> Result<(), Fault> + Send + Sync + 'static) -> Arc<Self> {
        let jobs = Arc::new(Self { inner: Mutex::default(), wake: Condvar::new() });
        let work = Arc::new(work);
        for number in 0..(cores() / 2).clamp(1, 2) {
            let (jobs, work) = (jobs.clone(), work.clone());
            let thread = std::thread::Builder::new().name(format!("workbench-{number}"));
            if let Err(error) = thread.spawn(move || jobs.serve(&*work)) {
                tracing::error!("cannot start a workbench thread: {error}");
            }
        }
        jobs
    }

    fn inner(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Queues a job.
    ///
    /// # Errors
    /// Too many are waiting.
    pub fn order(&self, task: Task, command: Vec<String>) -> Result<Arc<Job>, Fault> {
        let mut inner = self.inner();
        inner.waiting.retain(|job| !job.cancelled());
        if inner.waiting.len() >= WAITING {
            return Err(Fault::too_many(format!("{WAITING} jobs are waiting; cancel some, or wait until one is done")));
        }
        inner.next += 1;
        let made = Made {
            state: State::Queued,
            progress: Progress { words: "waiting for a free thread".to_owned(), ..Progress::default() },
            results: Vec::new(),
            reports: Vec::new(),
            error: None,
            began: None,
            elapsed_ms: 0.0,
        };
        let job = Arc::new(Job {
            id: format!("j{}", inner.next),
            task,
            command,
            cancel: AtomicBool::new(false),
            made: Mutex::new(made),
            changed: watch::Sender::new(0),
        });
        if inner.jobs.len() >= KEPT {
            // Drop the oldest finished job; at most a few are not finished.
            if let Some(at) = inner.jobs.iter().position(|job| job.made().state.over()) {
                inner.jobs.remove(at);
            }
        }
        inner.jobs.push_back(job.clone());
        inner.waiting.push_back(job.clone());
        drop(inner);
        self.wake.notify_one();
        Ok(job)
    }

    /// All jobs kept, oldest first.
    #[must_use]
    pub fn list(&self) -> Vec<Arc<Job>> {
        self.inner().jobs.iter().cloned().collect()
    }

    /// A job.
    ///
    /// # Errors
    /// It does not exist, or no longer.
    pub fn get(&self, id: &str) -> Result<Arc<Job>, Fault> {
        let missing = || {
            let id = super::names::shown(id);
            Fault::missing(format!("there is no job {id:?}; only the last {KEPT} are kept"))
        };
        self.inner().jobs.iter().find(|job| job.id == id).cloned().ok_or_else(missing)
    }

    /// Cancels a job, or deletes a finished one.
    ///
    /// # Errors
    /// As [`Jobs::get`].
    pub fn remove(&self, id: &str) -> Result<State, Fault> {
        let job = self.get(id)?;
        let over = job.made().state.over();
        if over {
            self.inner().jobs.retain(|other| other.id != id);
        } else {
            job.cancel();
        }
        let state = job.made().state;
        Ok(state)
    }

    /// Cancels all jobs and ends the threads after their current step.
    pub fn end(&self) {
        let jobs = {
            let mut inner = self.inner();
            inner.ended = true;
            inner.waiting.clear();
            inner.jobs.iter().cloned().collect::<Vec<_>>()
        };
        jobs.iter().for_each(|job| job.cancel());
        self.wake.notify_all();
    }

    /// The next job; `None` when there will be no more.
    fn next(&self) -> Option<Arc<Job>> {
        let mut inner = self.inner();
        loop {
            if inner.ended {
                return None;
            }
            if let Some(job) = inner.waiting.pop_front() {
                return Some(job);
            }
            inner = self.wake.wait(inner).unwrap_or_else(PoisonError::into_inner);
        }
    }

    fn serve(&self, work: &(dyn Fn(&Job) -> Result<(), Fault> + Send + Sync)) {
        while let Some(job) = self.next() {
            job.change(|made| {
                made.state = State::Running;
                made.began = Some(Instant::now());
            });
            if job.cancelled() {
                continue;
            }
            // A panic fails one job, not the thread that the others wait for.
            let done = std::panic::catch_unwind(AssertUnwindSafe(|| work(&job)));
            let done = done.unwrap_or_else(|_| Err(Fault::own("internal error; the program's log has details")));
            job.change(|made| match done {
                Ok(()) => {
                    made.state = State::Done;
                    made.progress.done = made.progress.of.unwrap_or(1.0);
                    made.progress.words = "done".to_owned();
                }
                Err(fault) => {
                    made.state = State::Failed;
                    made.error = Some(fault.text().to_owned());
                }
            });
        }
    }
}
