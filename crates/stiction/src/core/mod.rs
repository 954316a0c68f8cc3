//! Valve stiction from routine data: whether and how much a control valve sticks, the process behind it, the confidence in
//! the answer, and what else in the loop the model does not explain.
//!
//! Programs outside this repository use what the crate lists at its root. Items here change without notice.
//!
//! The core judges one loop, by one record. What judges many windows or loops, or shows an answer, lies beside it and uses it.
//!
//! # Modules
//! A module imports only modules from the rows above it.
//!
//! | layer | modules |
//! |---|---|
//! | basics | [`units`] times, names, numbers · [`people`] numbers rounded for people · [`record`] samples, and the record of one estimate · [`guard`] limits of a test on a running loop |
//! | tools | [`signal`] detrending, resampling, statistics, spectra · [`optim`] search on a triangle |
//! | physics | [`sim`] valve models, processes, controller, noise, closed loop: the only copy of each formula |
//! | identification | [`ident`] quantification of stiction · [`detect`] oscillation, and one file per indicator |
//! | judgement | [`verdict`] validity checks, verdict, the estimate's document · [`gap`] model-plant mismatch |
//!
//! # Determinism
//! No file, socket, clock, thread, environment or unseeded random numbers: the same record gives bit-identical results on
//! every machine. Transcendental functions come from `libm`, because system libraries differ in the last bit.

pub mod detect;
pub mod gap;
pub mod guard;
pub mod ident;
pub mod optim;
pub mod people;
pub mod record;
pub mod signal;
pub mod sim;
pub mod units;
pub mod verdict;

/// Parameters fitted to data, by name: the classifier, the widths of intervals, the decision of the gap diagnosis.
pub const CALIBRATIONS: [(&str, &str); 3] = [
    ("classifier", include_str!("verdict/rule.json")),
    ("intervals", include_str!("ident/interval.json")),
    ("gap", include_str!("gap/calibration.json")),
];

/// Version of library and program, as in documents.
pub const VERSION: &str = env!("CARGO_PKG_VERSION");
