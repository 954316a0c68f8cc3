//! The page with the workbench alone: no daemon, no bus.

use std::sync::Arc;

use axum::http::HeaderMap;
use axum::routing::get;
use axum::{Extension, Json};
use serde_json::{Value, json};
use tokio::net::TcpListener;

use super::{Bench, router};
use crate::daemon::clock::now_ns;
use crate::web::guard::{Guard, Permission};
use crate::web::server::{self, Peer};

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
fn site(token: Permission, started_ns: i64, time_zone: &str) -> Value {
    let ms = |ns: i64| ns as f64 / 1e6;
    json!({
        "kind": "workbench", "prefix": "", "daemon_id": "", "version": crate::VERSION, "config_hash": "",
        "time_zone": time_zone, "now_ms": ms(now_ns()), "started_ms": ms(started_ns), "commands": false,
        "token": token, "workbench": true, "loops": 0, "faults": [],
        "loss": {"dropped_input": 0, "fits_skipped": 0, "dropped_output": 0, "recording_lost": 0},
    })
}
