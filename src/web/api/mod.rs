//! The API under the page, one table of operations: the router and its OpenAPI description are made from the same lines.

mod alarms;
mod curves;
mod events;
mod loops;
mod openapi;
mod over_time;
mod past;
mod reviews;
mod site;
mod window;

use std::path::Path;
use std::sync::{Arc, PoisonError};
use std::time::Duration;

use axum::http::StatusCode;
use axum::routing::MethodRouter;
use axum::{Json, Router};
use crossbeam_channel::Sender;
use schemars::{Schema, SchemaGenerator};
use tokio::sync::{Semaphore, oneshot};

use super::error::ApiError;
use super::guard::Guard;
use crate::daemon::clock::now_ns;
use crate::daemon::health::HealthSnapshot;
use crate::daemon::overview::Overview;
use crate::files::archive::{Archive, SharedArchive};
use crate::files::reviews::Reviews;
use crate::source::zenoh::LastValues;
use crate::source::{Answer, Incoming, Looked};
use stiction_monitor::codec::topic::{self, Kind};
use stiction_monitor::config::Config;

/// Where the API lies.
pub const BASE: &str = "/api/v1";
/// How long the engine may take for an answer; a diagnosis takes longer.
const ENGINE_WITHIN: Duration = Duration::from_secs(10);
/// Looks at windows and recordings at a time, and drawings, which take seconds: both take a core from the fits.
const LOOKS_AT_ONCE: usize = 2;
const DRAWINGS_AT_ONCE: usize = 1;
/// How many may wait for either.
const SLOW_WAITING: usize = 64;
/// Streams at a time.
const STREAMS: usize = 64;

/// What a running daemon answers from.
pub struct Live {
    /// Every loop as it is now.
    pub overview: Overview,
    /// Last documents as they were published.
    pub last: LastValues,
    /// The way to the engine.
    pub queue: Sender<Incoming>,
    /// The daemon's health.
    pub snapshot: HealthSnapshot,
    /// What was recorded.
    pub archive: SharedArchive,
    /// What people found.
    pub reviews: Reviews,
    /// Who may do what.
    pub guard: Arc<Guard>,
    /// The configuration.
    pub config: Arc<Config>,
    /// When the daemon started, ns since 1970.
    pub started_ns: i64,
    /// What to know of the data before anything else.
    pub note: Option<&'static str>,
    looks: Semaphore,
    drawings: Semaphore,
    waiting: Semaphore,
    streams: Semaphore,
}

/// The state of every handler.
pub type Shared = Arc<Live>;

/// What a handler gives.
pub type Answered<T> = Result<Json<T>, ApiError>;

impl Live {
    /// Answers from these.
    #[must_use]
    pub fn new(
        config: Arc<Config>,
        guard: Arc<Guard>,
        overview: Overview,
        last: LastValues,
        queue: Sender<Incoming>,
        snapshot: HealthSnapshot,
    ) -> Self {
        let recordings = Path::new(&config.recording.dir);
        let archive = Arc::new(Archive::new(recordings, &config.site.prefix));
        let reviews = Reviews::below(recordings);
        let [looks, drawings, waiting, streams] =
            [LOOKS_AT_ONCE, DRAWINGS_AT_ONCE, SLOW_WAITING, STREAMS].map(Semaphore::new);
        let started_ns = now_ns();
        Self {
            overview,
            last,
            queue,
            snapshot,
            archive,
            reviews,
            guard,
            config,
            started_ns,
            note: None,
            looks,
            drawings,
            waiting,
            streams,
        }
    }

    /// The last document of a loop as it was published.
    fn last_document(&self, loop_name: &str, kind: Kind) -> Option<serde_json::Value> {
        let key = topic::result(&self.config.site.prefix, loop_name, kind);
        let last = self.last.read().unwrap_or_else(PoisonError::into_inner);
        let document = last.get(&key)?.document.clone();
        drop(last);
        serde_json::from_slice(&document).ok()
    }

