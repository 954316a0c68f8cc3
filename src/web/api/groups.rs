//! Groups of loops that share one oscillation.

use std::time::Instant;

use axum::Json;
use axum::extract::State;
use axum::routing::get;

use super::{Operation, ResponseKind, Shared, of};
use crate::runtime::overview::ShownGroups;

pub(super) fn operations() -> Vec<Operation<Shared>> {
    vec![Operation {
        method: "get",
        path: "/groups",
        summary: "Groups of loops that share one oscillation, by the newest comparison, with their members over time",
        query: &[],
        body: None,
        response: ResponseKind::Json(of::<ShownGroups>),
        handler: || get(groups),
    }]
}

async fn groups(State(live): State<Shared>) -> Json<ShownGroups> {
    Json(live.overview.groups(Instant::now()))
}
