//! The site, and the daemon or workbench that serves it.

use axum::extract::State;
use axum::http::HeaderMap;
use axum::routing::get;
use axum::{Extension, Json};
use serde::Serialize;
use std::sync::PoisonError;

use super::{Operation, ResponseKind, Shared, of};
use crate::runtime::clock::now_ns;
use crate::runtime::overview::DataHealth;
use crate::web::guard::Permission;
use crate::web::server::Peer;
use stiction::core::units::ms_from_ns;

/// The kind of server.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, schemars::JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum SiteKind {
    /// A running daemon.
    Daemon,
    /// A workbench for files, without a daemon.
    Workbench,
}

/// General data, needed before those of any loop.
#[derive(Debug, Clone, Serialize, schemars::JsonSchema)]
pub struct Site {
    /// The kind of server.
    pub kind: SiteKind,
    /// First chunks of every key.
    pub prefix: String,
    /// The daemon's id.
    pub daemon_id: String,
    /// Version of the program.
    pub version: &'static str,
    /// Hash of the configuration.
    pub config_hash: String,
    /// Time zone for displayed times.
    pub time_zone: String,
    /// The daemon's clock, ms since 1970.
    pub now_ms: f64,
    /// When it started, ms since 1970.
    pub started_ms: f64,
    /// A note about the data that is shown first; null if there is none.
    pub note: Option<&'static str>,
    /// Whether commands are accepted at all.
    pub commands: bool,
    /// Whether this client may send them.
    pub token: Permission,
    /// Whether files can be opened here.
    pub workbench: bool,
    /// Address where files can be opened, from the configuration; null if it has none.
    pub workbench_url: Option<String>,
    /// Loops that have appeared.
    pub loops: usize,
    /// Problems that a person should look at.
    pub faults: Vec<String>,
    /// Losses, by counter.
    pub loss: Loss,
    /// Health of the loops' data.
    pub data: DataHealth,
}

/// Counters of losses; zero on a machine that keeps up.
#[derive(Debug, Clone, Copy, Default, Serialize, schemars::JsonSchema)]
pub struct Loss {
    /// Messages that arrived faster than they could be processed.
    pub dropped_input: u64,
    /// Windows without a fit.
    pub fits_skipped: u64,
    /// Documents that could not be published.
    pub dropped_output: u64,
    /// Messages that could not be recorded.
    pub recording_lost: u64,
}

pub(super) fn operations() -> Vec<Operation<Shared>> {
    vec![Operation {
        method: "get",
        path: "/site",
        summary: "What the daemon is, whether anything is wrong with it, and whether who asks may send commands",
        query: &[],
        body: None,
        response: ResponseKind::Json(of::<Site>),
        handler: || get(site),
    }]
}

async fn site(State(live): State<Shared>, Extension(peer): Extension<Peer>, headers: HeaderMap) -> Json<Site> {
    let token = live.guard.permission(peer, &headers);
    Json(site_of(&live, token))
}

/// The current state of the site.
pub(super) fn site_of(live: &Shared, token: Permission) -> Site {
    let now = now_ns();
    let health = live.snapshot.read().unwrap_or_else(PoisonError::into_inner).1.clone();
    let count = |name: &str| health.counters.get(name).copied().unwrap_or(0);
    let config = live.config.get();
    Site {
        kind: SiteKind::Daemon,
        prefix: config.site.prefix.clone(),
        daemon_id: health.daemon.clone(),
        version: stiction::core::VERSION,
        config_hash: health.config_hash.clone(),
        time_zone: config.web.page.time_zone.clone(),
        now_ms: ms_from_ns(now),
        started_ms: ms_from_ns(live.started_ns),
        note: live.note,
        commands: live.takes_commands(),
        token,
        workbench: false,
        workbench_url: Some(config.web.page.workbench.clone()).filter(|url| !url.is_empty()),
        loops: health.loops,
        faults: health.faults.clone(),
        loss: Loss {
            dropped_input: count("dropped_input"),
            fits_skipped: count("fits_skipped"),
            dropped_output: count("dropped_output"),
            recording_lost: count("recording_lost"),
        },
        data: live.overview.data_health(now),
    }
}
