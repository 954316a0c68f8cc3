//! Access rules for HTTP, and the headers of every answer.
//!
//! Anyone who reaches the address may read. A request that changes something needs a header that no page of another origin can
//! send, the page's own origin if a browser states one, and the token. If no token is configured, it must come from this
//! machine: through the Unix socket, or directly over loopback if no proxy is configured. A plain TCP proxy adds no header, so
//! its connections look like direct ones: only the token or `behind_proxy` stops them. The host name in the request is checked
//! every time, so that a foreign name that resolves to this machine gives no access.

use std::net::IpAddr;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

use axum::extract::{Request, State};
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use sha2::{Digest, Sha256};

use super::error::ApiError;
use super::server::{IdleTimer, Peer};
use crate::runtime::queue::Rate;
use crate::runtime::queue::logged_rate;

/// Header required for changes: a page of another origin cannot send it without a preflight request.
pub const OWN_HEADER: &str = "x-stictiond";

/// The page may load its own files, and no script or style inside the markup.
const CONTENT: &str = "default-src 'self'; img-src 'self' data:; object-src 'none'; base-uri 'none'; form-action 'self'; \
                       frame-ancestors 'none'";

/// Characters of a refused path that are logged.
const PATH_LOGGED: usize = 64;

/// The access rules.
#[derive(Debug)]
pub struct Guard {
    /// Host names of the server, in addition to addresses and `localhost`.
    pub hosts: Vec<String>,
    /// The token required for commands. Without one, commands are accepted from this machine only.
    pub token: Option<String>,
    /// Whether connections come through a proxy, so that a loopback peer may be anyone.
    pub behind_proxy: bool,
    logged: Mutex<Rate>,
    started: Instant,
}

/// Whether a client may change something, as reported in `token` of `/api/v1/site`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, schemars::JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Permission {
    /// Yes: no token is configured, and the client is on this machine.
    None,
    /// Yes: it sent the token.
    Given,
    /// Only with the token.
    Needed,
    /// No: no token is configured, and the client is not on this machine.
    Refused,
}

/// A host without its port.
fn name_of(host: &str) -> &str {
    let name = match host.strip_prefix('[') {
        Some(rest) => rest.split(']').next().unwrap_or(rest),
        None => host.rsplit_once(':').map_or(host, |(name, _)| name),
    };
    name.trim_end_matches('.')
}

fn text(headers: &HeaderMap, name: header::HeaderName) -> Option<&str> {
    headers.get(name).and_then(|value| value.to_str().ok())
}

/// Whether a proxy states that it forwards this request.
fn is_forwarded(headers: &HeaderMap) -> bool {
    let says = |name: &str| matches!(name, "forwarded" | "via" | "x-real-ip") || name.starts_with("x-forwarded-");
    headers.keys().any(|name| says(name.as_str()))
}

/// Whether the client used a name that means this machine on every machine.
fn is_called_locally(headers: &HeaderMap) -> bool {
    let name = name_of(text(headers, header::HOST).unwrap_or_default());
    name.eq_ignore_ascii_case("localhost") || name.parse::<IpAddr>().is_ok_and(|address| address.is_loopback())
}

impl Guard {
    /// These rules.
    #[must_use]
    pub fn new(hosts: Vec<String>, token: Option<String>, behind_proxy: bool) -> Self {
        Self { hosts, token, behind_proxy, logged: Mutex::new(logged_rate()), started: Instant::now() }
    }

    /// Logs a refused request, at a limited rate. Text from outside is escaped.
    fn log_refusal(&self, method: &Method, path: &str, peer: Option<Peer>, refused: &ApiError) {
        let now_s = self.started.elapsed().as_secs_f64();
        if self.logged.lock().unwrap_or_else(PoisonError::into_inner).allow(now_s) {
            let path: String = path.chars().take(PATH_LOGGED).collect();
            tracing::warn!(%method, ?path, ?peer, status = refused.status().as_u16(), why = refused.why(), "refused");
        }
    }

    /// Whether the server may be called by this name.
    fn knows(&self, host: &str) -> bool {
        let name = name_of(host);
        name.parse::<IpAddr>().is_ok()
            || name.eq_ignore_ascii_case("localhost")
            || self.hosts.iter().any(|known| known.eq_ignore_ascii_case(name) || known.eq_ignore_ascii_case(host))
    }

