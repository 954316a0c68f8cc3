//! The one search for the slips of a valve and the process behind it.
//!
//! It is given a [`problem::Problem`] (a normalised record, what of it counts, what is fitted beside the process' answer)
//! and the laws and classes of process that may be. A [`coarse_scan`] of the plane of bands, on a part of the record,
//! finds where to begin, and PV's own kinks say where the slips may be; a [`local_search`] goes from cell to cell of equal slips; the best is carried to the whole record
//! and tested there ([`stages`]).

pub mod answer;
mod around;
pub mod candidate;
mod classes;
pub mod coarse_scan;
mod cuts;
pub mod evaluator;
pub mod interval;
pub mod local_search;
pub mod part;
pub mod problem;
mod read;
pub mod rivals;
pub mod scan;
pub mod settings;
pub mod stages;
