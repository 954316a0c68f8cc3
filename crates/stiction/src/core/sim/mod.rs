//! Physics: valve models, processes, controller, noise and the closed loop. Each formula exists only here.

pub mod actuator;
pub mod closed_loop;
pub mod controller;
pub mod disturbance;
pub mod friction;
pub mod noise;
pub mod process;
pub mod slips;
pub mod steps;
pub mod valve;
