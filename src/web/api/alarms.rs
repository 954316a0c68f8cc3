//! The list of alarms, and commands on them.

use axum::extract::State;
use axum::response::Response;
use axum::routing::{get, post};
use axum::{Extension, Json};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::time::Duration;

use super::listed::{PART, listed};
use super::reviews::{DatedReview, newest_known};
use super::{Answered, ApiError, ENGINE_WITHIN, Operation, ResponseKind, Shared, of};
use crate::runtime::clock::now_ns;
use crate::runtime::control::Control;
use crate::web::extract::{JsonBody, PathName};
use crate::web::server::IdleTimer;
use stiction::core::units::ns_from_s;
use stiction_engine::alarm::{AlarmDocument, Command, CommandError, State as AlarmState};

/// How long an alarm remains in the list after it has returned to normal.
const SHOWN_S: f64 = 86_400.0;
/// Time limit of a diagnosis.
const DIAGNOSIS_WITHIN: Duration = Duration::from_secs(300);

/// The list.
#[derive(Serialize, schemars::JsonSchema)]
struct Alarms {
    /// Active alarms, and those that changed within a day.
    alarms: Vec<Listed>,
}

/// An alarm, and the last review of its valve.
#[derive(Serialize, schemars::JsonSchema)]
struct Listed {
    #[serde(flatten)]
    alarm: AlarmDocument,
    /// The last review of its loop.
    review: Option<DatedReview>,
}

/// A command on an alarm.
#[derive(Debug, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
struct Commanded {
    /// `ack`, `shelve`, `unshelve`, `suppress`, `unsuppress`, `out_of_service` or `in_service`.
    cmd: String,
    /// Who sends it.
    by: String,
    /// The reason, in that person's words.
    why: Option<String>,
    /// Duration of shelving, s.
    for_s: Option<u64>,
}

/// Who requests a diagnosis, and how.
#[derive(Debug, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
struct Asking {
    /// The name.
    by: String,
    /// Whether the windows of earlier diagnoses help to decide the cause.
    #[serde(default)]
    pool: bool,
}

pub(super) fn operations() -> Vec<Operation<Shared>> {
    vec![
        Operation {
            method: "get",
            path: "/alarms",
            summary: "Alarms that are not at rest, and those that changed within a day",
            query: &[],
            body: None,
            response: ResponseKind::Json(of::<Alarms>),
            handler: || get(alarms),
        },
        Operation {
            method: "post",
            path: "/loops/{name}/alarm",
            summary: "Acknowledges, shelves, suppresses or takes an alarm out of service, or the other way round; gives its new document",
            query: &[],
            body: Some(of::<Commanded>),
            response: ResponseKind::Json(of::<AlarmDocument>),
            handler: || post(command),
        },
        Operation {
            method: "post",
            path: "/loops/{name}/gap",
            summary: "Diagnoses the loop now and gives the gap document; takes seconds, more where others wait",
            query: &[],
            body: Some(of::<Asking>),
            response: ResponseKind::Json(of::<Value>),
            handler: || post(diagnose),
        },
    ]
}

async fn alarms(State(live): State<Shared>, Extension(idle): Extension<IdleTimer>) -> Response {
    let since_ns = now_ns().saturating_sub(ns_from_s(SHOWN_S));
    let shown = move |d: &AlarmDocument| d.state != AlarmState::Normal || d.changed_ns >= since_ns;
    let reviews = newest_known(&live).await;
    let mut alarms = live.overview.alarms().into_iter().filter(move |d| shown(d));
    let parts = std::iter::from_fn(move || {
        let listed = |d: std::sync::Arc<AlarmDocument>| {
            let review = reviews.newest_of(&d.loop_name).cloned().map(DatedReview::from);
            Listed { alarm: (*d).clone(), review }
        };
        let part: Vec<Listed> = alarms.by_ref().take(PART).map(listed).collect();
        (!part.is_empty()).then_some(part)
    });
    listed(&Alarms { alarms: Vec::new() }, idle, parts)
}

async fn command(
    State(live): State<Shared>,
    PathName(loop_name): PathName,
    JsonBody(Commanded { cmd, by, why, for_s }): JsonBody<Commanded>,
) -> Answered<Value> {
    live.check_shard(&loop_name)?;
    let action = cmd.parse().map_err(|error: CommandError| ApiError::unfit(error.to_string()))?;
    let command = Command { action, by: Some(by), why, for_s };
    live.request(ENGINE_WITHIN, |answer| Control::Command { loop_name, command, answer }).await.map(Json)
}

async fn diagnose(
    State(live): State<Shared>,
    PathName(loop_name): PathName,
    JsonBody(Asking { by, pool }): JsonBody<Asking>,
) -> Answered<Value> {
    live.check_shard(&loop_name)?;
    live.request(DIAGNOSIS_WITHIN, |answer| Control::GapRun { loop_name, by: Some(by), pool, answer }).await.map(Json)
}
