//! The table of the API's operations, from which both the router and the OpenAPI description are generated.

use axum::Router;
use axum::routing::MethodRouter;
use schemars::{Schema, SchemaGenerator};

use super::error::ApiError;

/// Path of the API.
pub const BASE: &str = "/api/v1";

/// A parameter of a query or a path.
#[derive(Debug, Clone, Copy)]
pub struct Parameter {
    /// Its name; also `{name}` in a path.
    pub name: &'static str,
    /// Its description.
    pub words: &'static str,
}

/// Kind of an operation's answer.
#[derive(Clone, Copy)]
pub enum ResponseKind {
    /// JSON of this schema.
    Json(fn(&mut SchemaGenerator) -> Schema),
    /// A file of this media type.
    File(&'static str),
    /// Server-sent events with JSON data.
    Events,
}

/// An operation.
pub struct Operation<S> {
    /// `get`, `post` or `delete`.
    pub method: &'static str,
    /// Path below [`BASE`].
    pub path: &'static str,
    /// Its description.
    pub summary: &'static str,
    /// Its query parameters, in addition to those in the path.
    pub query: &'static [Parameter],
    /// Schema of its JSON body, if it has one.
    pub body: Option<fn(&mut SchemaGenerator) -> Schema>,
    /// Its answer.
    pub response: ResponseKind,
    /// Its handler.
    pub handler: fn() -> MethodRouter<S>,
}

/// The schema of a type.
pub fn of<T: schemars::JsonSchema>(generator: &mut SchemaGenerator) -> Schema {
    generator.subschema_for::<T>()
}

/// A router for these operations.
pub fn router<S: Clone + Send + Sync + 'static>(operations: &[Operation<S>]) -> Router<S> {
    operations.iter().fold(Router::new(), |router, o| router.route(o.path, (o.handler)()))
}

/// The answer for unknown paths.
pub async fn nothing_there() -> ApiError {
    ApiError::not_found("no such thing here: /api/v1/openapi.json lists what there is")
}
