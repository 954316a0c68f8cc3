//! What a start takes over from earlier runs: the loops' memory from the store, and their windows from the recordings.

pub mod memory;
pub(super) mod windows;