    /// Looks back on a thread of its own.
    async fn on_a_thread<T: Send + 'static>(&self, work: impl FnOnce() -> T + Send + 'static) -> Result<T, ApiError> {
        self.in_turn(&self.looks, work).await
    }

    /// Draws on a thread of its own.
    async fn draw<T: Send + 'static>(&self, work: impl FnOnce() -> T + Send + 'static) -> Result<T, ApiError> {
        self.in_turn(&self.drawings, work).await
    }

    async fn in_turn<T: Send + 'static>(
        &self,
        places: &Semaphore,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> Result<T, ApiError> {
        let busy = || ApiError::busy("too many wait for pictures and recordings already: try again in a moment");
        let _waiting = self.waiting.try_acquire().map_err(|_| busy())?;
        let _place = places.acquire().await.map_err(|_| busy())?;
        let failed = |_| ApiError::new(StatusCode::INTERNAL_SERVER_ERROR, "it broke off: the daemon's log says why");
        tokio::task::spawn_blocking(work).await.map_err(failed)
    }

    /// A loop's window, as the engine holds it.
    async fn look(&self, loop_name: &str, end_ns: Option<i64>) -> Result<Looked, ApiError> {
        let (tell, told) = oneshot::channel();
        let answer = Box::new(move |looked| drop(tell.send(looked)));
        self.ask(Incoming::Look { loop_name: loop_name.to_owned(), end_ns, answer })?;
        let looked = within(ENGINE_WITHIN, told).await?;
        looked.ok_or_else(|| ApiError::not_found(format!("no loop {loop_name:?} has appeared")))
    }

    /// A person's wish, answered by a document or by what is wrong with it.
    async fn wish(
        &self,
        patience: Duration,
        wish: impl FnOnce(Answer) -> Incoming,
    ) -> Result<serde_json::Value, ApiError> {
        let (tell, told) = oneshot::channel();
        self.ask(wish(Box::new(move |result| drop(tell.send(result)))))?;
        let document = within(patience, told).await?.map_err(ApiError::unfit)?;
        serde_json::from_slice(&document).map_err(|e| ApiError::new(StatusCode::INTERNAL_SERVER_ERROR, e.to_string()))
    }

    fn ask(&self, incoming: Incoming) -> Result<(), ApiError> {
        self.queue.try_send(incoming).map_err(|_| ApiError::busy("the daemon is too busy to answer: try again"))
    }
}

async fn within<T>(patience: Duration, told: oneshot::Receiver<T>) -> Result<T, ApiError> {
    let late = || ApiError::new(StatusCode::GATEWAY_TIMEOUT, "the engine did not answer in time: try again");
    tokio::time::timeout(patience, told).await.map_err(|_| late())?.map_err(|_| late())
}

/// What a query or a path may carry.
#[derive(Debug, Clone, Copy)]
pub struct Parameter {
    /// Its name; `{name}` of the path is one too.
    pub name: &'static str,
    /// What it is, in words.
    pub words: &'static str,
}

/// What an operation answers with.
#[derive(Clone, Copy)]
pub enum Gives {
    /// JSON of this shape.
    Json(fn(&mut SchemaGenerator) -> Schema),
    /// A file of this kind.
    File(&'static str),
    /// Server-sent events, whose data are JSON.
    Events,
}

/// One line of the table.
pub struct Operation<S> {
    /// `get`, `post` or `delete`.
    pub method: &'static str,
    /// Below [`BASE`].
    pub path: &'static str,
    /// What it does, in words.
    pub summary: &'static str,
    /// What it may be told beside the path's own names.
    pub query: &'static [Parameter],
    /// What it is sent, as JSON.
    pub body: Option<fn(&mut SchemaGenerator) -> Schema>,
    /// What it gives.
    pub gives: Gives,
    /// What answers.
    pub handler: fn() -> MethodRouter<S>,
}

/// The shape of a type.
pub(crate) fn of<T: schemars::JsonSchema>(generator: &mut SchemaGenerator) -> Schema {
    generator.subschema_for::<T>()
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
    ]
    .into_iter()
    .flatten()
    .collect()
}

/// A router of operations.
pub fn router<S: Clone + Send + Sync + 'static>(operations: &[Operation<S>]) -> Router<S> {
    operations.iter().fold(Router::new(), |router, o| router.route(o.path, (o.handler)()))
}

/// The API of a running daemon.
#[must_use]
pub fn live(state: Shared) -> Router {
    router(&operations()).with_state(state)
}

/// What is not there.
pub(super) async fn nothing_there() -> ApiError {
    ApiError::not_found("no such thing here: /api/v1/openapi.json lists what there is")
}
