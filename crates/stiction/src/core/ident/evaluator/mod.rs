//! The free-run error of a model, exactly and in time proportional to the steps of its valve signal.
//!
//! Every process model here is linear, so its response to a staircase is a sum of shifted step responses, each made of a level,
//! a ramp and one or two decays. Products of such columns with each other follow from sums over the valve's steps; products
//! with PV come from tables of PV's own sums, made once per time constant. [`View`] holds PV, the filter of the error and those
//! tables; [`reduce`] walks over the steps; [`Reduced`] gives the error for every dead time within a sample, gain and kinetic
//! band. Tests compare this error with a plain pass over samples.

mod gathered;
mod held;
mod reduced;
mod square;
mod sums;
mod tables;
mod walk;

pub use held::HeldSums;
pub use reduced::{Best, Reduced};
pub use sums::reduce;
pub(crate) use tables::{LATTICE_STEP, lattice_index, lattice_tau};
pub use tables::{Table, View};

#[cfg(test)]
mod tests;
