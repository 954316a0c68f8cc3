//! Who may do what over HTTP, and what every answer tells the browser.
//!
//! Reading is open to whoever reaches the address, as `/metrics` is. What changes something needs a header that no foreign
//! page can send, comes from the page's own origin where a browser says which, and from this machine or with the token.
//! Names under which the daemon is called are checked, so that a foreign name that leads here is no way in.

use std::net::IpAddr;
use std::sync::Arc;

use axum::extract::{Request, State};
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

use super::error::ApiError;
use super::server::{Life, Peer};

/// The header that what changes something carries: a page of another origin cannot send it without being asked first.
pub const OWN_HEADER: &str = "x-stictiond";

/// What the page may load: its own files, and nothing that stands in the markup itself.
const CONTENT: &str = "default-src 'self'; img-src 'self' data:; object-src 'none'; base-uri 'none'; form-action 'self'; \
                       frame-ancestors 'none'";

/// The rules.
#[derive(Debug)]
pub struct Guard {
    /// Names beside addresses and `localhost`.
    pub hosts: Vec<String>,
    /// What commands from other machines carry; none come from there without one.
    pub token: Option<String>,
}

/// Whether who asks may change something, as `token` of `/api/v1/site` says it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, schemars::JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Permission {
    /// Yes, without a token.
    None,
    /// Yes, by the token that came along.
    Given,
    /// With a token only.
    Needed,
    /// Not from there: there is no token.
    Refused,
}

impl Guard {
    /// Whether a browser may have been told to call us by this name.
    fn knows(&self, host: &str) -> bool {
        let name = match host.strip_prefix('[') {
            Some(rest) => rest.split(']').next().unwrap_or(rest),
            None => host.rsplit_once(':').map_or(host, |(name, _)| name),
        };
        let name = name.trim_end_matches('.');
        name.parse::<IpAddr>().is_ok()
            || name.eq_ignore_ascii_case("localhost")
            || self.hosts.iter().any(|known| known.eq_ignore_ascii_case(name) || known.eq_ignore_ascii_case(host))
    }

    /// What a request from there may do.
    #[must_use]
    pub fn permission(&self, peer: Peer, headers: &HeaderMap) -> Permission {
        // A proxy on this machine speaks for others.
        let forwarded = ["forwarded", "x-forwarded-for", "x-real-ip"].iter().any(|name| headers.contains_key(*name));
        if peer.0.ip().to_canonical().is_loopback() && !forwarded {
            return Permission::None;
        }
        let Some(token) = &self.token else { return Permission::Refused };
        let given = headers.get(header::AUTHORIZATION).and_then(|value| value.to_str().ok());
        let given = given.and_then(|value| value.strip_prefix("Bearer ")).unwrap_or_default();
        let same = ring::digest::digest(&ring::digest::SHA256, given.trim().as_bytes());
        let wanted = ring::digest::digest(&ring::digest::SHA256, token.as_bytes());
        // Digests of secrets tell nothing by the time that comparing them takes.
        if same.as_ref() == wanted.as_ref() { Permission::Given } else { Permission::Needed }
    }

    fn check(&self, request: &Request) -> Result<(), ApiError> {
        let headers = request.headers();
        let text = |name: header::HeaderName| headers.get(name).and_then(|value| value.to_str().ok());
        let host = text(header::HOST).unwrap_or_default();
        if !self.knows(host) {
            let why = format!("this daemon is not called {host:?}: add the name to [web] hosts, or use its address");
            return Err(ApiError::new(StatusCode::MISDIRECTED_REQUEST, why));
        }
        if matches!(*request.method(), Method::GET | Method::HEAD) {
            return Ok(());
        }
        let refuse = |why: &str| Err(ApiError::new(StatusCode::FORBIDDEN, why));
        if !headers.contains_key(OWN_HEADER) {
            return refuse("the header X-Stictiond is missing: send X-Stictiond: 1");
        }
        let origin = text(header::ORIGIN).and_then(|origin| origin.split_once("://")).map(|(_, host)| host);
        let foreign = text(header::HeaderName::from_static("sec-fetch-site")).is_some_and(|site| site != "same-origin");
        if foreign || origin.is_some_and(|origin| !origin.eq_ignore_ascii_case(host)) {
            return refuse("this came from another page than the daemon's own");
        }
        let Some(peer) = request.extensions().get::<Peer>() else {
            return refuse("whose request this is is not known");
        };
        match self.permission(*peer, headers) {
            Permission::None | Permission::Given => Ok(()),
            Permission::Needed => {
                Err(ApiError::new(StatusCode::UNAUTHORIZED, "a token is needed: see [web] token_file"))
            }
            Permission::Refused => {
                refuse("only this machine may change something: [web] token_file opens it to others")
            }
        }
    }
}

