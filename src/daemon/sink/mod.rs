//! Where results go: onto the bus, into recordings, and to receivers elsewhere.

pub mod deliver;
pub mod mark;
pub mod recorder;
pub mod state_writer;
pub mod zenoh;
