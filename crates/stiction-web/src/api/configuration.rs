//! The configuration of the running daemon: its file is read again, or another text is compared with what is in force.

use std::time::Duration;

use axum::Json;
use axum::extract::{DefaultBodyLimit, State};
use axum::http::StatusCode;
use axum::routing::post;
use serde::Deserialize;
use tokio::sync::oneshot;

use super::{Answered, ApiError, Operation, ResponseKind, Shared, of, within};
use crate::extract::JsonBody;
use stiction_monitor::config::ConfigChanges;
use stiction_runtime::control::{ConfigRequest, ConfigWish};

/// Longest text of a configuration, bytes: a site may list a hundred thousand loops.
const MAX_TEXT: usize = 64 << 20;
/// How long the daemon may take.
const WITHIN: Duration = Duration::from_secs(60);

/// A text to compare.
#[derive(Debug, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
struct Candidate {
    /// The configuration, TOML.
    toml: String,
}

pub(super) fn operations() -> Vec<Operation<Shared>> {
    vec![
        Operation {
            method: "post",
            path: "/configuration/reload",
            summary: "Takes over what changed in the daemon's configuration file, as a whole or not at all; gives what changed",
            query: &[],
            body: None,
            response: ResponseKind::Json(of::<ConfigChanges>),
            handler: || post(reload),
        },
        Operation {
            method: "post",
            path: "/configuration/changes",
            summary: "What differs in another configuration from the one in force; changes nothing",
            query: &[],
            body: Some(of::<Candidate>),
            response: ResponseKind::Json(of::<ConfigChanges>),
            handler: || post(changes).layer(DefaultBodyLimit::max(MAX_TEXT)),
        },
    ]
}

async fn reload(State(live): State<Shared>) -> Answered<ConfigChanges> {
    if !live.takes_commands() {
        let why = "commands are switched off ([commands] enabled = false): send SIGHUP to the daemon instead";
        return Err(ApiError::new(StatusCode::FORBIDDEN, why));
    }
    ask(&live, ConfigWish::Reload).await
}

async fn changes(
    State(live): State<Shared>,
    JsonBody(Candidate { toml }): JsonBody<Candidate>,
) -> Answered<ConfigChanges> {
    ask(&live, ConfigWish::Compare(toml)).await
}

async fn ask(live: &Shared, wish: ConfigWish) -> Answered<ConfigChanges> {
    let (tell, told) = oneshot::channel();
    let answer = Box::new(move |result| drop(tell.send(result)));
    if !(live.ask_config)(ConfigRequest { wish, answer }) {
        return Err(ApiError::busy("too many ask for the configuration already: try again in a moment"));
    }
    within(WITHIN, told).await?.map(Json).map_err(ApiError::unfit)
}