/// Lets through what the rules allow, and writes the headers of every answer.
pub async fn guard(State(guard): State<Arc<Guard>>, request: Request, next: Next) -> Response {
    if let Some(life) = request.extensions().get::<Life>() {
        life.show();
    }
    let of_page = request.uri().path().starts_with("/api/");
    let mut response = match guard.check(&request) {
        Ok(()) => next.run(request).await,
        Err(refused) => refused.into_response(),
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
    set(header::HeaderName::from_static("cross-origin-opener-policy"), "same-origin");
    if of_page {
        set(header::CACHE_CONTROL, "no-store");
    }
    response
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::body::Body;

    fn request(method: &str, headers: &[(&'static str, &str)], peer: &str) -> Request {
        let mut request = axum::http::Request::builder().method(method).uri("/api/v1/x");
        for (name, value) in headers {
            request = request.header(*name, *value);
        }
        let mut request = request.body(Body::empty()).unwrap();
        request.extensions_mut().insert(Peer(peer.parse().unwrap()));
        request
    }

    #[test]
    fn commands_need_their_header_their_origin_and_a_near_place_or_the_token() {
        let guard = Guard { hosts: vec!["plant.example".into()], token: Some("secret".into()) };
        let (near, far, own) = ("127.0.0.1:5", "10.0.0.7:5", ("x-stictiond", "1"));
        let host = ("host", "localhost:8080");
        let status = |method: &str, headers: &[(&'static str, &str)], peer: &str| {
            guard.check(&request(method, headers, peer)).err().map_or(200, |e| e.status().as_u16())
        };
        assert_eq!(status("GET", &[host], far), 200);
        assert_eq!(status("POST", &[host, own], near), 200);
        assert_eq!(status("POST", &[host], near), 403);
        assert_eq!(status("DELETE", &[host], near), 403);
        assert_eq!(status("POST", &[host, own, ("origin", "http://localhost:8080")], near), 200);
        assert_eq!(status("POST", &[host, own, ("origin", "http://evil.example")], near), 403);
        assert_eq!(status("POST", &[host, own, ("origin", "null")], near), 200);
        assert_eq!(status("POST", &[host, own, ("sec-fetch-site", "cross-site")], near), 403);
        assert_eq!(status("POST", &[host, own], far), 401);
        assert_eq!(status("POST", &[host, own, ("authorization", "Bearer secret")], far), 200);
        assert_eq!(status("POST", &[host, own, ("authorization", "Bearer secre")], far), 401);
        assert_eq!(status("POST", &[host, own, ("x-forwarded-for", "10.0.0.7")], near), 401);
        assert_eq!(status("POST", &[host, own], "[::ffff:127.0.0.1]:5"), 200);
        let without = Guard { hosts: Vec::new(), token: None };
        assert_eq!(without.check(&request("POST", &[host, own], far)).unwrap_err().status().as_u16(), 403);
    }

    #[test]
    fn names_that_lead_here_are_not_ours_for_that() {
        let guard = Guard { hosts: vec!["plant.example".into()], token: None };
        for ours in ["127.0.0.1:8080", "[::1]:8080", "10.1.2.3", "LocalHost:1", "plant.example:8080", "Plant.Example."]
        {
            assert!(guard.knows(ours), "{ours}");
        }
        for foreign in ["", "evil.example:8080", "localhost.evil.example", "plant.example.evil"] {
            assert!(!guard.knows(foreign), "{foreign}");
        }
    }
}
