//! Physics: valve laws, process models, controller, noise and the closed loop. The only copy of each formula.

pub mod process;
pub mod slips;
pub mod valve;
