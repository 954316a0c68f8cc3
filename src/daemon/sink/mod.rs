//! Destinations of results: the bus, recordings, and receivers elsewhere.

pub mod deliver;
pub mod mark;
pub mod recorder;
pub mod state_writer;
pub mod zenoh;
