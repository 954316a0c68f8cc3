//! Faults of the machine around the daemon, one process each: disk, clock, start, configuration, links.

mod clock;
mod disk;
mod link;
mod readers;
mod shim;
mod start;
