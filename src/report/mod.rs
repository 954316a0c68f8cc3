//! Pictures and pages that present an estimate to people.
//!
//! [`plot`] and [`chart`] turn data into SVG and do not depend on valves; [`ink`] assigns colours to meanings. [`detail`]
//! computes the data of a loop's pictures, [`figures`] draws them, [`words`] puts numbers into sentences. [`maker`] collects
//! the analysed loops, [`command`] quotes the command line, `groups` shows groups of loops; [`page`] is the HTML file,
//! [`sheet`] the SVG file; [`gap_figures`] and [`gap_page`] do the same for a gap.

pub mod across;
pub mod chart;
pub mod command;
pub mod detail;
pub mod diagram;
pub mod figures;
pub mod gap_figures;
mod gap_page;
mod groups;
pub mod ink;
pub mod maker;
mod page;
pub mod plot;
mod sheet;

pub use gap_page::{GapReport, gap_page};
pub use page::page;
pub use sheet::sheet;

use detail::Detail;
use diagram::Tags;
use stiction::core::record::Record;
use stiction::core::verdict::{Assessment, EstimateDocument};
use stiction::plantwide::GroupDocument;

/// Loops drawn in full by default.
pub const IN_FULL: usize = 12;

/// One loop's part of a report.
#[derive(Debug, Clone)]
pub struct LoopReport {
    /// The estimate.
    pub document: EstimateDocument,
    /// The record that was analysed.
    pub record: Record,
    /// The section as recorded, if the analysed one was downsampled.
    pub original: Option<Record>,
    /// Names of its signals.
    pub tags: Tags,
    /// The file's description of the loop.
    pub comment: Option<String>,
    /// Notes on its data: skipped samples, gaps, repeated stamps.
    pub notes: Vec<String>,
    /// Whether its pictures are drawn in full even if nothing was fitted.
    pub full: bool,
    /// Data for its detailed pictures; `None` if it is shown briefly or nothing was fitted.
    pub detail: Option<Detail>,
}

/// Content of a report.
#[derive(Debug, Clone)]
pub struct Report {
    /// The input file as given.
    pub input: String,
    /// The exact command.
    pub command: String,
    /// Warnings from the analysis.
    pub warnings: Vec<String>,
    /// The loops in the order of the file.
    pub loops: Vec<LoopReport>,
    /// The groups of loops that share one oscillation; `None` if the loops were not compared.
    pub groups: Option<Vec<GroupDocument>>,
}

impl Report {
    /// Indices of the loops by probability of stiction, then by size, largest first; otherwise in the order of the file.
    #[must_use]
    pub fn by_urgency(&self) -> Vec<usize> {
        let assessments: Vec<&Assessment> = self.loops.iter().map(|l| &l.document.assessment).collect();
        by_urgency(&assessments)
    }
}

/// Indices of assessments by probability of stiction, then by size, largest first; otherwise in the given order.
#[must_use]
pub fn by_urgency(all: &[&Assessment]) -> Vec<usize> {
    let key = |a: &Assessment| {
        // Probabilities with the same displayed value count as equal.
        let p = a.p_stiction.map_or(-1.0, |p| (100.0 * p).round());
        (p, a.s.unwrap_or(-1.0))
    };
    let mut order: Vec<usize> = (0..all.len()).collect();
    order.sort_by(|x, y| {
        let (x, y) = (key(all[*x]), key(all[*y]));
        y.0.total_cmp(&x.0).then(y.1.total_cmp(&x.1))
    });
    order
}

#[cfg(test)]
mod tests;
