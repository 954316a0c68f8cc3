//! Connections: bounded in number and in time, so that those that are never finished cost little and end.

use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use axum::{Extension, Router};
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use tokio::net::TcpListener;
use tokio::sync::Semaphore;

/// Connections at a time: a browser takes up to six, a page one of them for good.
const MAX_CONNECTIONS: usize = 256;
/// How long a client may take for the head of a request.
const HEADER_WITHIN: Duration = Duration::from_secs(5);
/// How long a connection may last without a sign of life.
const QUIET_WITHIN: Duration = Duration::from_secs(60);
/// How often it is looked whether there was one.
const LOOK_EVERY: Duration = Duration::from_secs(5);
/// Largest head of a request, bytes.
const MAX_HEADER_BYTES: usize = 16 << 10;
/// Pause after a connection could not be taken.
const ACCEPT_PAUSE: Duration = Duration::from_millis(200);

/// Whose connection a request came by.
#[derive(Debug, Clone, Copy)]
pub struct Peer(pub SocketAddr);

/// When a connection last showed life: a request that began, a part of a body that came, a part of a stream that was taken.
#[derive(Debug, Clone)]
pub struct Life {
    since: Instant,
    last_ms: Arc<AtomicU64>,
}

impl Life {
    fn new() -> Self {
        Self { since: Instant::now(), last_ms: Arc::default() }
    }

    /// Here is life.
    pub fn show(&self) {
        let ms = u64::try_from(self.since.elapsed().as_millis()).unwrap_or(u64::MAX);
        self.last_ms.fetch_max(ms, Ordering::Relaxed);
    }

    /// Ready once there was none for too long.
    async fn over(&self) {
        loop {
            tokio::time::sleep(LOOK_EVERY).await;
            let last = Duration::from_millis(self.last_ms.load(Ordering::Relaxed));
            if self.since.elapsed().saturating_sub(last) > QUIET_WITHIN {
                return;
            }
        }
    }
}

/// Takes connections for ever. One too many is closed at once.
pub(super) async fn accept(listener: TcpListener, router: Router) {
    let places = Arc::new(Semaphore::new(MAX_CONNECTIONS));
    loop {
        let Ok((stream, peer)) = listener.accept().await else {
            // No file descriptor is free, most likely: they come back.
            tokio::time::sleep(ACCEPT_PAUSE).await;
            continue;
        };
        let Ok(place) = places.clone().try_acquire_owned() else { continue };
        let life = Life::new();
        let of_connection = router.clone().layer(Extension(life.clone())).layer(Extension(Peer(peer)));
        let service = TowerToHyperService::new(of_connection);
        tokio::spawn(async move {
            let mut http = http1::Builder::new();
            http.timer(TokioTimer::new()).header_read_timeout(HEADER_WITHIN).max_buf_size(MAX_HEADER_BYTES);
            // What a client did wrong is its own affair.
            tokio::select! {
                _ = http.serve_connection(TokioIo::new(stream), service) => {}
                () = life.over() => {}
            }
            drop(place);
        });
    }
}
