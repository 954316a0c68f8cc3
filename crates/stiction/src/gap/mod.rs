//! The gap between simulation and plant: where it lies, which effect causes it, how far adding that effect closes it.
//!
//! [`diagnose`] fits the base (He's law, first order with dead time) to the training blocks of a record, then the base
//! with each effect of the [`effects::ALL`] catalogue, and judges on what it was not fitted to.

mod answer;
mod candidate;
mod decide;
mod diagnosis;
pub mod document;
pub mod effects;
mod evaluator;
pub mod evidence;
mod express;
mod filter;
mod forward;
mod given;
pub mod in_loop;
mod judged;
pub mod locate;
pub mod loop_run;
pub mod model;
pub mod model_file;
mod next_test;
mod noise;
mod own_looks;
mod pairs;
mod plain;
mod plan;
pub mod probability;
mod problem;
mod schedule;
pub mod score;
mod search;
mod settle;
mod signatures;
mod sizes;
mod slips;
mod stages;
mod structure;
pub mod text;
mod traces;
pub mod types;
mod valve_signal;
mod weigh;

pub use decide::{By, Decision, decide, holds_out};
pub use diagnosis::{MIN_POINTS, diagnose};
pub use evidence::{Basis, Evidence};
pub use given::check as check_model;
pub use judged::Diagnosis;
pub use probability::Features;
pub use sizes::Quantity;
pub use types::*;

/// Model responses of a default search: a third of a second of one core where the base explains all, some three where
/// nothing does.
pub const DEFAULT_EVALUATIONS: u64 = 1_000_000;
