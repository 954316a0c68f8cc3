//! Connections: limited in number, for each host and in all, and in time, so that one that is never finished costs little
//! and ends.

use std::collections::HashMap;
use std::net::{IpAddr, Ipv6Addr};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use axum::{Extension, Router};
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::TcpListener;

/// Connections at a time: a browser opens up to six, and a page keeps one of them for good.
pub const MAX_CONNECTIONS: usize = 256;
/// How many of them one host may hold. A proxy may hold all: it stands for many hosts.
pub const CONNECTIONS_PER_HOST: usize = 64;
/// How long a client may take to send the head of a request.
const HEADER_WITHIN: Duration = Duration::from_secs(5);
/// How long a connection may last without a sign of life.
const QUIET_WITHIN: Duration = Duration::from_secs(60);
/// How often connections are checked for a sign of life.
const LOOK_EVERY: Duration = Duration::from_secs(5);
/// Largest head of a request, bytes.
const MAX_HEADER_BYTES: usize = 16 << 10;
/// Pause after a connection could not be accepted.
const ACCEPT_PAUSE: Duration = Duration::from_millis(200);

/// Where a connection comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Peer {
    /// A host, which may be this machine.
    Host(IpAddr),
    /// A program on this machine that may open the Unix socket.
    Socket,
}

impl Peer {
    /// The peer that limits count: an IPv6 host owns all addresses of its /64 network.
    fn counted(self) -> Self {
        match self {
            Self::Host(address) => Self::Host(match address.to_canonical() {
                IpAddr::V6(v6) => Ipv6Addr::from_bits(v6.to_bits() >> 64 << 64).into(),
                v4 @ IpAddr::V4(_) => v4,
            }),
            Self::Socket => self,
        }
    }
}

/// How many of something may be open at a time: in all, and for each peer.
#[derive(Debug)]
pub struct Limits {
    total: usize,
    per_peer: usize,
    open: Mutex<HashMap<Peer, usize>>,
}

/// One of them, until it is dropped.
#[derive(Debug)]
pub struct Slot {
    limits: Arc<Limits>,
    peer: Peer,
}

impl Limits {
    /// These limits.
    #[must_use]
    pub fn new(total: usize, per_peer: usize) -> Arc<Self> {
        Arc::new(Self { total, per_peer, open: Mutex::default() })
    }

    /// A slot for this peer; `None` where it has as many as it may, or all are taken.
    #[must_use]
    pub fn take(self: &Arc<Self>, peer: Peer) -> Option<Slot> {
        let peer = peer.counted();
        let mut open = self.open.lock().unwrap_or_else(PoisonError::into_inner);
        if open.values().sum::<usize>() >= self.total {
            return None;
        }
        let own = open.entry(peer).or_insert(0);
        if *own >= self.per_peer {
            return None;
        }
        *own += 1;
        Some(Slot { limits: self.clone(), peer })
    }
}

impl Drop for Slot {
    fn drop(&mut self) {
        let mut open = self.limits.open.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(own) = open.get_mut(&self.peer) {
            *own -= 1;
            if *own == 0 {
                open.remove(&self.peer);
            }
        }
    }
}

/// When a connection last showed life: a request began, a part of a body arrived, a part of a stream was taken.
#[derive(Debug, Clone)]
pub struct IdleTimer {
    since: Instant,
    last_ms: Arc<AtomicU64>,
}

impl IdleTimer {
    fn new() -> Self {
        Self { since: Instant::now(), last_ms: Arc::default() }
    }

    /// Notes a sign of life.
    pub fn touch(&self) {
        let ms = u64::try_from(self.since.elapsed().as_millis()).unwrap_or(u64::MAX);
        self.last_ms.fetch_max(ms, Ordering::Relaxed);
    }

    /// Ready once there was no sign of life for too long.
    async fn expired(&self) {
        loop {
            tokio::time::sleep(LOOK_EVERY).await;
            let last = Duration::from_millis(self.last_ms.load(Ordering::Relaxed));
            if self.since.elapsed().saturating_sub(last) > QUIET_WITHIN {
                return;
            }
        }
    }
}

/// Accepts connections for ever. One beyond the limits is closed at once.
pub async fn accept(listener: TcpListener, router: Router, limits: Arc<Limits>) {
    loop {
        match listener.accept().await {
            Ok((stream, address)) => answer(stream, Peer::Host(address.ip()), &router, &limits),
            // Most likely no file descriptor is free.
            Err(_) => tokio::time::sleep(ACCEPT_PAUSE).await,
        }
    }
}

/// The same on a Unix socket.
#[cfg(unix)]
pub(super) async fn accept_local(listener: tokio::net::UnixListener, router: Router, limits: Arc<Limits>) {
    loop {
        match listener.accept().await {
            Ok((stream, _)) => answer(stream, Peer::Socket, &router, &limits),
            Err(_) => tokio::time::sleep(ACCEPT_PAUSE).await,
        }
    }
}

fn answer(
    stream: impl AsyncRead + AsyncWrite + Send + Unpin + 'static,
    peer: Peer,
    router: &Router,
    limits: &Arc<Limits>,
) {
    let Some(slot) = limits.take(peer) else { return };
    let idle = IdleTimer::new();
    let service = TowerToHyperService::new(router.clone().layer(Extension(idle.clone())).layer(Extension(peer)));
    tokio::spawn(async move {
        let mut http = http1::Builder::new();
        http.timer(TokioTimer::new()).header_read_timeout(HEADER_WITHIN).max_buf_size(MAX_HEADER_BYTES);
        // An error here is one of the client: it gets no answer, and nothing else depends on it.
        tokio::select! {
            _ = http.serve_connection(TokioIo::new(stream), service) => {}
            () = idle.expired() => {}
        }
        drop(slot);
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    fn host(address: &str) -> Peer {
        Peer::Host(address.parse().unwrap())
    }

    #[test]
    fn one_host_leaves_slots_for_others_and_a_slot_comes_back() {
        let limits = Limits::new(5, 3);
        let first: Vec<Slot> = std::iter::from_fn(|| limits.take(host("10.0.0.1"))).collect();
        assert_eq!(first.len(), 3);
        let others = [limits.take(host("10.0.0.2")), limits.take(Peer::Socket)];
        assert!(others.iter().all(Option::is_some) && limits.take(host("10.0.0.3")).is_none());
        drop(first);
        let again: Vec<Slot> = std::iter::from_fn(|| limits.take(host("::ffff:10.0.0.1"))).collect();
        assert_eq!(again.len(), 3);
        drop((again, others));
        assert!(limits.open.lock().unwrap().is_empty());
    }

    #[test]
    fn all_addresses_of_an_ipv6_network_are_one_host() {
        let limits = Limits::new(9, 2);
        let taken: Vec<Slot> = (1..9).filter_map(|k| limits.take(host(&format!("2001:db8::{k}")))).collect();
        assert_eq!(taken.len(), 2);
        assert!(limits.take(host("2001:db8:0:1::1")).is_some());
    }
}
