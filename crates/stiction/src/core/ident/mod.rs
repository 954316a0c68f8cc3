//! Identification: the size of the stiction, and the process behind the valve.
//!
//! [`quantify`] fits a valve model and a process model to one record in free run: the valve model runs on OP as recorded, the
//! process responds with a continuous dead time, and all linear parameters (gain, kinetic band, bias, initial state) are solved
//! exactly. The search is seeded, bounded in work and scale-free.

mod choice;
pub mod class;
pub mod controller;
pub mod evaluator;
pub mod free_run;
pub(crate) mod hypothetical;
pub(crate) mod kinetic_band;
pub(crate) mod least_squares;
mod model;
mod no_fit;
pub(crate) mod normalised;
mod quantify;
pub(crate) mod random;
pub mod region;
pub mod residual;
mod robust;
pub mod sign;
pub(crate) mod slip_search;
pub mod width;

/// Schema name of documents with an estimate, from which models can be read.
pub const ESTIMATE_SCHEMA: &str = "stictiond.estimate.v1";

pub use choice::{DelayChoice, ModelChoice, Options, ValveChoice};
pub use model::Model;
pub use no_fit::NoFit;
pub use quantify::{Estimate, FitBasis, quantify};
pub use slip_search::answer::{OrderBy, OrderChoice};
