//! Simulated plants, as `demo`, tests and benchmarks run them: scenarios in TOML, and their loops scan by scan on the physics of
//! [`crate::core::sim`].

pub mod plant;
pub mod scenario;
mod scenario_read;
mod scenario_shape;
