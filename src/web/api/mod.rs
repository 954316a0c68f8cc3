//! The API of a running daemon.

mod alarms;
mod curves;
mod events;
mod groups;
mod listed;
mod loops;
mod maintenance;
mod obstacles;
mod over_time;
mod past;
mod reviews;
pub mod site;
mod threads;
mod window;
mod worth;

use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use axum::extract::DefaultBodyLimit;
use axum::http::StatusCode;
use axum::{Json, Router};
use bytes::Bytes;
use crossbeam_channel::Sender;
use tokio::sync::{Semaphore, oneshot};

use self::threads::Threads;
use super::error::ApiError;
use super::guard::Guard;
use super::server::Limits;
use super::table::{self, Operation, Parameter, ResponseKind, of};
use crate::runtime::clock::now_ns;
use crate::runtime::control::{Answer, Control, WindowSnapshot};
use crate::runtime::health::HealthSnapshot;
use crate::runtime::last_values::LastValues;
use crate::runtime::overview::Overview;
use crate::runtime::queue::Rate;
use crate::runtime::view::{CurrentConfig, View};
use stiction::core::record::Record;
use stiction_engine::codec::topic::{self, Kind};
use stiction_engine::engine::LoopSettings;
use stiction_files::archive::{Archive, SharedArchive};
use stiction_files::reviews::Reviews;

/// Largest body of a command, bytes.
const MAX_BODY: usize = 16 << 10;
/// How long the engine may take to answer; a diagnosis takes longer.
const ENGINE_WITHIN: Duration = Duration::from_secs(10);
/// Numbers of threads that read recordings, that access the folder of reviews, that compute, and that draw, which takes
/// seconds. Waiting for disks is kept separate from computing: a folder may hang, and computing takes cores from the fits.
const LOOKS_AT_ONCE: usize = 2;
const REVIEWS_AT_ONCE: usize = 1;
const COMPUTATIONS_AT_ONCE: usize = 2;
const DRAWINGS_AT_ONCE: usize = 1;
/// How long a client waits for a disk, its queue included, and for computations.
const DISK_WITHIN: Duration = Duration::from_secs(30);
const CORE_WITHIN: Duration = Duration::from_secs(55);
/// Windows requested from the engine at a time, and requests that may wait for one, streams not counted.
const WINDOWS_AT_ONCE: usize = 2;
const WINDOWS_WAITING: usize = 8;
/// Most streams at a time, and most of one host.
const STREAMS: usize = 64;
const STREAMS_PER_HOST: usize = 32;

/// The data from which requests are answered.
pub struct Live {
    /// The current state of every loop.
    pub overview: Overview,
    /// The last published documents.
    pub last: LastValues,
    /// Sends to the engine.
    pub control: Sender<Control>,
    /// The daemon's health.
    pub snapshot: HealthSnapshot,
    /// The recordings.
    pub archive: SharedArchive,
    /// The reviews by people.
    pub reviews: Reviews,
    /// The access rules.
    pub guard: Arc<Guard>,
    /// The configuration in force.
    pub config: CurrentConfig,
    /// When the daemon started, ns since 1970.
    pub started_ns: i64,
    /// A note about the data, shown first.
    pub note: Option<&'static str>,
    worth: worth::Worth,
    review_rate: Mutex<Rate>,
    started: Instant,
    looks: Threads,
    at_reviews: Threads,
    computations: Threads,
    drawings: Threads,
    windows: Semaphore,
    windows_waiting: Semaphore,
    streams: Arc<Limits>,
}

/// A loop's window at the time of the request.
struct Looked {
    /// `None` if no samples are held.
    record: Option<Record>,
    settings: Arc<LoopSettings>,
}

/// The state of every handler.
pub type Shared = Arc<Live>;

/// Result of a handler.
pub type Answered<T> = Result<Json<T>, ApiError>;

impl Live {
    /// Serves this view of the daemon and these loops, under these rules.
    #[must_use]
    pub fn new(view: View, overview: Overview, guard: Arc<Guard>) -> Self {
        let View { config, last, control, snapshot, note, .. } = view;
        let fixed = config.get();
        let recordings = Path::new(&fixed.recording.dir);
        let archive = Arc::new(Archive::new(recordings, &fixed.site.prefix));
        let reviews = Reviews::below(recordings);
        let streams = Limits::new(STREAMS, if guard.behind_proxy { STREAMS } else { STREAMS_PER_HOST });
        let started_ns = now_ns();
        let review_rate = Mutex::new(Rate::new(reviews::PER_MINUTE / 60.0, reviews::AT_ONCE));
        Self {
            worth: worth::Worth::default(),
            review_rate,
            started: Instant::now(),
            overview,
            last,
            control,
            snapshot,
            archive,
            reviews,
            guard,
            config,
            started_ns,
            note,
            looks: Threads::new(LOOKS_AT_ONCE, DISK_WITHIN),
            at_reviews: Threads::new(REVIEWS_AT_ONCE, DISK_WITHIN),
            computations: Threads::new(COMPUTATIONS_AT_ONCE, CORE_WITHIN),
            drawings: Threads::new(DRAWINGS_AT_ONCE, CORE_WITHIN),
            windows: Semaphore::new(WINDOWS_AT_ONCE),
            windows_waiting: Semaphore::new(WINDOWS_WAITING),
            streams,
        }
    }

