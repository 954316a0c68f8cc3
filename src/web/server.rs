//! Connections, with limits on their number, their time and the bytes that wait for their readers, for each host and in total,
//! so that a connection that is never finished costs little and ends.

use std::collections::HashMap;
use std::io::{self, IoSlice};
use std::net::{IpAddr, Ipv6Addr, SocketAddr};
use std::pin::Pin;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::task::{Context, Poll};
use std::time::{Duration, Instant};

use axum::body::{Body, HttpBody as _, to_bytes};
use axum::extract::{Request, State};
use axum::http::StatusCode;
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use axum::{Extension, Router};
use bytes::Bytes;
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::{TcpListener, TcpSocket, lookup_host};

use super::error::ApiError;

/// Most connections at a time: a browser opens up to six, of which a page keeps one permanently.
pub const MAX_CONNECTIONS: usize = 256;
/// Most connections of one host. A proxy may hold all, since many hosts are behind it.
pub const CONNECTIONS_PER_HOST: usize = 64;
/// How long a client may take to send the head of a request.
const HEADER_WITHIN: Duration = Duration::from_secs(5);
/// How long a connection may last without activity.
const QUIET_WITHIN: Duration = Duration::from_secs(60);
/// How long a client may read nothing while bytes wait for it.
const UNREAD_WITHIN: Duration = Duration::from_secs(20);
/// Bytes of answers that may wait for their readers, in total and for one host.
pub const UNREAD_BYTES: usize = 96 << 20;
const UNREAD_BYTES_PER_HOST: usize = 32 << 20;
/// Answers up to this size are not counted, bytes.
const SMALL_ANSWER: u64 = 64 << 10;
/// Bytes that the system buffers for a connection that reads nothing; the system's own limit is some megabytes.
const SEND_BUFFER: u32 = 256 << 10;
/// Connections that may wait to be accepted.
const BACKLOG: u32 = 1024;
/// Interval between checks for activity.
const LOOK_EVERY: Duration = Duration::from_secs(5);
/// Largest request head, bytes.
const MAX_HEADER_BYTES: usize = 16 << 10;
/// Pause after a failure to accept a connection.
const ACCEPT_PAUSE: Duration = Duration::from_millis(200);

/// Origin of a connection.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Peer {
    /// A host, which may be this machine.
    Host(IpAddr),
    /// A program on this machine that may open the Unix socket.
    Socket,
}

impl Peer {
    /// The peer as limits count it: an IPv6 host owns all addresses of its /64 network.
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

/// Limits on the number of open items: in total, and for each peer.
#[derive(Debug)]
pub struct Limits {
    total: usize,
    per_peer: usize,
    open: Mutex<HashMap<Peer, usize>>,
}

/// A number of open items, until it is dropped.
#[derive(Debug)]
pub struct Slot {
    limits: Arc<Limits>,
    peer: Peer,
    amount: usize,
}

impl Limits {
    /// Limits with these values.
    #[must_use]
    pub fn new(total: usize, per_peer: usize) -> Arc<Self> {
        Arc::new(Self { total, per_peer, open: Mutex::default() })
    }

    /// A slot for this peer; `None` if the peer has its maximum or all slots are taken.
    #[must_use]
    pub fn take(self: &Arc<Self>, peer: Peer) -> Option<Slot> {
        self.take_many(peer, 1)
    }

