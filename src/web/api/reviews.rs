//! What people found at valves, kept beside the recordings.

use axum::Json;
use axum::extract::{Path, State};
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use serde::{Deserialize, Serialize};

use super::curves::recorded;
use super::{Answered, Gives, Operation, Shared, of};
use crate::daemon::clock::now_ns;
use crate::files::reviews::{Label, Method, Review};
use crate::web::error::ApiError;
use crate::web::extract::Sent;
use stiction::record::Signal;
use stiction::units::{Moment, ms_from_ns};
use stiction_monitor::alarm::check_name;

/// Longest explanation, bytes.
const MAX_WHY: usize = 500;

/// Every review.
#[derive(Serialize, schemars::JsonSchema)]
struct All {
    /// Oldest first.
    reviews: Vec<Told>,
}

/// A review with its time as the page counts it.
#[derive(Serialize, schemars::JsonSchema)]
pub(super) struct Told {
    #[serde(flatten)]
    review: Review,
    /// When it was said, ms since 1970.
    at_ms: f64,
    /// End of the window that was judged, ms since 1970.
    window_end_ms: f64,
}

/// The review that was kept.
#[derive(Serialize, schemars::JsonSchema)]
struct Kept {
    review: Told,
}

/// What somebody found.
#[derive(Debug, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
struct Found {
    /// Whether the valve sticks.
    label: Label,
    /// How that was found out.
    method: Method,
    /// Who says so.
    by: String,
    /// In that person's words.
    why: Option<String>,
}

pub(super) fn operations() -> Vec<Operation<Shared>> {
    vec![
        Operation {
            method: "post",
            path: "/loops/{name}/review",
            summary: "Keeps what somebody found at the valve, with the newest estimate and its samples",
            query: &[],
            body: Some(of::<Found>),
            gives: Gives::Json(of::<Kept>),
            handler: || post(keep),
        },
        Operation {
            method: "get",
            path: "/reviews",
            summary: "Everything that people found",
            query: &[],
            body: None,
            gives: Gives::Json(of::<All>),
            handler: || get(all),
        },
        Operation {
            method: "get",
            path: "/reviews.csv",
            summary: "The same as the index that `stictiond evaluate` takes",
            query: &[],
            body: None,
            gives: Gives::File("text/csv"),
            handler: || get(index),
        },
    ]
}

impl From<Review> for Told {
    fn from(review: Review) -> Self {
        Self { at_ms: ms_from_ns(review.at.0), window_end_ms: ms_from_ns(review.window_end.0), review }
    }
}

/// The last review of each loop.
pub(super) fn last_of_loops(live: &Shared) -> std::collections::HashMap<String, Told> {
    // A damaged index is told where reviews are asked for.
    let all = live.reviews.all().unwrap_or_default();
    all.into_iter().map(|review| (review.r#loop.clone(), review.into())).collect()
}

async fn keep(
    State(live): State<Shared>,
    Path(name): Path<String>,
    Sent(Found { label, method, by, why }): Sent<Found>,
) -> Answered<Kept> {
    check_name(Some(&by)).map_err(|e| ApiError::unfit(e.to_string()))?;
    if why.as_ref().is_some_and(|why| why.len() > MAX_WHY) {
        return Err(ApiError::unfit(format!("why has more than {MAX_WHY} bytes: say it in fewer words")));
    }
    let newest = live.overview.newest(&name).and_then(|newest| newest.estimate);
    let none =
        || ApiError::not_found(format!("{name}: no window has been answered yet, so there is nothing to review"));
    let estimate = newest.ok_or_else(none)?;
    let a = &estimate.assessment;
    let review = Review {
        file: String::new(),
        label,
        r#loop: name.clone(),
        method,
        by,
        why: why.filter(|why| !why.trim().is_empty()),
        at: Moment(now_ns()),
        window_end: Moment(a.window.end_ns),
        verdict: a.verdict.name().to_owned(),
        p_stiction: a.p_stiction,
        s: a.s,
    };
    let range = [a.window.start_ns, a.window.end_ns];
    let of_live = live.clone();
    let kept = live
        .on_a_thread(move || {
            let samples = recorded(&of_live.archive, &name, &Signal::ALL, range);
            of_live.reviews.keep(review, &samples)
        })
        .await?;
    let failed = |e| ApiError::new(StatusCode::INTERNAL_SERVER_ERROR, format!("the review could not be kept: {e}"));
    Ok(Json(Kept { review: kept.map_err(failed)?.into() }))
}

async fn all(State(live): State<Shared>) -> Answered<All> {
    let reviews = live.reviews.all().map_err(|why| ApiError::new(StatusCode::INTERNAL_SERVER_ERROR, why))?;
    Ok(Json(All { reviews: reviews.into_iter().map(Told::from).collect() }))
}

async fn index(State(live): State<Shared>) -> Response {
    let name = "attachment; filename=\"reviews.csv\"";
    let text = std::fs::read(live.reviews.index()).unwrap_or_else(|_| b"file,label\n".to_vec());
    ([(header::CONTENT_TYPE, "text/csv; charset=utf-8"), (header::CONTENT_DISPOSITION, name)], text).into_response()
}
