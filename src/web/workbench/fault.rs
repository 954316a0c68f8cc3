//! The answer to a request that cannot be carried out: a status, and a sentence with the remedy.

use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};

use crate::web::error::ApiError;

/// Why a request was refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{text}")]
pub struct Fault {
    status: StatusCode,
    text: String,
}

impl Fault {
    fn of(status: StatusCode, text: impl Into<String>) -> Self {
        Self { status, text: text.into() }
    }

    /// 404.
    pub fn missing(text: impl Into<String>) -> Self {
        Self::of(StatusCode::NOT_FOUND, text)
    }

    /// 422: the content cannot be used.
    pub fn wrong(text: impl Into<String>) -> Self {
        Self::of(StatusCode::UNPROCESSABLE_ENTITY, text)
    }

    /// 409: not possible in this state.
    pub fn conflict(text: impl Into<String>) -> Self {
        Self::of(StatusCode::CONFLICT, text)
    }

    /// 413.
    pub fn too_large(text: impl Into<String>) -> Self {
        Self::of(StatusCode::PAYLOAD_TOO_LARGE, text)
    }

    /// 408.
    pub fn too_slow(text: impl Into<String>) -> Self {
        Self::of(StatusCode::REQUEST_TIMEOUT, text)
    }

    /// 429.
    pub fn too_many(text: impl Into<String>) -> Self {
        Self::of(StatusCode::TOO_MANY_REQUESTS, text)
    }

    /// 500: a fault of our disk or threads.
    pub fn own(text: impl Into<String>) -> Self {
        Self::of(StatusCode::INTERNAL_SERVER_ERROR, text)
    }

    /// The explanation.
    #[must_use]
    pub fn text(&self) -> &str {
        &self.text
    }
}

impl IntoResponse for Fault {
    fn into_response(self) -> Response {
        ApiError::new(self.status, self.text).into_response()
    }
}
