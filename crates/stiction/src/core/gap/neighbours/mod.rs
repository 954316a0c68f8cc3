//! Other loops as measured inputs: their PV and OP are offered as a load on this loop's PV.
//!
//! How much the past of every neighbour's signals tells of PV beyond its own past and OP is found in closed form ([`scan`]). A
//! p-value says how often neighbours that are shifted in time tell as much, the best of all neighbours each time, so that
//! their number is paid for. The best few are then judged twice ([`look`]): under the noise model of [`super::budget`], in both
//! halves, and fitted together with the base as every effect is.

mod look;
mod scan;

pub use look::compare;
pub(super) use look::{Offered, look};
