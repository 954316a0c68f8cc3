//! One line for each thing that the API does: the router and its OpenAPI description are made from the same lines.

use axum::Router;
use axum::routing::MethodRouter;
use schemars::{Schema, SchemaGenerator};

use super::error::ApiError;

/// Where the API lies.
pub const BASE: &str = "/api/v1";

/// A parameter of a query or a path.
#[derive(Debug, Clone, Copy)]
pub struct Parameter {
    /// Its name; `{name}` of the path is one too.
    pub name: &'static str,
    /// What it is, in words.
    pub words: &'static str,
}

/// What an operation answers with.
#[derive(Clone, Copy)]
pub enum ResponseKind {
    /// JSON of this shape.
    Json(fn(&mut SchemaGenerator) -> Schema),
    /// A file of this kind.
    File(&'static str),
    /// Server-sent events, whose data are JSON.
    Events,
}

/// One line of the table.
pub struct Operation<S> {
    /// `get`, `post` or `delete`.
    pub method: &'static str,
    /// Below [`BASE`].
    pub path: &'static str,
    /// What it does, in words.
    pub summary: &'static str,
    /// What it may be told beside the path's own names.
    pub query: &'static [Parameter],
    /// What it is sent, as JSON.
    pub body: Option<fn(&mut SchemaGenerator) -> Schema>,
    /// What it gives.
    pub response: ResponseKind,
    /// What answers.
    pub handler: fn() -> MethodRouter<S>,
}

/// The shape of a type.
pub fn of<T: schemars::JsonSchema>(generator: &mut SchemaGenerator) -> Schema {
    generator.subschema_for::<T>()
}

/// A router of operations.
pub fn router<S: Clone + Send + Sync + 'static>(operations: &[Operation<S>]) -> Router<S> {
    operations.iter().fold(Router::new(), |router, o| router.route(o.path, (o.handler)()))
}

/// The answer for unknown paths.
pub async fn nothing_there() -> ApiError {
    ApiError::not_found("no such thing here: /api/v1/openapi.json lists what there is")
}
