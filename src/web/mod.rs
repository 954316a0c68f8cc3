//! HTTP: the page with its API, `/metrics` for Prometheus, `/healthz` for monitoring.
//!
//! It reads what the engine's thread publishes for it and what the recordings hold, and sends commands through the engine's
//! queue. [`server`] limits connections, [`guard`] decides who may do what, [`api`] answers for a daemon, [`assets`] has
//! the page's files.

pub mod api;
mod assets;
pub mod error;
mod exposition;
pub mod extract;
pub mod guard;
pub mod openapi;
pub mod server;
pub mod table;
pub mod thin;
pub mod workbench;

use std::path::{Path, PathBuf};
use std::pin::Pin;
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
use tokio::task::JoinHandle;

use crate::runtime::faults::Faults;
use crate::runtime::health::HealthSnapshot;
use crate::runtime::view::{Served, View};
use api::Live;
use exposition::Form;
use guard::Guard;
use server::{CONNECTIONS_PER_HOST, Limits, MAX_CONNECTIONS};
use stiction_engine::config::Page;

/// Time without a report from the engine after which `/healthz` reports the daemon as unhealthy.
const STALLED_AFTER: Duration = Duration::from_secs(30);
/// Pause before the next attempt to bind an address.
const BIND_AGAIN: Duration = Duration::from_secs(5);
/// Keys of the faults while an address is not served.
const FAULT: &str = "web";
const SOCKET_FAULT: &str = "web socket";
/// Shortest token, characters; shorter ones can be guessed.
const MIN_TOKEN: usize = 16;

#[derive(Clone)]
struct Shared {
    registry: Arc<Registry>,
    snapshot: HealthSnapshot,
}

/// The access rules from the configuration.
///
/// # Errors
/// The token's file cannot be read or has no token in it; the time zone is unknown.
pub fn guard_of(page: &Page) -> anyhow::Result<Guard> {
    time_zone_of(page)?;
    let token = token_of(page)?;
    let mut hosts = page.hosts.clone();
    hosts.extend(machine_name());
    Ok(Guard::new(hosts, token, page.behind_proxy))
}

/// The time zone for displayed times.
///
/// # Errors
/// It is unknown.
pub fn time_zone_of(page: &Page) -> anyhow::Result<jiff::tz::TimeZone> {
    let zone = &page.time_zone;
    jiff::tz::TimeZone::get(zone)
        .with_context(|| format!("[web] time_zone {zone:?}: write a name such as Europe/Berlin"))
}

/// The token required by the page; `None` if none is configured.
///
/// # Errors
/// The token's file cannot be read or has no token in it.
pub fn token_of(page: &Page) -> anyhow::Result<Option<String>> {
    if page.token_file.is_empty() {
        return Ok(None);
    }
    let path = Path::new(&page.token_file);
    let text = std::fs::read_to_string(path).with_context(|| format!("[web] token_file {:?}", page.token_file))?;
    let text = text.trim();
    ensure!(
        text.len() >= MIN_TOKEN && !text.contains(char::is_whitespace),
        "[web] token_file {:?}: write one word of at least {MIN_TOKEN} characters, such as `openssl rand -hex 24` gives",
        page.token_file
    );
    Ok(Some(text.to_owned()))
}

/// Network name of this machine.
#[cfg(target_os = "linux")]
fn machine_name() -> Option<String> {
    rustix::system::uname().nodename().to_str().ok().map(str::to_owned)
}

#[cfg(not(target_os = "linux"))]
fn machine_name() -> Option<String> {
    None
}

/// The page's files, and the API with its description under `/api/v1`.
pub fn page(api: Router, description: serde_json::Value) -> Router {
    let api = api.merge(openapi::router(description)).fallback(table::nothing_there);
    Router::new().nest(table::BASE, api).fallback(get(assets::asset))
}

/// A router protected by the rules.
pub fn guarded(router: Router, guard: Arc<Guard>) -> Router {
    router.layer(from_fn_with_state(guard, guard::guard))
}

/// Most connections of one host; all connections if a proxy brings those of many hosts.
#[must_use]
pub const fn connections_per_host(guard: &Guard) -> usize {
    if guard.behind_proxy { MAX_CONNECTIONS } else { CONNECTIONS_PER_HOST }
}

/// Starts the configured servers, with the page if it is enabled. An address that cannot be bound is a fault, and is tried
/// again until it can be; the daemon continues without it.
///
/// # Errors
/// Those of [`guard_of`].
#[must_use]
pub fn serve(view: View, registry: Registry) -> Pin<Box<dyn Future<Output = anyhow::Result<Served>> + Send>> {
    Box::pin(start(view, registry))
}

