//! Judgement on one window: gates, fit, verdict, grade.

mod document;
mod params;

pub use document::{
    Assessment, Controller, ESTIMATE_SCHEMA, EstimateDocument, Gate, Oscillation, Process, Search, Verdict, Window,
    Witness,
};
pub use params::{AssessParams, DelayChoice, ModelChoice, ValveChoice};