    /// Whether a request comes from this machine, as far as this can be known.
    fn is_local(&self, peer: Peer, headers: &HeaderMap) -> bool {
        let direct = match peer {
            Peer::Socket => true,
            Peer::Host(address) => {
                !self.behind_proxy && address.to_canonical().is_loopback() && is_called_locally(headers)
            }
        };
        direct && !is_forwarded(headers)
    }

    /// Permission of a request from this peer.
    #[must_use]
    pub fn permission(&self, peer: Peer, headers: &HeaderMap) -> Permission {
        let Some(token) = &self.token else {
            return if self.is_local(peer, headers) { Permission::None } else { Permission::Refused };
        };
        let given = text(headers, header::AUTHORIZATION).and_then(|value| value.strip_prefix("Bearer "));
        let digest = |text: &str| Sha256::digest(text.as_bytes());
        // Comparing digests reveals nothing about the secrets by its duration.
        let same = digest(given.unwrap_or_default().trim()) == digest(token);
        if same { Permission::Given } else { Permission::Needed }
    }

    fn check(&self, request: &Request) -> Result<(), ApiError> {
        let headers = request.headers();
        let host = text(headers, header::HOST).unwrap_or_default();
        if !self.knows(host) {
            let why = format!("{host:?} is not a name of this server: add it to [web] hosts, or use the address");
            return Err(ApiError::new(StatusCode::MISDIRECTED_REQUEST, why));
        }
        if matches!(*request.method(), Method::GET | Method::HEAD) {
            return Ok(());
        }
        let refuse = |why: &str| Err(ApiError::new(StatusCode::FORBIDDEN, why));
        if !headers.contains_key(OWN_HEADER) {
            return refuse("the header X-Stictiond is missing: send X-Stictiond: 1");
        }
        let origin = text(headers, header::ORIGIN).and_then(|origin| origin.split_once("://")).map(|(_, host)| host);
        let site = text(headers, header::HeaderName::from_static("sec-fetch-site"));
        let foreign = site.is_some_and(|site| site != "same-origin");
        if foreign || origin.is_some_and(|origin| !origin.eq_ignore_ascii_case(host)) {
            return refuse("the request came from a page of another origin: send it from the daemon's own page");
        }
        let permission = request.extensions().get::<Peer>().map(|peer| self.permission(*peer, headers));
        match permission.unwrap_or(Permission::Refused) {
            Permission::None | Permission::Given => Ok(()),
            Permission::Needed => {
                let why =
                    "the token is missing or wrong: send Authorization: Bearer TOKEN with the word in [web] token_file";
                Err(ApiError::new(StatusCode::UNAUTHORIZED, why))
            }
            Permission::Refused if self.behind_proxy => {
                refuse("a command through a proxy needs a token: set [web] token_file, or use [web] socket")
            }
            Permission::Refused => refuse(
                "without a token commands come only from this machine, at 127.0.0.1 or localhost and not through a proxy: \
                 set [web] token_file to take them from elsewhere",
            ),
        }
    }
}

