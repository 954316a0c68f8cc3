//! Serves the page with the workbench.

use std::sync::Arc;

use axum::http::HeaderMap;
use axum::routing::get;
use axum::{Extension, Json};
use tokio::net::TcpListener;

use super::{Bench, operations, router};
use crate::runtime::clock::now_ns;
use crate::runtime::overview::DataHealth;
use crate::web::api::site::{Loss, Site, SiteKind};
use crate::web::guard::{Guard, Permission};
use crate::web::server::{self, CONNECTIONS_PER_HOST, Limits, MAX_CONNECTIONS, Peer};
use crate::web::{guarded, openapi, page};
use stiction::core::units::ms_from_ns;

/// Serves the page until it is dropped. Only this machine may open and analyse files. Times are shown in `time_zone`.
pub async fn serve(listener: TcpListener, bench: Bench, time_zone: String) {
    let guard = Arc::new(Guard::new(Vec::new(), None, false));
    let started_ns = now_ns();
    let rules = guard.clone();
    let site = move |Extension(peer): Extension<Peer>, headers: HeaderMap| {
        let site = site(rules.permission(peer, &headers), started_ns, &time_zone);
        async move { Json(site) }
    };
    let api = router(bench).route("/site", get(site));
    let limits = Limits::new(MAX_CONNECTIONS, CONNECTIONS_PER_HOST);
    server::accept(listener, guarded(page(api, openapi::document(&operations())), guard), limits).await;
}

/// The site, as a daemon without loops would report it.
fn site(token: Permission, started_ns: i64, time_zone: &str) -> Site {
    Site {
        kind: SiteKind::Workbench,
        prefix: String::new(),
        daemon_id: String::new(),
        version: stiction::core::VERSION,
        config_hash: String::new(),
        time_zone: time_zone.to_owned(),
        now_ms: ms_from_ns(now_ns()),
        started_ms: ms_from_ns(started_ns),
        note: None,
        commands: false,
        token,
        workbench: true,
        workbench_url: None,
        loops: 0,
        faults: Vec::new(),
        loss: Loss::default(),
        data: DataHealth::default(),
    }
}