async fn start(mut view: View, registry: Registry) -> anyhow::Result<Served> {
    let settings = view.config.get().web.clone();
    let rules = settings.page.clone();
    // The token's file may be on a disk that hangs.
    let guard = Arc::new(tokio::task::spawn_blocking(move || guard_of(&rules)).await??);
    if !settings.enabled {
        return Ok(Served { address: None, stop: Box::new(|| ()) });
    }
    let limits = Limits::new(MAX_CONNECTIONS, connections_per_host(&guard));
    let (faults, snapshot) = (view.faults.clone(), view.snapshot.clone());
    let page = view.overview.take().map(|overview| {
        let live = Live::new(view, overview, guard.clone());
        page(api::live(Arc::new(live)), openapi::document(&api::operations()))
    });
    let shared = Shared { registry: Arc::new(registry), snapshot };
    let router = Router::new().route("/metrics", get(metrics_text)).route("/healthz", get(healthz)).with_state(shared);
    let unread = server::unread(guard.behind_proxy);
    let router = guarded(router.merge(page.unwrap_or_default()), guard);
    let router = router.layer(from_fn_with_state(unread, server::count_unread));
    let mut tasks = Vec::new();
    if !settings.page.socket.is_empty() {
        let path = settings.page.socket.clone().into();
        tasks.push(tokio::spawn(serve_socket(path, router.clone(), limits.clone(), faults.clone())));
    }
    let address = match server::listen(&settings.listen).await {
        Ok(listener) => {
            let address = listener.local_addr().ok();
            tasks.push(tokio::spawn(server::accept(listener, router, limits)));
            address
        }
        Err(error) => {
            let (again, remedy) = (BIND_AGAIN.as_secs(), "port 0 takes any free one");
            let what = format!("[web] listen = {:?} cannot be used, tried again every {again} s", settings.listen);
            faults.raise(FAULT, format!("{what}: {error}; {remedy}"));
            tasks.push(tokio::spawn(accept_later(settings.listen, router, limits, faults)));
            None
        }
    };
    Ok(Served { address, stop: Box::new(move || tasks.iter().for_each(JoinHandle::abort)) })
}

async fn accept_later(listen: String, router: Router, limits: Arc<Limits>, faults: Arc<Faults>) {
    loop {
        tokio::time::sleep(BIND_AGAIN).await;
        if let Ok(listener) = server::listen(&listen).await {
            faults.clear(FAULT);
            return server::accept(listener, router, limits).await;
        }
    }
}

/// Serves the Unix socket once it can be created.
#[cfg(unix)]
async fn serve_socket(path: PathBuf, router: Router, limits: Arc<Limits>, faults: Arc<Faults>) {
    loop {
        match open_socket(&path).await {
            Ok(listener) => {
                faults.clear(SOCKET_FAULT);
                return server::accept_local(listener, router, limits).await;
            }
            Err(error) => {
                let again = BIND_AGAIN.as_secs();
                let what = format!("[web] socket = {path:?} cannot be used, tried again every {again} s: {error}");
                faults.raise(SOCKET_FAULT, what);
            }
        }
        tokio::time::sleep(BIND_AGAIN).await;
    }
}

/// A socket that the daemon's user and group may open. One left by a killed daemon is replaced.
#[cfg(unix)]
async fn open_socket(path: &Path) -> std::io::Result<tokio::net::UnixListener> {
    use std::os::unix::fs::{FileTypeExt, PermissionsExt};
    use tokio::net::{UnixListener, UnixStream};
    if std::fs::symlink_metadata(path).is_ok_and(|meta| meta.file_type().is_socket()) {
        if UnixStream::connect(path).await.is_ok() {
            return Err(std::io::Error::other("another program serves it: give this daemon a path of its own"));
        }
        std::fs::remove_file(path)?;
    }
    let listener = UnixListener::bind(path)?;
    std::fs::set_permissions(path, std::fs::Permissions::from_mode(0o660))?;
    Ok(listener)
}

#[cfg(not(unix))]
async fn serve_socket(path: PathBuf, _: Router, _: Arc<Limits>, faults: Arc<Faults>) {
    faults.raise(SOCKET_FAULT, format!("[web] socket = {path:?}: this system has no Unix sockets; leave it out"));
}

async fn metrics_text(State(shared): State<Shared>, headers: HeaderMap) -> Response {
    let mut text = String::new();
    if prometheus_client::encoding::text::encode(&mut text, &shared.registry).is_err() {
        return StatusCode::INTERNAL_SERVER_ERROR.into_response();
    }
    // The figures of the process go before the end mark.
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

/// 200 with the daemon's health document; 503 if the engine has not reported for [`STALLED_AFTER`] or recording has stopped.
async fn healthz(State(shared): State<Shared>) -> Response {
    let (made, health) = shared.snapshot.read().unwrap_or_else(PoisonError::into_inner).clone();
    let is_well = made.elapsed() < STALLED_AFTER && health.stopped.is_empty();
    let status = if is_well { StatusCode::OK } else { StatusCode::SERVICE_UNAVAILABLE };
    let body = serde_json::to_vec(&*health).unwrap_or_default();
    (status, [(header::CONTENT_TYPE, "application/json")], body).into_response()
}
