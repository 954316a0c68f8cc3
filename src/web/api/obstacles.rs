//! Obstacles that keep loops from being judged.

use std::time::Instant;

use axum::Json;
use axum::extract::State;
use axum::routing::get;

use super::{Operation, ResponseKind, Shared, of};
use crate::runtime::overview::Obstacles;

pub(super) fn operations() -> Vec<Operation<Shared>> {
    vec![Operation {
        method: "get",
        path: "/obstacles",
        summary: "What keeps loops from being judged, what to do about it, and the share of loops that can be judged",
        query: &[],
        body: None,
        response: ResponseKind::Json(of::<Obstacles>),
        handler: || get(obstacles),
    }]
}

async fn obstacles(State(live): State<Shared>) -> Json<Obstacles> {
    Json(live.overview.obstacles(Instant::now()))
}
