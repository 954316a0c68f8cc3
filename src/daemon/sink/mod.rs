//! Where results go: onto the bus, into recordings, and to receivers elsewhere.

pub mod deliver;
pub mod keeper;
pub mod mark;
pub mod recorder;
pub mod zenoh;