    /// The same for several slots.
    #[must_use]
    pub fn take_many(self: &Arc<Self>, peer: Peer, amount: usize) -> Option<Slot> {
        let peer = peer.counted();
        let mut open = self.open.lock().unwrap_or_else(PoisonError::into_inner);
        let own = open.get(&peer).copied().unwrap_or(0).saturating_add(amount);
        if own > self.per_peer || open.values().sum::<usize>().saturating_add(amount) > self.total {
            return None;
        }
        open.insert(peer, own);
        Some(Slot { limits: self.clone(), peer, amount })
    }
}

impl Drop for Slot {
    fn drop(&mut self) {
        let mut open = self.limits.open.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(own) = open.get_mut(&self.peer) {
            *own -= self.amount;
            if *own == 0 {
                open.remove(&self.peer);
            }
        }
    }
}

/// Limits on the bytes of answers that wait for their readers. A proxy may hold all, since many hosts are behind it.
#[must_use]
pub fn unread(behind_proxy: bool) -> Arc<Limits> {
    Limits::new(UNREAD_BYTES, if behind_proxy { UNREAD_BYTES } else { UNREAD_BYTES_PER_HOST })
}

/// An answer's bytes with their share of the limit.
struct Held {
    bytes: Bytes,
    _room: Slot,
}

impl AsRef<[u8]> for Held {
    fn as_ref(&self) -> &[u8] {
        &self.bytes
    }
}

/// Counts the bytes of an answer until the last of them is sent; refuses an answer for which there is no room. An answer larger
/// than a host's limit takes the whole limit.
pub async fn count_unread(State(unread): State<Arc<Limits>>, request: Request, next: Next) -> Response {
    let peer = request.extensions().get::<Peer>().copied();
    let response = next.run(request).await;
    let large = response.body().size_hint().exact().filter(|bytes| *bytes > SMALL_ANSWER);
    let Some((bytes, peer)) = large.zip(peer) else { return response };
    let amount = usize::try_from(bytes).unwrap_or(usize::MAX).min(unread.per_peer);
    let Some(room) = unread.take_many(peer, amount) else {
        let why = "too many large answers wait for whoever asked for them already: try again in a moment";
        return ApiError::busy(why).into_response();
    };
    let (head, body) = response.into_parts();
    match to_bytes(body, usize::MAX).await {
        Ok(bytes) => Response::from_parts(head, Body::from(Bytes::from_owner(Held { bytes, _room: room }))),
        Err(error) => ApiError::new(StatusCode::INTERNAL_SERVER_ERROR, error.to_string()).into_response(),
    }
}

/// When a connection was last active (a request began, a part of a body arrived, a part of a stream was taken), and since when
/// its peer has read nothing of what was sent.
#[derive(Debug, Clone)]
pub struct IdleTimer {
    since: Instant,
    last_ms: Arc<AtomicU64>,
    unread_ms: Arc<AtomicU64>,
}

/// No bytes wait for the peer.
const NONE_WAIT: u64 = u64::MAX;

impl IdleTimer {
    fn new() -> Self {
        Self { since: Instant::now(), last_ms: Arc::default(), unread_ms: Arc::new(AtomicU64::new(NONE_WAIT)) }
    }

    fn now_ms(&self) -> u64 {
        u64::try_from(self.since.elapsed().as_millis()).unwrap_or(NONE_WAIT - 1)
    }

    /// Notes activity.
    pub fn touch(&self) {
        self.last_ms.fetch_max(self.now_ms(), Ordering::Relaxed);
    }

    /// Notes whether the system accepted bytes for the peer.
    fn wrote<T>(&self, polled: Poll<T>) -> Poll<T> {
        if polled.is_ready() {
            self.unread_ms.store(NONE_WAIT, Ordering::Relaxed);
        } else {
            let _ = self.unread_ms.compare_exchange(NONE_WAIT, self.now_ms(), Ordering::Relaxed, Ordering::Relaxed);
        }
        polled
    }

    /// Whether there was no activity for too long, or bytes have waited too long.
    fn is_over(&self, now_ms: u64) -> bool {
        let since = |ms: u64| Duration::from_millis(now_ms.saturating_sub(ms));
        let unread_ms = self.unread_ms.load(Ordering::Relaxed);
        since(self.last_ms.load(Ordering::Relaxed)) > QUIET_WITHIN
            || (unread_ms != NONE_WAIT && since(unread_ms) > UNREAD_WITHIN)
    }

