//! Reviews of valves by people, stored in the folder of the recordings.

use std::sync::Arc;
use std::time::Duration;

use axum::Json;
use axum::extract::State;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use serde::{Deserialize, Serialize};

use super::curves::recorded;
use super::{Answered, Operation, ResponseKind, Shared, of};
use crate::runtime::clock::now_ns;
use crate::web::error::ApiError;
use crate::web::extract::{JsonBody, PathName};
use stiction::core::record::Signal;
use stiction::core::units::{Moment, ms_from_ns};
use stiction_engine::alarm::check_name;
use stiction_files::reviews::{KeepError, Label, Method, Review, ReviewList};

/// How long a list of alarms waits for the reviews.
const SOON: Duration = Duration::from_secs(1);
/// Longest comment, bytes.
const MAX_WHY: usize = 500;
/// Reviews accepted a minute, and in one burst.
pub(super) const PER_MINUTE: f64 = 30.0;
pub(super) const AT_ONCE: f64 = 10.0;

/// Every review.
#[derive(Serialize, schemars::JsonSchema)]
struct All {
    /// Oldest first.
    reviews: Vec<DatedReview>,
}

/// A review with its times in ms, as the page uses them.
#[derive(Serialize, schemars::JsonSchema)]
pub(super) struct DatedReview {
    #[serde(flatten)]
    review: Review,
    /// When it was written, ms since 1970.
    at_ms: f64,
    /// End of the reviewed window, ms since 1970.
    window_end_ms: f64,
    /// When the valve was repaired, ms since 1970; null if it was not.
    work_at_ms: Option<f64>,
}

/// The stored review.
#[derive(Serialize, schemars::JsonSchema)]
struct Kept {
    review: DatedReview,
}

/// A person's finding.
#[derive(Debug, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
struct NewReview {
    /// Whether the valve sticks.
    label: Label,
    /// How that was established.
    method: Method,
    /// Name of the person.
    by: String,
    /// Comment in that person's words.
    why: Option<String>,
    /// When the valve was repaired, RFC 3339, by the clock of its data; required for `repaired`, and not allowed otherwise.
    #[schemars(with = "Option<String>")]
    work_at: Option<Moment>,
}

impl NewReview {
    /// Refuses a date without work, work without a date, and a date in the future.
    fn check_date(&self, newest_ns: i64) -> Result<(), ApiError> {
        match self.work_at {
            None if self.label == Label::Repaired => {
                Err(ApiError::unfit("work_at is missing: give the date of the work"))
            }
            Some(_) if self.label != Label::Repaired => Err(ApiError::unfit("work_at is for label \"repaired\" only")),
            Some(at) if at.0 > newest_ns.max(now_ns()) => Err(ApiError::unfit("work_at is still to come")),
            _ => Ok(()),
        }
    }
}

pub(super) fn operations() -> Vec<Operation<Shared>> {
    vec![
        Operation {
            method: "post",
            path: "/loops/{name}/review",
            summary: "Keeps what somebody found at the valve, with the newest estimate and its samples",
            query: &[],
            body: Some(of::<NewReview>),
            response: ResponseKind::Json(of::<Kept>),
            handler: || post(keep),
        },
        Operation {
            method: "get",
            path: "/reviews",
            summary: "Everything that people found",
            query: &[],
            body: None,
            response: ResponseKind::Json(of::<All>),
            handler: || get(all),
        },
        Operation {
            method: "get",
            path: "/reviews.csv",
            summary: "The same as the index that `stiction-lab evaluate` takes",
            query: &[],
            body: None,
            response: ResponseKind::File("text/csv"),
            handler: || get(index),
        },
    ]
}

impl From<Review> for DatedReview {
    fn from(review: Review) -> Self {
        let ms = |at: Moment| ms_from_ns(at.0);
        Self { at_ms: ms(review.at), window_end_ms: ms(review.window_end), work_at_ms: review.work_at.map(ms), review }
    }
}

