//! What `analyze` says of one loop or section: an estimate, and what was looked at, compared and drawn beside it.

use std::path::PathBuf;

use serde::Serialize;

use super::analyze_report::Subject;
use super::selection::Taken;
use super::solving::SolverDocument;
use stiction::verdict::EstimateDocument;

/// How well a model from elsewhere follows the record, free run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Scored {
    /// Its file.
    pub model: PathBuf,
    /// Mean squared error, PV units squared.
    pub mse: f64,
    /// 100 (1 - rms error / std PV).
    pub fit_pct: f64,
}

/// An estimate with what `analyze` adds to the published document.
#[derive(Debug, Serialize)]
pub struct Answer {
    /// As the daemon would publish it.
    #[serde(flatten)]
    pub document: EstimateDocument,
    /// Span of OP, which `fs + fd` was kept within; null where OP does not move.
    pub s0: Option<f64>,
    /// What of the file was looked at.
    pub selection: Taken,
    /// What the solver found that was asked for.
    pub solver: Option<SolverDocument>,
    /// How well the model follows that was given.
    pub scored: Option<Scored>,
    /// What the report draws.
    #[serde(skip)]
    pub looked_at: Subject,
}