    /// Whether commands are accepted at all.
    fn takes_commands(&self) -> bool {
        self.config.get().commands.enabled
    }

    /// Whether the rate allows one more review now.
    fn allow_review(&self) -> bool {
        let mut rate = self.review_rate.lock().unwrap_or_else(PoisonError::into_inner);
        rate.allow(self.started.elapsed().as_secs_f64())
    }

    /// A loop's last document as it was published.
    fn last_document(&self, loop_name: &str, kind: Kind) -> Option<serde_json::Value> {
        serde_json::from_slice(&self.last_bytes(loop_name, kind)?).ok()
    }

    /// The JSON of the last document of a loop.
    fn last_bytes(&self, loop_name: &str, kind: Kind) -> Option<Bytes> {
        let key = topic::result(&self.config.get().site.prefix, loop_name, kind);
        let last = self.last.read().unwrap_or_else(PoisonError::into_inner);
        Some(last.get(&key)?.document.clone())
    }

    /// Refuses a loop that another daemon serves.
    fn check_shard(&self, loop_name: &str) -> Result<(), ApiError> {
        if self.config.get().shard.owns(loop_name) {
            return Ok(());
        }
        let why = "is of another [shard], whose daemon has to be asked; this one does not watch it";
        Err(ApiError::not_found(format!("{loop_name:?} {why}")))
    }

    /// A loop's window for a request; refused if too many wait for one.
    async fn request_window(&self, loop_name: &str, end_ns: Option<i64>) -> Result<Looked, ApiError> {
        let busy = |_| ApiError::busy("too many requests for windows wait already: try again in a moment");
        let _waiting = self.windows_waiting.try_acquire().map_err(busy)?;
        self.look(loop_name, end_ns).await
    }

    /// The same for a stream, which waits for its turn, since streams are few. The engine hands out the history, and the window
    /// is cut on one of the page's threads.
    async fn look(&self, loop_name: &str, end_ns: Option<i64>) -> Result<Looked, ApiError> {
        let ending = |_| ApiError::busy("the daemon is stopping");
        let _place = self.windows.acquire().await.map_err(ending)?;
        let (reply, answered) = oneshot::channel();
        let answer = Box::new(move |window| drop(reply.send(window)));
        self.ask(Control::GetWindow { loop_name: loop_name.to_owned(), end_ns, answer })?;
        let window: Option<WindowSnapshot> = within(ENGINE_WITHIN, answered).await?;
        let unknown = || ApiError::not_found(format!("no loop {loop_name:?} has appeared"));
        let WindowSnapshot { snapshot, settings } = window.ok_or_else(unknown)?;
        self.computations
            .run(move || {
                let record = snapshot.and_then(|snapshot| snapshot.record(&settings.window));
                Looked { record, settings }
            })
            .await
    }

    /// Sends a person's request to the engine; the answer is a document or the reason for refusal.
    async fn request(
        &self,
        patience: Duration,
        request: impl FnOnce(Answer) -> Control,
    ) -> Result<serde_json::Value, ApiError> {
        let (reply, answer) = oneshot::channel();
        self.ask(request(Box::new(move |result| drop(reply.send(result)))))?;
        let document = within(patience, answer).await?.map_err(ApiError::unfit)?;
        serde_json::from_slice(&document).map_err(|e| ApiError::new(StatusCode::INTERNAL_SERVER_ERROR, e.to_string()))
    }

    fn ask(&self, request: Control) -> Result<(), ApiError> {
        self.control.try_send(request).map_err(|_| ApiError::busy("the daemon is too busy to answer: try again"))
    }
}

async fn within<T>(patience: Duration, answered: oneshot::Receiver<T>) -> Result<T, ApiError> {
    let late = || ApiError::new(StatusCode::GATEWAY_TIMEOUT, "the engine did not answer in time: try again");
    let ended = |_| ApiError::busy("the daemon ended before it answered");
    tokio::time::timeout(patience, answered).await.map_err(|_| late())?.map_err(ended)
}

/// Every operation of a running daemon.
#[must_use]
pub fn operations() -> Vec<Operation<Shared>> {
    [
        site::operations(),
        loops::operations(),
        window::operations(),
        past::operations(),
        over_time::operations(),
        reviews::operations(),
        alarms::operations(),
        events::operations(),
        groups::operations(),
        obstacles::operations(),
        maintenance::operations(),
    ]
    .into_iter()
    .flatten()
    .collect()
}

/// The API of a running daemon.
pub fn live(state: Shared) -> Router {
    table::router(&operations()).layer(DefaultBodyLimit::max(MAX_BODY)).with_state(state)
}
