//! Where results go: onto the bus, and into recordings.

pub mod recorder;
pub mod zenoh;
