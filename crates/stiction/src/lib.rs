//! Valve stiction from routine data: whether and how much a control valve sticks, the process behind it, the confidence in
//! the answer, and what else in the loop the model does not explain.
//!
//! Input is a [`record::Record`] (controller output OP, process variable PV, sampling time); results are typed numbers.
//!
//! | task | where |
//! |---|---|
//! | is the valve sticking, and how much | [`verdict::assess`] |
//! | the fit alone: bands of He's valve model, process with dead time, intervals | [`ident::quantify()`](ident::quantify) |
//! | the error surface over the bands, for any solver of [`optim::ALL`] | [`ident::surface`] |
//! | one valve over many windows: size, changes, windows that disagree | [`over_time::over_time`] |
//! | loops that share an oscillation, and the source of it | [`plantwide::assess_plant`] |
//! | benefit of a valve repair: the closed loop without stiction | [`repair::repair`] |
//! | effects that the model leaves out, and how much of the gap each closes | [`gap::diagnose`] |
//! | simulation of a loop: valve models, processes, PID, disturbances | [`sim`] |
//!
//! # A verdict
//! ```
//! use stiction::record::Record;
//! use stiction::sim::valve::he_step;
//! use stiction::verdict::{AssessParams, assess};
//!
//! // OP oscillates; a valve with fs 2.5 and fd 1 follows, and drives a first-order process.
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
//! # Modules
//! A module imports only modules from the rows above it.
//!
//! | layer | modules |
//! |---|---|
//! | basics | [`units`] times, names, numbers · [`record`] samples, and the record of one estimate · [`guard`] what a test on a loop may ask |
//! | tools | [`signal`] joining, history, statistics · [`optim`] solvers |
//! | physics | [`sim`] valve models, processes, controller, noise, closed loop: the only copy of each formula |
//! | identification | [`ident`] quantification of stiction · [`detect`] oscillation, and one file per indicator |
//! | judgement | [`verdict`] validity checks, verdict, the estimate's document · [`gap`] model-plant mismatch |
//! | evaluation | [`over_time`] many windows of one valve · [`plantwide`] loops that share an oscillation · [`repair`] the closed loop without stiction |
//!
//! # Determinism
//! No file, socket, clock, thread, environment or unseeded random numbers: the same record gives bit-identical results on
//! every machine. Transcendental functions come from `libm`, because system libraries differ in the last bit.

#![cfg_attr(test, allow(clippy::disallowed_methods, clippy::disallowed_types))]

pub mod detect;
pub mod gap;
pub mod guard;
pub mod ident;
pub mod optim;
pub mod over_time;
pub mod plantwide;
pub mod record;
pub mod repair;
pub mod signal;
pub mod sim;
pub mod units;
pub mod verdict;

/// Version of library and program, as in documents.
pub const VERSION: &str = env!("CARGO_PKG_VERSION");

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