    /// Returns once one of the limits is exceeded.
    async fn expired(&self) {
        while !self.is_over(self.now_ms()) {
            tokio::time::sleep(LOOK_EVERY).await;
        }
    }
}

/// A connection that notes whether its peer reads what it is sent.
struct Watched<S> {
    stream: S,
    idle: IdleTimer,
}

impl<S: AsyncRead + Unpin> AsyncRead for Watched<S> {
    fn poll_read(mut self: Pin<&mut Self>, cx: &mut Context<'_>, buf: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_read(cx, buf)
    }
}

impl<S: AsyncWrite + Unpin> AsyncWrite for Watched<S> {
    fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        let polled = Pin::new(&mut self.stream).poll_write(cx, bytes);
        self.idle.wrote(polled)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        parts: &[IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let polled = Pin::new(&mut self.stream).poll_write_vectored(cx, parts);
        self.idle.wrote(polled)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(cx)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(cx)
    }
}

/// Listens on an address; the system buffers little of what a client does not read.
///
/// # Errors
/// The system's error for the last address of the name.
pub async fn listen(address: &str) -> io::Result<TcpListener> {
    let mut refused = io::Error::new(io::ErrorKind::InvalidInput, "the name has no address");
    for address in lookup_host(address).await? {
        match listen_at(address) {
            Ok(listener) => return Ok(listener),
            Err(error) => refused = error,
        }
    }
    Err(refused)
}

fn listen_at(address: SocketAddr) -> io::Result<TcpListener> {
    let socket = if address.is_ipv4() { TcpSocket::new_v4()? } else { TcpSocket::new_v6()? };
    #[cfg(unix)]
    socket.set_reuseaddr(true)?;
    // Accepted connections inherit it from the listener.
    socket.set_send_buffer_size(SEND_BUFFER)?;
    socket.bind(address)?;
    socket.listen(BACKLOG)
}

/// Accepts connections for ever. Connections beyond the limits are closed at once.
pub async fn accept(listener: TcpListener, router: Router, limits: Arc<Limits>) {
    loop {
        match listener.accept().await {
            Ok((stream, address)) => answer(stream, Peer::Host(address.ip()), &router, &limits),
            // Most likely there is no free file descriptor.
            Err(_) => tokio::time::sleep(ACCEPT_PAUSE).await,
        }
    }
}

/// The same for a Unix socket.
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
    let watched = Watched { stream, idle: idle.clone() };
    tokio::spawn(async move {
        let mut http = http1::Builder::new();
        http.timer(TokioTimer::new()).header_read_timeout(HEADER_WITHIN).max_buf_size(MAX_HEADER_BYTES);
        // An error here is the client's: it gets no answer, and nothing else depends on it.
        tokio::select! {
            _ = http.serve_connection(TokioIo::new(watched), service) => {}
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
    fn bytes_are_counted_until_they_are_dropped_and_one_host_leaves_room_for_others() {
        let limits = Limits::new(100, 60);
        let (near, far) = (host("10.0.0.1"), host("10.0.0.2"));
        assert!(limits.take_many(near, 61).is_none() && limits.open.lock().unwrap().is_empty());
        let first = limits.take_many(near, 50);
        assert!(first.is_some() && limits.take_many(near, 11).is_none() && limits.take_many(far, 51).is_none());
        let second = limits.take_many(far, 50);
        assert!(second.is_some() && limits.take(near).is_none());
        drop(first);
        assert!(limits.take_many(near, 50).is_some());
    }

    #[test]
    fn a_connection_is_over_when_it_shows_no_life_or_takes_nothing() {
        let idle = IdleTimer::new();
        let [quiet, unread] = [QUIET_WITHIN, UNREAD_WITHIN].map(|limit| limit.as_millis() as u64);
        assert!(!idle.is_over(quiet) && idle.is_over(quiet + 1));
        idle.last_ms.store(quiet, Ordering::Relaxed);
        assert!(!idle.is_over(quiet + 1));
        assert!(idle.wrote(Poll::<()>::Pending).is_pending());
        let since = idle.unread_ms.load(Ordering::Relaxed);
        assert!(!idle.is_over(since + unread) && idle.is_over(since + unread + 1));
        assert!(idle.wrote(Poll::Ready(())).is_ready());
        assert!(!idle.is_over(since + unread + 1), "it took some");
    }

    #[test]
    fn all_addresses_of_an_ipv6_network_are_one_host() {
        let limits = Limits::new(9, 2);
        let taken: Vec<Slot> = (1..9).filter_map(|k| limits.take(host(&format!("2001:db8::{k}")))).collect();
        assert_eq!(taken.len(), 2);
        assert!(limits.take(host("2001:db8:0:1::1")).is_some());
    }
}