/// The reviews now in the folder.
pub(super) async fn current(live: &Shared) -> Result<Arc<ReviewList>, ApiError> {
    let of = live.clone();
    let read = live.at_reviews.run(move || of.reviews.read()).await?;
    read.map_err(|why| ApiError::new(StatusCode::INTERNAL_SERVER_ERROR, why))
}

/// The same, or as last read if the folder does not respond soon, for requests that must not wait for it. A damaged index is
/// reported where reviews are requested.
pub(super) async fn newest_known(live: &Shared) -> Arc<ReviewList> {
    match tokio::time::timeout(SOON, current(live)).await {
        Ok(Ok(list)) => list,
        Ok(Err(_)) | Err(_) => live.reviews.known(),
    }
}

async fn keep(
    State(live): State<Shared>,
    PathName(name): PathName,
    JsonBody(new): JsonBody<NewReview>,
) -> Answered<Kept> {
    if !live.takes_commands() {
        let why = "reviews are commands, and these are switched off: [commands] enabled = false";
        return Err(ApiError::new(StatusCode::FORBIDDEN, why));
    }
    let NewReview { label, method, by, why, work_at } = &new;
    check_name(Some(by)).map_err(|e| ApiError::unfit(e.to_string()))?;
    if why.as_ref().is_some_and(|why| why.len() > MAX_WHY) {
        return Err(ApiError::unfit(format!("why is longer than {MAX_WHY} bytes; shorten it")));
    }
    let newest = live.overview.newest(&name).and_then(|newest| newest.estimate);
    let none =
        || ApiError::not_found(format!("{name}: no window has been answered yet, so there is nothing to review"));
    let estimate = newest.ok_or_else(none)?;
    new.check_date(estimate.assessment.window.end_ns)?;
    if !live.allow_review() {
        let why = format!("more than {PER_MINUTE} reviews a minute: try again later");
        return Err(ApiError::new(StatusCode::TOO_MANY_REQUESTS, why));
    }
    let a = &estimate.assessment;
    let review = Review {
        file: String::new(),
        label: *label,
        r#loop: name.clone(),
        method: *method,
        by: by.clone(),
        why: why.clone().filter(|why| !why.trim().is_empty()),
        at: Moment(now_ns()),
        window_end: Moment(a.window.end_ns),
        verdict: a.verdict.name().to_owned(),
        p_stiction: a.p_stiction,
        s: a.s,
        work_at: *work_at,
    };
    let range = [a.window.start_ns, a.window.end_ns];
    let (of, keep_days) = (live.archive.clone(), live.config.get().retention.results_days);
    let samples = live.looks.run(move || recorded(&of, &name, &Signal::ALL, range)).await?;
    let of = live.clone();
    let keep = move || of.reviews.keep(review, &samples, keep_days);
    let kept = live.at_reviews.run(keep).await?;
    let status = |error: &KeepError| match error {
        KeepError::Full(_) => StatusCode::INSUFFICIENT_STORAGE,
        KeepError::System(_) => StatusCode::INTERNAL_SERVER_ERROR,
    };
    let review = kept.map_err(|error| ApiError::new(status(&error), error.to_string()))?;
    Ok(Json(Kept { review: review.into() }))
}

async fn all(State(live): State<Shared>) -> Answered<All> {
    let reviews = current(&live).await?;
    Ok(Json(All { reviews: reviews.all().iter().cloned().map(DatedReview::from).collect() }))
}

async fn index(State(live): State<Shared>) -> Result<Response, ApiError> {
    let name = "attachment; filename=\"reviews.csv\"";
    let failed = |error: std::io::Error| ApiError::new(StatusCode::INTERNAL_SERVER_ERROR, error.to_string());
    let table = current(&live).await?.table().map_err(failed)?;
    let headers = [(header::CONTENT_TYPE, "text/csv; charset=utf-8"), (header::CONTENT_DISPOSITION, name)];
    Ok((headers, table).into_response())
}