/// Passes on the requests that the rules allow, and sets the headers of every answer.
pub async fn guard(State(guard): State<Arc<Guard>>, request: Request, next: Next) -> Response {
    if let Some(idle) = request.extensions().get::<IdleTimer>() {
        idle.touch();
    }
    let of_page = request.uri().path().starts_with("/api/");
    let mut response = match guard.check(&request) {
        Ok(()) => next.run(request).await,
        Err(refused) => {
            if matches!(refused.status(), StatusCode::UNAUTHORIZED | StatusCode::FORBIDDEN) {
                let peer = request.extensions().get::<Peer>().copied();
                guard.log_refusal(request.method(), request.uri().path(), peer, &refused);
            }
            refused.into_response()
        }
    };
    let headers = response.headers_mut();
    let mut set = |name: header::HeaderName, value: &'static str| {
        headers.entry(name).or_insert(HeaderValue::from_static(value));
    };
    set(header::CONTENT_SECURITY_POLICY, CONTENT);
    set(header::X_CONTENT_TYPE_OPTIONS, "nosniff");
    set(header::X_FRAME_OPTIONS, "DENY");
    set(header::REFERRER_POLICY, "no-referrer");
    set(header::HeaderName::from_static("cross-origin-resource-policy"), "same-origin");
    if of_page {
        set(header::CACHE_CONTROL, "no-store");
    }
    response
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::body::Body;

    const OWN: (&str, &str) = ("x-stictiond", "1");
    const LOCAL: (&str, &str) = ("host", "localhost:8080");

    fn guard(token: Option<&str>, behind_proxy: bool) -> Guard {
        Guard::new(vec!["plant.example".into()], token.map(str::to_owned), behind_proxy)
    }

    fn host(address: &str) -> Peer {
        Peer::Host(address.parse().unwrap())
    }

    fn status(guard: &Guard, method: &str, headers: &[(&str, &str)], peer: Peer) -> u16 {
        let mut request = axum::http::Request::builder().method(method).uri("/api/v1/x");
        for (name, value) in headers {
            request = request.header(*name, *value);
        }
        let mut request = request.body(Body::empty()).unwrap();
        request.extensions_mut().insert(peer);
        guard.check(&request).err().map_or(200, |e| e.status().as_u16())
    }

    #[test]
    fn a_command_needs_the_own_header_and_the_own_origin() {
        let (guard, near) = (guard(None, false), host("127.0.0.1"));
        let sent = |method: &str, headers: &[(&str, &str)]| status(&guard, method, headers, near);
        assert_eq!(sent("GET", &[LOCAL]), 200);
        assert_eq!(sent("POST", &[LOCAL, OWN]), 200);
        assert_eq!(sent("POST", &[LOCAL]), 403);
        assert_eq!(sent("DELETE", &[LOCAL]), 403);
        assert_eq!(sent("POST", &[LOCAL, OWN, ("origin", "http://localhost:8080")]), 200);
        assert_eq!(sent("POST", &[LOCAL, OWN, ("origin", "http://evil.example")]), 403);
        assert_eq!(sent("POST", &[LOCAL, OWN, ("sec-fetch-site", "cross-site")]), 403);
    }

    #[test]
    fn without_a_token_commands_come_from_this_machine_alone() {
        let (open, proxied) = (guard(None, false), guard(None, true));
        for near in ["127.0.0.1", "127.0.0.2", "::1", "::ffff:127.0.0.1"] {
            assert_eq!(status(&open, "POST", &[LOCAL, OWN], host(near)), 200, "{near}");
            assert_eq!(status(&proxied, "POST", &[LOCAL, OWN], host(near)), 403, "{near}");
        }
        assert_eq!(status(&open, "POST", &[LOCAL, OWN], host("10.0.0.7")), 403);
        assert_eq!(status(&open, "POST", &[("host", "plant.example"), OWN], host("127.0.0.1")), 403);
        for guard in [&open, &proxied] {
            assert_eq!(status(guard, "POST", &[LOCAL, OWN], Peer::Socket), 200);
            for name in ["forwarded", "via", "x-real-ip", "x-forwarded-for", "x-forwarded-host", "x-forwarded-port"] {
                for peer in [host("127.0.0.1"), Peer::Socket] {
                    assert_eq!(status(guard, "POST", &[LOCAL, OWN, (name, "x")], peer), 403, "{name} {peer:?}");
                }
            }
        }
    }

    #[test]
    fn with_a_token_every_command_needs_it_wherever_it_comes_from() {
        for guard in [guard(Some("secret"), false), guard(Some("secret"), true)] {
            for peer in [host("127.0.0.1"), host("::1"), host("10.0.0.7"), Peer::Socket] {
                let sent = |more: &[(&str, &str)]| status(&guard, "POST", &[&[LOCAL, OWN], more].concat(), peer);
                assert_eq!(sent(&[]), 401, "{peer:?}");
                assert_eq!(sent(&[("authorization", "Bearer secre")]), 401);
                assert_eq!(sent(&[("authorization", "Basic secret")]), 401);
                assert_eq!(sent(&[("authorization", "Bearer secret")]), 200);
                assert_eq!(sent(&[("authorization", "Bearer secret"), ("via", "1.1 p")]), 200);
                assert_eq!(status(&guard, "GET", &[LOCAL], peer), 200);
            }
        }
    }

    #[test]
    fn a_foreign_name_that_resolves_to_this_machine_is_refused() {
        let guard = guard(None, false);
        for ours in ["127.0.0.1:8080", "[::1]:8080", "10.1.2.3", "LocalHost:1", "plant.example:8080", "Plant.Example."]
        {
            assert!(guard.knows(ours), "{ours}");
        }
        for foreign in ["", "evil.example:8080", "localhost.evil.example", "plant.example.evil"] {
            assert!(!guard.knows(foreign), "{foreign}");
        }
    }
}
