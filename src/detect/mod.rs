//! Detection: does the loop oscillate, and which tests speak for the valve.

pub mod oscillation;

use crate::record::Record;
use crate::verdict::Witness;

/// A test that says something about the valve from one record.
pub trait Detector: Sync {
    /// Its name in documents.
    fn name(&self) -> &'static str;
    /// What it says of this record.
    fn say(&self, record: &Record) -> Witness;
}

/// Every detector.
pub const ALL: [&dyn Detector; 0] = [];
