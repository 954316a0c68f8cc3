//! The page with the workbench alone: no daemon, no bus.

use std::sync::Arc;

use axum::http::HeaderMap;
use axum::routing::get;
use axum::{Extension, Json};
use tokio::net::TcpListener;

use super::{Bench, router};
use crate::daemon::clock::now_ns;
use crate::daemon::overview::DataHealth;
use crate::web::api::site::{Loss, Site, SiteKind};
use crate::web::guard::{Guard, Permission};
use crate::web::server::{self, Peer};
use stiction::units::ms_from_ns;

/// Serves the page until it is dropped. Commands come from this machine alone. `time_zone` is that of the times shown.
pub async fn serve(listener: TcpListener, bench: Bench, time_zone: String) {
    let guard = Arc::new(Guard { hosts: Vec::new(), token: None });
    let started_ns = now_ns();
    let rules = guard.clone();
    let site = move |Extension(peer): Extension<Peer>, headers: HeaderMap| {
        let site = site(rules.permission(peer, &headers), started_ns, &time_zone);
        async move { Json(site) }
    };
    let api = router(bench).route("/site", get(site));
    server::accept(listener, crate::web::page(api, guard)).await;
}

/// As a daemon without loops would say it.
fn site(token: Permission, started_ns: i64, time_zone: &str) -> Site {
    Site {
        kind: SiteKind::Workbench,
        prefix: String::new(),
        daemon_id: String::new(),
        version: crate::VERSION,
        config_hash: String::new(),
        time_zone: time_zone.to_owned(),
        now_ms: ms_from_ns(now_ns()),
        started_ms: ms_from_ns(started_ns),
        note: None,
        commands: false,
        token,
        workbench: true,
        loops: 0,
        faults: Vec::new(),
        loss: Loss::default(),
        data: DataHealth::default(),
    }
}
