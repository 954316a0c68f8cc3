//! Pictures and pages: what an estimate says, for people.
//!
//! [`plot`] and [`chart`] turn data into SVG; [`ink`] says which colour stands for what.

pub mod chart;
pub mod ink;
pub mod plot;
