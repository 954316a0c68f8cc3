//! The one search for the slips of a valve and the process behind it.
//!
//! The input is a [`problem::Problem`] (a normalised record, its counted stretches, signals fitted in addition to the process's
//! response) with the allowed laws and classes of process. A [`coarse_scan`] of the plane of bands, on a part of the record,
//! finds starting points, and so do PV's own kinks; a [`local_search`] goes from cell to cell of equal slips; the best is
//! carried to the whole record and tested there ([`stages`]).

pub(crate) mod answer;
mod around;
pub(crate) mod candidate;
mod classes;
pub(crate) mod coarse_scan;
mod cuts;
pub(crate) mod evaluator;
pub(crate) mod interval;
mod later;
pub(crate) mod local_search;
pub(crate) mod part;
pub(crate) mod problem;
mod read;
pub(crate) mod rivals;
pub(crate) mod scan;
pub(crate) mod settings;
pub(crate) mod stages;
pub(crate) mod thirds;
