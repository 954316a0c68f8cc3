//! What proves [`stiction::core`], on the loops of [`crate::truth`]: a sealed challenge for the gap diagnosis with its scorer,
//! and the fits of the verdict's rule and of the intervals to what was simulated and labelled.
//!
//! The library cannot use any of this, as it does not depend on this crate.
//!
//! | room | |
//! |---|---|
//! | [`truth`] | simulated loops of known truth, and published methods to compare with |
//! | [`challenge`] | recordings with one withheld cause each, their sealed truth, the scorer |
//! | [`hybrid`] | effects put into real loops that are closed again |
//! | [`bump_test`] | the bump test that an estimate proposes, carried out on simulated valves |
//! | [`calibrate`] | the rule behind `p_stiction`, leaving out valve by valve |
//! | [`calibrate_gap`] | how sure the gap's decision is |
//! | [`plants`] | plants of known truth, whose loops share oscillations |
//! | [`calibrate_plants`] | the rules for loops that share an oscillation |
//! | [`calibrate_intervals`] | how wide intervals have to be |

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
