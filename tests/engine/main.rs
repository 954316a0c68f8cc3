//! The engine and the libraries below it: their public behaviour, on simulated and recorded loops.
//!
//! One binary, so that shared code is compiled and linked once.
#![allow(missing_docs)]
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod alarm_model;
mod answers;
mod claims;
mod config;
mod engine;
mod engine_gaps;
mod engine_later;
mod engine_plant;
mod formats;
mod fuzz;
#[path = "../common/isa.rs"]
mod isa;
mod maintenance;
mod metamorphic;
mod obstacles;
mod openapi;
mod pages;
mod public_items;
mod simulation;
mod tidy;
mod verdict_texts;
