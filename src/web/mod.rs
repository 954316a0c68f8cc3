//! HTTP: the page for people with the API under it, `/metrics` for Prometheus, `/healthz` for whoever restarts us.
//!
//! It reads what the engine's thread leaves for it and what lies in the recordings, and sends people's wishes through the
//! engine's own queue; nothing here touches the hot path. [`server`] bounds connections, [`guard`] says who may do what,
//! [`api`]
//! answers for a daemon, [`workbench`] for files, [`assets`] holds the page's files.

pub mod api;
mod assets;
pub mod error;
mod exposition;
pub mod extract;
pub mod guard;
mod openapi;
pub mod server;
pub mod table;
pub mod thin;
pub mod workbench;

use std::net::SocketAddr;
use std::path::Path;
use std::sync::{Arc, PoisonError};
use std::time::Duration;

use anyhow::{Context, ensure};
use axum::Router;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode, header};
use axum::middleware::from_fn_with_state;
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use prometheus_client::registry::Registry;
use tokio::net::TcpListener;
use tokio::task::JoinHandle;

use crate::daemon::faults::Faults;
use crate::daemon::health::HealthSnapshot;
use exposition::Form;
use guard::Guard;
use stiction_monitor::config::{Page, Web};

/// Silence of the engine after which the daemon is called unhealthy.
const STALLED_AFTER: Duration = Duration::from_secs(30);
/// Pause before an address that cannot be used is tried again.
const BIND_AGAIN: Duration = Duration::from_secs(5);
/// Name of the fault while the server is not there.
const FAULT: &str = "web";
/// Shortest token: what can be guessed is none.
const MIN_TOKEN: usize = 16;

/// A running server.
pub struct Served {
    /// Where it listens; `None` if it is switched off, or its address cannot be used yet.
    pub address: Option<SocketAddr>,
    task: Option<JoinHandle<()>>,
}

impl Served {
    /// Ends it.
    pub fn stop(self) {
        if let Some(task) = self.task {
            task.abort();
        }
    }
}

#[derive(Clone)]
struct Shared {
    registry: Arc<Registry>,
    snapshot: HealthSnapshot,
}

/// The rules that the configuration asks for.
///
/// # Errors
/// The token's file cannot be read, or holds nothing that could be one; the time zone is not known.
pub fn guard_of(page: &Page) -> anyhow::Result<Guard> {
    let zone = &page.time_zone;
    jiff::tz::TimeZone::get(zone)
        .with_context(|| format!("[web] time_zone {zone:?}: write a name such as Europe/Berlin"))?;
    let mut token = None;
    if !page.token_file.is_empty() {
        let path = Path::new(&page.token_file);
        let text = std::fs::read_to_string(path).with_context(|| format!("[web] token_file {:?}", page.token_file))?;
        let text = text.trim();
        ensure!(
            text.len() >= MIN_TOKEN && !text.contains(char::is_whitespace),
            "[web] token_file {:?}: write one word of at least {MIN_TOKEN} characters, such as `openssl rand -hex 24` gives",
            page.token_file
        );
        token = Some(text.to_owned());
    }
    let mut hosts = page.hosts.clone();
    hosts.extend(machine_name());
    Ok(Guard { hosts, token })
}

/// Name of this machine in its network.
#[cfg(target_os = "linux")]
fn machine_name() -> Option<String> {
    rustix::system::uname().nodename().to_str().ok().map(str::to_owned)
}

#[cfg(not(target_os = "linux"))]
fn machine_name() -> Option<String> {
    None
}

/// Everything that is served beside `/metrics` and `/healthz`: the page's files, and what lies under `/api/v1`.
pub fn page(api: Router, guard: Arc<Guard>) -> Router {
    Router::new()
        .nest(table::BASE, api.merge(openapi::router()).fallback(table::nothing_there))
        .fallback(get(assets::asset))
        .layer(from_fn_with_state(guard, guard::guard))
}

/// Starts the server as configured, with the page if there is one. Loops are watched without it too: an address that
/// cannot be used is a fault, and is tried again until it can.
pub async fn serve(
    settings: &Web,
    registry: Registry,
    snapshot: HealthSnapshot,
    faults: Arc<Faults>,
    page: Option<Router>,
) -> Served {
    if !settings.enabled {
        return Served { address: None, task: None };
    }
    let shared = Shared { registry: Arc::new(registry), snapshot };
    let router = Router::new().route("/metrics", get(metrics_text)).route("/healthz", get(healthz)).with_state(shared);
    let router = router.merge(page.unwrap_or_default());
    match TcpListener::bind(&settings.listen).await {
        Ok(listener) => {
            let address = listener.local_addr().ok();
            Served { address, task: Some(tokio::spawn(server::accept(listener, router))) }
        }
        Err(error) => {
            let (again, remedy) = (BIND_AGAIN.as_secs(), "port 0 takes any free one");
            let what = format!("[web] listen = {:?} cannot be used, tried again every {again} s", settings.listen);
            faults.raise(FAULT, format!("{what}: {error}; {remedy}"));
            let listen = settings.listen.clone();
            Served { address: None, task: Some(tokio::spawn(accept_later(listen, router, faults))) }
        }
    }
}

async fn accept_later(listen: String, router: Router, faults: Arc<Faults>) {
    loop {
        tokio::time::sleep(BIND_AGAIN).await;
        if let Ok(listener) = TcpListener::bind(&listen).await {
            faults.clear(FAULT);
            return server::accept(listener, router).await;
        }
    }
}

async fn metrics_text(State(shared): State<Shared>, headers: HeaderMap) -> Response {
    let mut text = String::new();
    if prometheus_client::encoding::text::encode(&mut text, &shared.registry).is_err() {
        return StatusCode::INTERNAL_SERVER_ERROR.into_response();
    }
    // The end's mark stays behind what is put in.
    let end = text.find("# EOF").unwrap_or(text.len());
    text.insert_str(end, &exposition::of_process());
    let accept = headers.get(header::ACCEPT).and_then(|kinds| kinds.to_str().ok());
    match exposition::form(accept) {
        Form::Open => ([(header::CONTENT_TYPE, exposition::OPEN_METRICS)], text).into_response(),
        Form::Plain => ([(header::CONTENT_TYPE, exposition::PLAIN)], exposition::plain(&text)).into_response(),
        Form::Neither => {
            let offered = format!("/metrics is {} or {}\n", exposition::OPEN_METRICS, exposition::PLAIN);
            (StatusCode::NOT_ACCEPTABLE, offered).into_response()
        }
    }
}

/// 200 with the daemon's health document; 503 where the engine has not reported for [`STALLED_AFTER`] or recording has
/// stopped.
async fn healthz(State(shared): State<Shared>) -> Response {
    let (made, health) = shared.snapshot.read().unwrap_or_else(PoisonError::into_inner).clone();
    let is_well = made.elapsed() < STALLED_AFTER && health.stopped.is_empty();
    let status = if is_well { StatusCode::OK } else { StatusCode::SERVICE_UNAVAILABLE };
    let body = serde_json::to_vec(&*health).unwrap_or_default();
    (status, [(header::CONTENT_TYPE, "application/json")], body).into_response()
}
