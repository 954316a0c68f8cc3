//! The library from outside: its promises, tested on simulated and recorded loops.
//!
//! One binary, so that shared code is compiled and linked once.
#![allow(missing_docs)]
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::disallowed_methods, clippy::disallowed_types)]

mod gap_golden;
mod labelled;
mod screening;
mod traps;
mod truth_causes;
mod truth_controller;
mod truth_detectable;
mod truth_gap;
mod truth_intervals;
mod truth_over_time;
mod truth_plantwide;
mod truth_repair;
mod truth_solvers;
mod truth_stiction;
mod truth_swapped;
mod val_budget;
mod val_effects;
mod val_gap;
mod val_labelled;
mod val_plausible;
mod val_pool;
mod val_stick_index;

/// Number of cases in the usual run, and in the long one (`tests/run.sh --all`).
fn cases<T>(usual: T, long: T) -> T {
    if std::env::var_os("STICTIOND_LONG").is_some() { long } else { usual }
}
