//! Pictures and pages: what an estimate says, for people.
//!
//! [`plot`] and [`chart`] turn data into SVG and know nothing of valves; [`ink`] says which colour stands for what.
//! [`detail`] computes what a loop's pictures need, [`figures`] draws them, [`words`] puts the numbers into sentences.
//! [`maker`] gathers what was analysed, [`command`] says how it was made; `groups` shows groups of loops; [`page`] is the HTML file, [`sheet`] the SVG file; [`gap_figures`] and [`gap_page`] do the same for a gap.

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
use stiction::core::plantwide::GroupDocument;
use stiction::core::record::Record;
use stiction::core::verdict::{Assessment, EstimateDocument};

/// Loops that are drawn in full unless all are asked for.
pub const IN_FULL: usize = 12;

/// One loop's part of a report.
#[derive(Debug, Clone)]
pub struct LoopReport {
    /// What was found.
    pub document: EstimateDocument,
    /// The record that was analysed.
    pub record: Record,
    /// The section as recorded, where the analysed one was downsampled.
    pub original: Option<Record>,
    /// Names of its signals.
    pub tags: Tags,
    /// What the file says about the loop.
    pub comment: Option<String>,
    /// What a reader of its data should know: samples that were skipped, gaps, repeated stamps.
    pub notes: Vec<String>,
    /// Whether its pictures are drawn in full even where nothing was fitted.
    pub full: bool,
    /// What its detailed pictures show; `None` where it is shown in short or nothing was fitted.
    pub detail: Option<Detail>,
}

/// Everything that a report shows.
#[derive(Debug, Clone)]
pub struct Report {
    /// The file that was read, as it was given.
    pub input: String,
    /// The exact command.
    pub command: String,
    /// What went wrong on the way.
    pub warnings: Vec<String>,
    /// The loops in the file's order.
    pub loops: Vec<LoopReport>,
    /// The groups of loops that share one oscillation; `None` where the loops were not compared.
    pub groups: Option<Vec<GroupDocument>>,
}

impl Report {
    /// The loops' places, those that most likely stick first, then those that stick most; the file's order else.
    #[must_use]
    pub fn by_urgency(&self) -> Vec<usize> {
        let assessments: Vec<&Assessment> = self.loops.iter().map(|l| &l.document.assessment).collect();
        by_urgency(&assessments)
    }
}

/// Places of assessments, those that most likely stick first, then those that stick most; the given order else.
#[must_use]
pub fn by_urgency(all: &[&Assessment]) -> Vec<usize> {
    let key = |a: &Assessment| {
        // Probabilities that read alike are alike.
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
