//! HTTP: `/metrics` for Prometheus and `/healthz` for whoever restarts us. Reads snapshots, never the hot path.

use std::net::SocketAddr;
use std::sync::{Arc, PoisonError};
use std::time::Duration;

use anyhow::Context;
use axum::Router;
use axum::extract::State;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use prometheus_client::registry::Registry;
use tokio::task::JoinHandle;

use crate::config::Web;
use crate::daemon::HealthSnapshot;
use crate::daemon::metrics::Metrics;

/// Silence of the engine after which the daemon is called unhealthy.
const STALLED_AFTER: Duration = Duration::from_secs(30);

/// A running server.
pub struct Served {
    /// Where it listens; `None` if it is switched off.
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

/// Starts the server as configured.
///
/// # Errors
/// The address is taken or not ours.
pub async fn serve(settings: &Web, metrics: Arc<Metrics>, snapshot: HealthSnapshot) -> anyhow::Result<Served> {
    if !settings.enabled {
        return Ok(Served { address: None, task: None });
    }
    let listener = tokio::net::TcpListener::bind(&settings.listen)
        .await
        .with_context(|| format!("[web] listen = {:?} cannot be used; port 0 takes any free one", settings.listen))?;
    let address = listener.local_addr()?;
    let shared = Shared { registry: Arc::new(metrics.registry()), snapshot };
    let router = Router::new().route("/metrics", get(metrics_text)).route("/healthz", get(healthz)).with_state(shared);
    let task = tokio::spawn(async move {
        if let Err(error) = axum::serve(listener, router).await {
            tracing::error!(%error, "the web server ended");
        }
    });
    Ok(Served { address: Some(address), task: Some(task) })
}

async fn metrics_text(State(shared): State<Shared>) -> Response {
    let mut text = String::new();
    if prometheus_client::encoding::text::encode(&mut text, &shared.registry).is_err() {
        return StatusCode::INTERNAL_SERVER_ERROR.into_response();
    }
    ([(header::CONTENT_TYPE, "application/openmetrics-text; version=1.0.0; charset=utf-8")], text).into_response()
}

/// 200 with the daemon's health document; 503 where the engine has not reported for [`STALLED_AFTER`].
async fn healthz(State(shared): State<Shared>) -> Response {
    let (made, health) = shared.snapshot.read().unwrap_or_else(PoisonError::into_inner).clone();
    let status = if made.elapsed() < STALLED_AFTER { StatusCode::OK } else { StatusCode::SERVICE_UNAVAILABLE };
    let body = serde_json::to_vec(&*health).unwrap_or_default();
    (status, [(header::CONTENT_TYPE, "application/json")], body).into_response()
}
