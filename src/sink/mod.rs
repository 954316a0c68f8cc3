//! Where results go: onto the bus, and into recordings.

pub mod keeper;
pub mod recorder;
pub mod signing;
pub mod zenoh;
