//! Judgement on one window: validity checks, fit, verdict, grade.

pub mod answer;
mod assess;
pub mod bump_test;
mod cause;
mod detectable;
mod document;
mod evidence;
mod excursion;
pub mod features;
mod gates;
mod group;
pub mod headline;
mod judgement;
mod params;
pub(crate) mod plausible;
pub mod prevalence;
mod process;
pub mod rule;
mod screen;
pub mod swapped;
pub mod tally;
pub mod texts;
mod valve_position;

pub use crate::core::detect::Indicator;
pub use crate::core::ident::{DelayChoice, ModelChoice, ValveChoice};
pub use assess::{assess, assess_in_windows, figures, is_screened_out};
pub use cause::Missing;
pub use document::{
    Assessment, Controller, CountedBy, ESTIMATE_SCHEMA, EstimateDocument, Gate, Implausible, MemberJudgement, NO_VALVE,
    Oscillation, Process, Search, Verdict, Window, reasons,
};
pub use gates::is_fraction;
pub use params::AssessParams;
pub use prevalence::for_prevalence;
pub use screen::SCREENED;
pub use valve_position::ValvePosition;
