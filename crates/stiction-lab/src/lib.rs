//! Evaluates [`stiction::core`] on the loops of [`crate::truth`]: a sealed challenge for the gap diagnosis with its scorer, and
//! the calibration of the verdict's rule and of the intervals on simulated loops and labelled recordings.
//!
//! The library does not depend on this crate, so it cannot use any of this.
//!
//! | module | |
//! |---|---|
//! | [`truth`] | simulated loops of known truth, and published methods to compare with |
//! | [`challenge`] | recordings with one withheld cause each, their sealed truth, the scorer |
//! | [`hybrid`] | real loops, simulated in closed loop with an added effect |
//! | [`bump_test`] | the proposed bump test, run on simulated valves |
//! | [`calibrate`] | the rule behind `p_stiction`, cross-validated by valve |
//! | [`calibrate_gap`] | the confidence of the gap's decision |
//! | [`plants`] | simulated plants of known truth, whose loops share oscillations |
//! | [`calibrate_plants`] | the rules for loops that share an oscillation |
//! | [`calibrate_intervals`] | the required width of intervals |

#![cfg_attr(test, allow(clippy::disallowed_methods, clippy::disallowed_types))]

pub mod bump_test;
pub mod calibrate;
pub mod calibrate_gap;
pub mod calibrate_intervals;
pub mod calibrate_plants;
pub mod challenge;
pub mod hybrid;
pub mod plants;
pub mod truth;
