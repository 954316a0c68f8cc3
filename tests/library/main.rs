//! The library, seen from outside: what it promises, held on simulated and recorded loops.
//!
//! One binary, so that what all tests share is compiled and linked once.
#![allow(missing_docs)]
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod circles;
mod config;
mod engine;
mod engine_gaps;
mod engine_later;
mod engine_plant;
mod formats;
mod language;
mod openapi;
mod pages;
mod promises;
mod tidy;
mod verdict_texts;
