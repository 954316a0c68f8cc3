//! Detection: does the loop oscillate, and which tests speak for the valve.

pub mod oscillation;

use serde::Serialize;

use crate::record::Record;

/// One witness's say.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Witness {
    /// Its name in the catalogue.
    pub name: &'static str,
    /// Its figure, defined where the witness is.
    pub score: Option<f64>,
    /// For stiction, against, or silent.
    pub vote: Option<bool>,
}

/// A test that says something about the valve from one record.
pub trait Detector: Sync {
    /// Its name in documents.
    fn name(&self) -> &'static str;
    /// What it says of this record.
    fn say(&self, record: &Record) -> Witness;
}

/// Every detector.
pub const ALL: [&dyn Detector; 0] = [];
