//! HTTP: the page for people with the API under it, `/metrics` for Prometheus, `/healthz` for whoever restarts us.
//!
//! It reads what the engine's thread leaves for it and what lies in the recordings, and sends people's wishes through the
//! engine's own queue; nothing here touches the hot path. [`server`] bounds connections, [`guard`] says who may do what,
//! [`api`] answers, [`workbench`] analyses files, [`assets`] holds the page's files.

pub mod api;
mod assets;
pub mod error;
mod exposition;
pub mod guard;
pub mod server;
pub mod thin;
pub mod workbench;

use std::net::SocketAddr;
use std::sync::{Arc, PoisonError};
use std::time::Duration;

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
use stiction_monitor::config::Web;

/// Silence of the engine after which the daemon is called unhealthy.
const STALLED_AFTER: Duration = Duration::from_secs(30);
/// Pause before an address that cannot be used is tried again.
const BIND_AGAIN: Duration = Duration::from_secs(5);
/// Name of the fault while the server is not there.
const FAULT: &str = "web";

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

/// Everything that is served beside `/metrics` and `/healthz`: the page's files, and what lies under `/api/v1`.
pub fn page(api: Router, guard: Arc<Guard>) -> Router {
    Router::new()
        .nest(api::BASE, api.fallback(api::nothing_there))
        .fallback(get(assets::asset))
        .layer(from_fn_with_state(guard, guard::guard))
}

/// Starts the server as configured. Loops are watched without it too: an address that cannot be used is a fault, and is
/// tried again until it can.
pub async fn serve(settings: &Web, registry: Registry, snapshot: HealthSnapshot, faults: Arc<Faults>) -> Served {
    if !settings.enabled {
        return Served { address: None, task: None };
    }
    let shared = Shared { registry: Arc::new(registry), snapshot };
    let router = Router::new().route("/metrics", get(metrics_text)).route("/healthz", get(healthz)).with_state(shared);
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

/// 200 with the daemon's health document; 503 where the engine has not reported for [`STALLED_AFTER`].
async fn healthz(State(shared): State<Shared>) -> Response {
    let (made, health) = shared.snapshot.read().unwrap_or_else(PoisonError::into_inner).clone();
    let status = if made.elapsed() < STALLED_AFTER { StatusCode::OK } else { StatusCode::SERVICE_UNAVAILABLE };
    let body = serde_json::to_vec(&*health).unwrap_or_default();
    (status, [(header::CONTENT_TYPE, "application/json")], body).into_response()
}
