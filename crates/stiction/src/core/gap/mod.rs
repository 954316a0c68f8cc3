//! Model-plant mismatch ("gap"): where it is, which effect causes it, and how much of it adding that effect closes.
//!
//! [`diagnose`] fits the base (He's model, first order with dead time) to the training blocks of a record, then the base with
//! each effect of the [`effects::ALL`] catalogue, and judges them on held-out blocks.

mod agree;
pub mod budget;
pub mod calibration;
mod candidate;
mod decide;
mod diagnosis;
pub mod document;
pub mod effects;
pub(crate) mod enough;
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
pub mod neighbour;
mod neighbours;
mod next_test;
mod noise;
mod own_looks;
mod pairs;
mod plain;
mod plan;
pub mod pool;
mod problem;
mod response;
mod schedule;
pub mod score;
mod search;
mod set_point;
mod settle;
mod signatures;
pub(crate) mod sizes;
mod slips;
mod stages;
mod structure;
mod traces;
pub(crate) mod types;
pub(crate) mod valve_note;
mod valve_signal;
mod weigh;

pub use decide::{Answer, Decision, answers, decide, holds_out};
pub use diagnosis::{MIN_POINTS, diagnose};
pub use evidence::{Basis, Evidence};
pub use given::check as check_model;
pub use judged::Diagnosis;
pub use neighbour::{Neighbour, NeighbourError};
pub use neighbours::compare as compare_neighbours;
pub use sizes::Quantity;
pub use types::*;

/// Model responses of a default search: a third of a second on one core if the base explains everything, about three if
/// nothing does.
pub const DEFAULT_EVALUATIONS: u64 = 1_000_000;
