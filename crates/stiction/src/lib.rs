//! Valve stiction from routine data: how far a control valve sticks, by which process it is seen, how sure that is, and
//! what else the loop does that the model leaves out.
//!
//! A [`record::Record`] (controller output OP, process variable PV, sampling interval) goes in, typed numbers come out.
//!
//! | task | where |
//! |---|---|
//! | is the valve sticking, and how much | [`verdict::assess`] |
//! | the fit alone: bands of He's valve model, process with dead time, intervals | [`ident::quantify()`](ident::quantify) |
//! | the cost surface of the bands, by any solver of [`optim::ALL`] | [`ident::surface`] |
//! | one valve over many windows: size, changes, windows that disagree | [`over_time::over_time`] |
//! | what the model leaves out, and how far naming it closes the gap | [`gap::diagnose`] |
//! | a loop simulated: valve laws, processes, PID, disturbances | [`sim`] |
//!
//! # A verdict
//! ```
//! use stiction::record::Record;
//! use stiction::sim::valve::he_step;
//! use stiction::verdict::{AssessParams, assess};
//!
//! // OP swings, a valve with fs 2.5 and fd 1 follows it, a first-order process answers the valve.
//! let op: Vec<f64> = (0..600).map(|k| 6.0 * (f64::from(k) * 0.06).sin() + 2.0 * (f64::from(k) * 0.017).sin()).collect();
//! let (mut stem, mut pv, mut measured) = (0.0, 0.0, Vec::new());
//! for &u in &op {
//!     measured.push(pv);
//!     stem = he_step(stem, u, 2.5, 1.0);
//!     pv += 0.1 * (1.5 * stem - pv);
//! }
//! let record = Record::uniform(1.0, op, measured);
//! let found = assess(&record, &AssessParams { always_fit: true, ..AssessParams::default() });
//! assert!((found.s.unwrap() - 3.5).abs() < 0.1);
//! ```
//!
//! # The map
//! Each room imports only rooms that stand above it.
//!
//! | layer | rooms |
//! |---|---|
//! | words | [`units`] time and names · [`record`] a sample, and the record one estimate is made from |
//! | tools | [`signal`] joining, memory, statistics · [`optim`] solvers |
//! | physics | [`sim`] valve laws, processes, controller, noise, closed loop: the only copy of each formula |
//! | identification | [`ident`] quantification of stiction · [`detect`] oscillation, and one file per indicator |
//! | judgement | [`verdict`] gates, verdict, the estimate's document · [`gap`] what the model leaves out |
//! | what follows | [`over_time`] many windows of one valve |
//!
//! # What must be absent
//! No file, socket, clock, thread, environment or unseeded randomness: the same record gives the same bits, on every
//! machine. Transcendental functions come from `libm`, as those of the system differ in the last bit.

#![cfg_attr(test, allow(clippy::disallowed_methods, clippy::disallowed_types))]

pub mod detect;
pub mod gap;
pub mod ident;
pub mod optim;
pub mod over_time;
pub mod record;
pub mod signal;
pub mod sim;
pub mod units;
pub mod verdict;

/// Version of the library and of the program, as documents carry it.
pub const VERSION: &str = env!("CARGO_PKG_VERSION");

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
